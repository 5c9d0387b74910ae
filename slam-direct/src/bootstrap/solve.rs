//! Poses and depths from the followed points, and whether a map can be built on them.

use super::{Bootstrap, BootstrapParams, MIN_POINTS};
use crate::local_map::median;
use crate::window::{PoseSolver, Problem, SeenPoint, WindowObservation, WindowPoint, solve};
use geometry::Se3;
use nalgebra::{Vector3, Vector6};
use rayon::prelude::*;

/// Steps of the optimisation at most.
const MAX_ITERATIONS: usize = 40;

/// A local minimum of the cost.
pub(super) struct Solution {
    pub cost: f64,
    pub problem: Problem,
}

impl Bootstrap {
    /// The rotation that explains the newest frame best, and the median way that it leaves.
    pub(super) fn parallax(&self) -> (Se3, f32) {
        let mut problem = self.problem(&[self.frames.len() - 1], &[Se3::identity()], 0.0);
        let turn = fit_pose(&problem, 15, true);
        problem.frames[1] = turn;
        let mut left: Vec<f32> = problem
            .observations
            .iter()
            .zip(&problem.points)
            .map(|(seen, point)| {
                let pixel = self.camera.project(&(turn.rotation * point.ray));
                (pixel.x - seen.pixel[0]).hypot(pixel.y - seen.pixel[1]) as f32
            })
            .collect();
        (turn, median(&mut left).unwrap_or(0.0))
    }

    /// Poses (first frame and chosen frames) and points seen in the last of `chosen`.
    fn problem(&self, chosen: &[usize], poses: &[Se3], inverse_depth: f64) -> Problem {
        let mut problem = Problem {
            camera: self.camera,
            frames: [Se3::identity()].into_iter().chain(poses.iter().copied()).collect(),
            fixed: (0..=chosen.len()).map(|i| i == 0).collect(),
            points: Vec::new(),
            observations: Vec::new(),
            calibration: None,
        };
        let Some(&last) = chosen.last() else { return problem };
        for (index, track) in self.tracks.iter().enumerate() {
            if self.frames[last].seen[index].is_none() {
                continue;
            }
            let first = problem.observations.len();
            problem.observations.extend(chosen.iter().enumerate().filter_map(|(i, &frame)| {
                let (pixel, information) = self.frames[frame].seen[index]?;
                Some(WindowObservation {
                    frame: i + 1,
                    pixel: pixel.map(f64::from),
                    information: information.map(f64::from),
                })
            }));
            problem.points.push(WindowPoint {
                host: 0,
                ray: self.camera.unproject(track.pixel[0] as f64, track.pixel[1] as f64),
                inverse_depth,
                observations: first..problem.observations.len(),
                information: 0.0,
            });
        }
        problem
    }

    /// Poses and depths, sought from several directions of travel; the solution that costs least.
    pub(super) fn solve(&self, turn: &Se3) -> Option<Solution> {
        let chosen = self.chosen();
        let count = self.frames.len();
        let w = turn.rotation.scaled_axis();
        let starts = [
            Vector3::zeros(),
            Vector3::x(),
            -Vector3::x(),
            Vector3::y(),
            -Vector3::y(),
            Vector3::z(),
            -Vector3::z(),
        ];
        let solved: Vec<Solution> = starts
            .par_iter()
            .map(|direction| {
                let poses: Vec<Se3> = chosen
                    .iter()
                    .map(|&frame| {
                        let share = (frame + 1) as f64 / count as f64;
                        let (v, w) = (direction * 0.1 * share, w * share);
                        Se3::exp(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z))
                    })
                    .collect();
                let mut problem = self.problem(&chosen, &poses, 1.0);
                let cost = solve(&mut problem, MAX_ITERATIONS);
                Solution { cost, problem }
            })
            .collect();
        solved.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    /// What is left when the poses of the chosen frames are held and the depths fit them best.
    pub(super) fn cost_of(&self, poses: &[Se3]) -> f64 {
        let mut problem = self.problem(&self.chosen(), poses, 1.0);
        problem.fixed.fill(true);
        solve(&mut problem, MAX_ITERATIONS)
    }

