//! A second motion among the points of a start: something moves before the camera, and nothing tells which of them stands still.
//!
//! Two views cannot tell it, least of all where both move along one line: a lorry that passes a camera that is carried sideways has flow along the
//! same epipolar lines as all else. As the points are followed further, a motion of their own shows in those that leave the solution.

use super::Bootstrap;
use super::solve::{Solution, agreement, cheapest};
use crate::params::Params;
use crate::window::{Problem, WindowObservation, WindowPoint};
use geometry::Se3;

/// Least share of the points that leave a solution which a second one explains. What moves leaves 0.79 to 0.90 (rendered lorries that drive off); of
/// still surroundings at most 0.64, for a shaken drone whose shutter is not known yet.
const EXPLAINED: f64 = 0.7;

impl Bootstrap {
    /// Whether the points of a solution that disagree with it agree with another one, which has its share of the points (`track.max_rival`) and explains
    /// most of what the first leaves. It is sought from the first one's poses and from those that the first one was sought from.
    pub(super) fn has_two_motions(&self, solution: &Solution, pure_rotation: &Se3, params: &Params) -> bool {
        let problem = &solution.problem;
        let squared = problem.squared_residuals();
        let limit = agreement(&squared);
        let (first, rest): (Vec<usize>, Vec<usize>) =
            (0..problem.points.len()).partition(|&i| agrees(&problem.points[i], &squared, limit));
        // What stays in the image is learnt to move with the camera, and left out (`crate::mask`).
        let least_displacement = f64::from(params.bootstrap.min_parallax) * problem.camera.width as f64;
        let rest: Vec<usize> = rest
            .into_iter()
            .filter(|&i| displacement(problem, &problem.points[i]) >= least_displacement)
            .collect();
        let least = f64::from(params.track.max_rival);
        let is_many = |count: usize| {
            count >= params.keyframes.min_matched && count as f64 >= least * (first.len() + count) as f64
        };
        if !is_many(rest.len()) {
            return false;
        }
        let mut starts = vec![problem.frames[1..].to_vec()];
        starts.extend(self.initial_poses(pure_rotation));
        let Some((_, second)) = cheapest(&starts, |poses| part(problem, &rest, poses)) else { return false };
        let squared = second.squared_residuals();
        let explained = second.points.iter().filter(|point| agrees(point, &squared, limit)).count();
        is_many(explained) && explained as f64 >= EXPLAINED * rest.len() as f64
    }
}

/// Whether all observations of a point lie where a solution has them. Where it does not say how far away the point is, as that of a star, it agrees too.
fn agrees(point: &WindowPoint, squared: &[f64], limit: f64) -> bool {
    point.observations.clone().all(|i| squared[i] < limit)
}

/// How far from where the first frame shows it a point is seen at the most, pixels.
fn displacement(problem: &Problem, point: &WindowPoint) -> f64 {
    let own = problem.camera.project(&point.ray);
    let seen = problem.observations[point.observations.clone()].iter().map(|seen| seen.pixel);
    seen.map(|[x, y]| (x - own.x).hypot(y - own.y)).fold(0.0, f64::max)
}

/// Some of a problem's points, and its frames at these poses but for the first.
fn part(problem: &Problem, of: &[usize], poses: &[Se3]) -> Problem {
    let mut observations: Vec<WindowObservation> = Vec::new();
    let alone = |&i: &usize| {
        let point = &problem.points[i];
        let first = observations.len();
        observations.extend_from_slice(&problem.observations[point.observations.clone()]);
        let observations = first..observations.len();
        WindowPoint { host: 0, ray: point.ray, inverse_depth: 1.0, observations, information: 0.0 }
    };
    let points = of.iter().map(alone).collect();
    let frames = problem.frames[..1].iter().chain(poses).copied().collect();
    let fixed = problem.fixed.clone();
    Problem { camera: problem.camera, frames, fixed, points, observations, calibration: None }
}
