//! How well a calibration fits views that it was not made from.

use super::bundle::{Problem, State};
use super::pipeline::check_corners;
use super::planar::MIN_CORNERS;
use super::{LensModel, Refusal, View, initial};
use crate::Board;
use geometry::{Camera, median};
use nalgebra::Vector3;

/// Residuals beyond this count linearly for the board's place, pixels: a corner found wrongly must not move it.
const HUBER: f64 = 1.0;
/// Iterations of each adjustment.
const ITERATIONS: usize = 60;

/// How well a camera fits views.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Of each view the distances of its corners from where the camera would see them, pixels, with the board where it
    /// fits best; none of a view that does not show enough of the board. Infinite where the camera sees nothing.
    pub distances: Vec<Vec<f64>>,
}

impl Check {
    /// Root mean square of the distances, pixels.
    pub fn rms(&self) -> f64 {
        let all = self.distances.iter().flatten();
        (all.map(|distance| distance * distance).sum::<f64>() / self.corner_count().max(1) as f64).sqrt()
    }

    /// Median of the distances, pixels, which corners found wrongly do not change.
    pub fn median(&self) -> f64 {
        median(&mut self.distances.iter().flatten().copied().collect::<Vec<f64>>()).unwrap_or(0.0)
    }

    /// Number of corners.
    pub fn corner_count(&self) -> usize {
        self.distances.iter().map(Vec::len).sum()
    }
}

/// Adjusts the board's place in each view, and nothing of the camera. All corners count.
///
/// # Errors
/// When the camera's model is none that can be calibrated, a corner is not on the board, or no view shows enough of it.
pub fn check(board: &Board, views: &[View], camera: &Camera) -> Result<Check, Refusal> {
    let model = LensModel::of(camera).ok_or(Refusal::NoSuchModel)?;
    let points = board.points();
    check_corners(views, points.len())?;
    let distances: Vec<Vec<f64>> = views.iter().map(|view| distances(model, camera, &points, view)).collect();
    if distances.iter().all(Vec::is_empty) {
        return Err(Refusal::TooFewViews { usable: 0, given: views.len(), needed: 1 });
    }
    Ok(Check { distances })
}

fn distances(model: LensModel, camera: &Camera, points: &[Vector3<f64>], view: &View) -> Vec<f64> {
    let intrinsics = camera.intrinsics();
    let size = (intrinsics.width, intrinsics.height);
    let enough = view.corners.len() >= MIN_CORNERS;
    let Some(pose) = enough.then(|| initial::board_pose(camera, points, &view.corners)).flatten() else {
        return Vec::new();
    };
    let problem = Problem { model, size, points, views: vec![view.corners.clone()], huber: HUBER };
    let state = State { parameters: model.parameters(camera), poses: vec![pose] };
    let pose = problem.solve_poses(state, ITERATIONS).poses[0];
    let distance = |corner| problem.residual(camera, &pose, corner).map_or(f64::INFINITY, |r| r.norm());
    view.corners.iter().map(distance).collect()
}