    /// The frames that are solved for: at most five, evenly spaced, the newest the last.
    pub(super) fn chosen(&self) -> Vec<usize> {
        match self.frames.len() {
            count @ 0..=5 => (0..count).collect(),
            count => (1..=5).map(|i| i * count / 5 - 1).collect(),
        }
    }

    /// Poses of all frames of the start, with the solution's depths held.
    pub(super) fn pose_all(&self, solution: &Problem, unit: f64) -> Vec<(f64, u64, Se3)> {
        let all: Vec<usize> = (0..self.frames.len()).collect();
        let last = *solution.frames.last().unwrap_or(&Se3::identity());
        let twist = last.log();
        all.iter()
            .map(|&frame| {
                let share = (frame + 1) as f64 / self.frames.len() as f64;
                let mut problem = self.problem(&[frame], &[Se3::exp(&(twist * share))], 1.0);
                hold_depths(&mut problem, solution);
                let pose = fit_pose(&problem, 8, false);
                let f = &self.frames[frame];
                (f.timestamp, f.frame_index, Se3::new(pose.rotation, pose.translation * unit))
            })
            .collect()
    }
}

/// Gives the points of `problem` the depths that `solution` found for the same rays; others leave.
fn hold_depths(problem: &mut Problem, solution: &Problem) {
    let mut known = solution.points.iter();
    problem.points.retain_mut(|point| {
        // Both lists are in the order of the tracks.
        match known.clone().position(|k| k.ray == point.ray) {
            Some(position) => {
                let found = known.nth(position);
                point.inverse_depth = found.map_or(1.0, |k| k.inverse_depth);
                found.is_some_and(|k| k.inverse_depth > 0.0)
            }
            None => false,
        }
    });
}

/// The pose of frame 1 of `problem` that agrees best with where it sees the points, their depths held;
/// `rotation_only` holds its translation too.
fn fit_pose(problem: &Problem, iterations: usize, rotation_only: bool) -> Se3 {
    let sightings = problem.points.iter().flat_map(|point| {
        problem.observations[point.observations.clone()].iter().map(|seen| SeenPoint {
            direction: point.ray,
            inverse_depth: point.inverse_depth,
            pixel: seen.pixel,
            information: seen.information,
        })
    });
    let points: Vec<SeenPoint> = sightings.collect();
    let solver = PoseSolver { iterations, wide: 0, settled: 0.0, rotation_only };
    solver.solve(&problem.camera, &problem.frames[1], &points)
}

/// Squared residual that an observation of a good start stays below; χ² of two degrees of freedom at 99.7 %,
/// widened when all residuals are larger than assumed (rolling shutter in a fast turn).
pub(super) fn agreement(squared: &[f64]) -> f64 {
    let mut all: Vec<f32> = squared.iter().map(|s| *s as f32).collect();
    12.0 * median(&mut all).map_or(1.0, |m| (m as f64).clamp(1.0, MAX_WIDENING))
}

/// Beyond this the residuals are not noise.
const MAX_WIDENING: f64 = 8.0;

/// Whether a solution is one to build on: most points agree, lie in front and have certain depths.
pub(super) fn acceptable(solution: &Problem, params: &BootstrapParams) -> bool {
    let squared = solution.squared_residuals();
    let limit = agreement(&squared);
    let mut sigmas = Vec::new();
    let mut good = 0usize;
    for point in &solution.points {
        let agrees = point.observations.clone().all(|i| squared[i] < limit);
        if agrees && point.inverse_depth > 1e-3 && point.information > 0.0 {
            good += 1;
            sigmas
                .push((limit / 12.0).sqrt() as f32 / (point.information.sqrt() * point.inverse_depth) as f32);
        }
    }
    let sigma = median(&mut sigmas).unwrap_or(f32::INFINITY) as f64;
    good as f64 >= params.min_inliers * solution.points.len() as f64
        && good >= MIN_POINTS
        && sigma < params.max_relative_sigma
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agreement_widens_with_the_residuals_within_limits() {
        assert_eq!(agreement(&[]), 12.0);
        assert_eq!(agreement(&[0.1, 0.2, 0.3]), 12.0);
        assert_eq!(agreement(&[1.0, 2.0, 3.0]), 24.0);
        assert_eq!(agreement(&[1e6; 5]), 12.0 * MAX_WIDENING);
    }
}
