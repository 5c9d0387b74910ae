//! Where the adjustment starts: a focal length, and the poses that go with it.

use super::bundle::{Problem, State};
use super::model::{MAX_PARAMETERS, Parameters};
use super::planar::{MIN_CORNERS, focal_lengths, homography, pose};
use super::{Corner, LensModel};
use geometry::{Camera, Se3};
use nalgebra::{Vector2, Vector3};

/// Focal lengths that are tried, as shares of the image's width: from fisheye to telephoto.
const FOCAL_SHARES: [f64; 9] = [0.25, 0.35, 0.5, 0.65, 0.85, 1.1, 1.5, 2.2, 4.0];
/// Rays flatter than this (z of the unit ray) do not count for the first poses: the plane z = 1 is far away there.
const MIN_FORWARD: f64 = 0.15;
/// How many starts are followed to the end.
const FOLLOWED: usize = 2;

/// The best state that a few different starts lead to; `None` when no start makes sense of the views.
pub(crate) fn start(problem: &Problem) -> Option<State> {
    let mut states: Vec<(f64, State)> = candidates(problem)
        .into_iter()
        .filter_map(|parameters| {
            let camera = problem.model.camera(problem.size, &parameters).ok()?;
            let poses = problem.views.iter().map(|corners| board_pose(&camera, problem.points, corners));
            // A pose that cannot be had now may be once the camera is better known: start ahead.
            let poses = poses.map(|pose| pose.unwrap_or_else(|| ahead(problem.points))).collect();
            let state = problem.solve_poses(State { parameters, poses }, 8);
            Some((problem.cost(&state), state))
        })
        .collect();
    states.sort_by(|a, b| a.0.total_cmp(&b.0));
    states.truncate(FOLLOWED);
    let solved = states.into_iter().map(|(_, state)| problem.solve(state, 40));
    solved
        .map(|state| (problem.cost(&state), state))
        .filter(|(cost, _)| cost.is_finite())
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, state)| state)
}

fn candidates(problem: &Problem) -> Vec<Parameters> {
    let (width, height) = (problem.size.0 as f64, problem.size.1 as f64);
    let centre = Vector2::new(0.5 * (width - 1.0), 0.5 * (height - 1.0));
    let with = |fx: f64, fy: f64, term: f64| {
        let mut p = Parameters::zeros();
        for (i, value) in [fx, fy, centre.x, centre.y, term].into_iter().enumerate().take(MAX_PARAMETERS) {
            p[i] = value;
        }
        p
    };
    let terms: &[f64] = if problem.model == LensModel::Fov { &[0.3, 0.9, 1.4] } else { &[0.0] };
    let shares = FOCAL_SHARES.iter().flat_map(|share| terms.iter().map(move |&term| (share * width, term)));
    let mut all: Vec<Parameters> = shares.map(|(focal, term)| with(focal, focal, term)).collect();
    let homographies: Vec<_> =
        problem.views.iter().filter_map(|corners| homography(&pairs(problem.points, corners))).collect();
    let sane = |f: f64| (0.1 * width..20.0 * width).contains(&f);
    if let Some((fx, fy)) = focal_lengths(&homographies, centre)
        && sane(fx)
        && sane(fy)
    {
        all.extend(terms.iter().map(|&term| with(fx, fy, term)));
    }
    all
}

/// Points of the board's plane with their pixels.
pub(crate) fn pairs(points: &[Vector3<f64>], corners: &[Corner]) -> Vec<(Vector2<f64>, Vector2<f64>)> {
    corners.iter().map(|corner| (points[corner.index].xy(), corner.pixel)).collect()
}

/// camera_from_board of a known camera, from the homography of the board to the plane z = 1.
pub(crate) fn board_pose(camera: &Camera, points: &[Vector3<f64>], corners: &[Corner]) -> Option<Se3> {
    let rays = corners.iter().filter_map(|corner| {
        let ray = camera.unproject(&corner.pixel)?;
        (ray.z > MIN_FORWARD).then(|| (points[corner.index].xy(), ray.xy() / ray.z))
    });
    let pairs: Vec<_> = rays.collect();
    if pairs.len() < MIN_CORNERS {
        return None;
    }
    let homography = homography(&pairs)?;
    // The board lies before the camera where it was seen: the sign is that of its middle.
    let middle = pairs.iter().map(|pair| pair.0).sum::<Vector2<f64>>() / pairs.len() as f64;
    let depth = (homography * middle.push(1.0)).z;
    let shift = nalgebra::Matrix3::new(1.0, 0.0, middle.x, 0.0, 1.0, middle.y, 0.0, 0.0, 1.0);
    let centred = homography * shift * depth.signum();
    let at_middle = pose(&centred)?;
    let back = at_middle.rotation * Vector3::new(middle.x, middle.y, 0.0);
    Some(Se3::new(at_middle.rotation, at_middle.translation - back))
}

/// A board straight ahead, two board lengths away.
fn ahead(points: &[Vector3<f64>]) -> Se3 {
    let far = points.iter().map(|point| point.norm()).fold(0.0, f64::max);
    let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    Se3::new(nalgebra::UnitQuaternion::identity(), Vector3::new(0.0, 0.0, 2.0 * far) - middle)
}
