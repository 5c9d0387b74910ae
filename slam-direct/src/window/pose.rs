//! The pose of one frame that sees points of known depth.

use super::problem::{mahalanobis, predict, robust_weight};
use geometry::{Pinhole, Se3};
use nalgebra::{Matrix6, Vector3, Vector6};

/// A point of known depth, and where the frame sees it.
pub(crate) struct SeenPoint {
    /// Direction of the point from the origin of the world, times its distance and `inverse_depth`.
    pub direction: Vector3<f64>,
    /// Inverse depth that belongs to `direction`, 1/map unit; 0 is at infinity.
    pub inverse_depth: f64,
    /// Measured pixel.
    pub pixel: [f64; 2],
    /// Its information `[xx, xy, yy]`, 1/px².
    pub information: [f64; 3],
}

impl SeenPoint {
    /// Squared normalised residual under the pose `camera_from_world`; infinite behind the camera.
    pub fn squared(&self, camera: &Pinhole, camera_from_world: &Se3) -> f64 {
        let (rotation, translation) = (camera_from_world.rotation_matrix(), camera_from_world.translation);
        predict(camera, &rotation, &translation, &self.direction, self.inverse_depth, &self.pixel)
            .map_or(f64::INFINITY, |p| mahalanobis(&p.residual, &self.information))
    }
}

/// Robust Gauss–Newton on the pose of a frame, depths held.
pub(crate) struct PoseSolver {
    /// Steps at most.
    pub iterations: usize,
    /// First steps that are made with a wide kernel: the start may be a few pixels off.
    pub wide: usize,
    /// Squared length of a step with the narrow kernel below which no other follows; 0 makes them all.
    pub settled: f64,
    /// Whether the translation is held.
    pub rotation_only: bool,
}

/// Squared residuals are divided by this under the wide kernel.
const WIDENING: f64 = 30.0;

impl PoseSolver {
    /// The pose `camera_from_world` that agrees best with where the points are seen; `start` when there is none.
    pub fn solve(&self, camera: &Pinhole, start: &Se3, points: &[SeenPoint]) -> Se3 {
        let mut pose = *start;
        for iteration in 0..self.iterations {
            let widening = if iteration < self.wide { WIDENING } else { 1.0 };
            let (mut h, mut g) = linearise(camera, &pose, points, widening);
            if self.rotation_only {
                g.fixed_rows_mut::<3>(0).fill(0.0);
                h.fixed_view_mut::<3, 6>(0, 0).fill(0.0);
                h.fixed_view_mut::<6, 3>(0, 0).fill(0.0);
                h.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            }
            let Some(factor) = h.cholesky() else { break };
            let delta = -factor.solve(&g);
            pose = (Se3::exp(&delta) * pose).renormalized();
            if iteration > self.wide && delta.norm_squared() < self.settled {
                break;
            }
        }
        if pose.is_finite() { pose } else { *start }
    }
}

/// Normal equations of the pose; a point behind the camera adds nothing.
fn linearise(
    camera: &Pinhole,
    pose: &Se3,
    points: &[SeenPoint],
    widening: f64,
) -> (Matrix6<f64>, Vector6<f64>) {
    let mut h = Matrix6::<f64>::identity() * 1e-6;
    let mut g = Vector6::<f64>::zeros();
    let (rotation, translation) = (pose.rotation_matrix(), pose.translation);
    for point in points {
        let Some(p) =
            predict(camera, &rotation, &translation, &point.direction, point.inverse_depth, &point.pixel)
        else {
            continue;
        };
        let weight = robust_weight(mahalanobis(&p.residual, &point.information) / widening);
        let [a, b, c] = point.information.map(|v| v * weight);
        let (ju, jv) = (Vector6::from(p.by_twist[0]), Vector6::from(p.by_twist[1]));
        let (wu, wv) = (ju * a + jv * b, ju * b + jv * c);
        h.ger(1.0, &wu, &ju, 1.0);
        h.ger(1.0, &wv, &jv, 1.0);
        g += wu * p.residual[0] + wv * p.residual[1];
    }
    (h, g)
}
