//! The pose of one frame that sees points of known depth.

use super::cost::{mahalanobis, predict, robust_weight};
use geometry::{Pinhole, Se3};
use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};

/// A point of known depth, and where the frame sees it.
#[derive(Clone, Copy)]
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

/// Robust Gauss–Newton on the pose of a frame, depths fixed.
pub(crate) struct PoseSolver {
    /// Steps at most.
    pub iterations: usize,
    /// First steps that are made with a wide kernel: the start may be a few pixels off.
    pub wide: usize,
    /// Squared length of a step with the narrow kernel below which no other follows; 0 makes them all.
    pub settled: f64,
    /// Whether the translation is fixed.
    pub rotation_only: bool,
}

/// Covariance of a frame's pose `camera_from_world` by the points it sees, of its left perturbation `(υ, ω)`; `None` where they leave
/// a motion open.
pub(crate) fn covariance(camera: &Pinhole, pose: &Se3, points: &[SeenPoint]) -> Option<Matrix6<f64>> {
    Some(linearise(camera, pose, points, 1.0).0.cholesky()?.inverse())
}

/// The same by the residuals themselves, whatever was assumed of them: `A⁻¹ B Aᵀ⁻¹` of a robust estimate (Huber 1967; White 1980), where `A`
/// is the second derivative of the robust cost and `B` sums the squared gradients of the points.
pub(crate) fn robust_covariance(camera: &Pinhole, pose: &Se3, points: &[SeenPoint]) -> Option<Matrix6<f64>> {
    let (rotation, translation) = (pose.rotation_matrix(), pose.translation);
    let (mut a, mut b) = (Matrix6::<f64>::zeros(), Matrix6::<f64>::zeros());
    for point in points {
        let seen =
            predict(camera, &rotation, &translation, &point.direction, point.inverse_depth, &point.pixel);
        let Some(p) = seen else { continue };
        let squared = mahalanobis(&p.residual, &point.information);
        let weight = robust_weight(squared);
        let [xx, xy, yy] = point.information;
        let (ju, jv) = (Vector6::from(p.by_twist[0]), Vector6::from(p.by_twist[1]));
        let (wu, wv) = (ju * xx + jv * xy, ju * xy + jv * yy);
        let gradient = wu * p.residual[0] + wv * p.residual[1];
        a += (wu * ju.transpose() + wv * jv.transpose()) * weight;
        // The weight falls as the residual grows: d(2 / (1 + e²)) / d(e²) = −w² / 2.
        a.ger(-weight * weight, &gradient, &gradient, 1.0);
        b.ger(weight * weight, &gradient, &gradient, 1.0);
    }
    let inverse = a.cholesky()?.inverse();
    Some(inverse * b * inverse)
}

/// Squared residuals are divided by this under the wide kernel.
const WIDENING: f64 = 30.0;

impl PoseSolver {
    /// What squared residuals are divided by in a step: more than 1 under the wide kernel.
    pub fn widening(&self, iteration: usize) -> f64 {
        if iteration < self.wide { WIDENING } else { 1.0 }
    }

    /// The pose `camera_from_world` that agrees best with where the points are seen; `start` when there is none.
    pub fn solve(&self, camera: &Pinhole, start: &Se3, points: &[SeenPoint]) -> Se3 {
        let mut pose = *start;
        for iteration in 0..self.iterations {
            let (mut h, mut g) = linearise(camera, &pose, points, self.widening(iteration));
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

/// Adds a point to normal equations `H δ = −g`: its residual in pixels, with the derivative of that, two rows, and its weighted information.
#[inline(always)]
pub(crate) fn add_residual<const N: usize>(
    (h, g): (&mut SMatrix<f64, N, N>, &mut SVector<f64, N>),
    [ju, jv]: &[SVector<f64, N>; 2],
    residual: &[f64; 2],
    [a, b, c]: [f64; 3],
) {
    let (wu, wv) = (ju * a + jv * b, ju * b + jv * c);
    h.ger(1.0, &wu, ju, 1.0);
    h.ger(1.0, &wv, jv, 1.0);
    *g += wu * residual[0] + wv * residual[1];
}

geometry::multiversion! {
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
            let information = point.information.map(|v| v * weight);
            add_residual((&mut h, &mut g), &p.by_twist.map(Vector6::from), &p.residual, information);
        }
        (h, g)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::window::tests::spread;

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 420.0, fy: 410.0, cx: 319.5, cy: 239.5 };
    const SOLVER: PoseSolver = PoseSolver { iterations: 15, wide: 5, settled: 0.0, rotation_only: false };

    fn truth() -> Se3 {
        Se3::exp(&Vector6::new(0.05, -0.03, 0.04, 0.01, -0.015, 0.02))
    }

    /// Points as a frame at `camera_from_world` sees them; every `wrong`-th is seen far off.
    fn seen(camera_from_world: &Se3, wrong: usize) -> Vec<SeenPoint> {
        let point = |i: usize| {
            let direction = CAMERA.unproject(320.0 + 250.0 * spread(i, 0), 240.0 + 180.0 * spread(i, 1));
            let inverse_depth = 0.4 + 0.2 * spread(i, 2);
            let at = CAMERA.project(
                &(camera_from_world.rotation * direction + camera_from_world.translation * inverse_depth),
            );
            let off = if i.is_multiple_of(wrong) { 40.0 } else { 0.0 };
            SeenPoint {
                direction,
                inverse_depth,
                pixel: [at.x + off, at.y - off],
                information: [4.0, 1.0, 2.0],
            }
        };
        (1..=120).map(point).collect()
    }

    fn distance(a: &Se3, b: &Se3) -> f64 {
        (*a * b.inverse()).log().norm()
    }

    #[test]
    fn the_pose_is_found_among_wrong_sightings() {
        let found = SOLVER.solve(&CAMERA, &Se3::identity(), &seen(&truth(), 6));
        assert!(distance(&found, &truth()) < 1e-3, "off by {}", distance(&found, &truth()));
    }

    #[test]
    fn a_step_that_has_settled_ends_it() {
        let points = seen(&truth(), 1000);
        let first = PoseSolver { iterations: 2, wide: 0, ..SOLVER }.solve(&CAMERA, &Se3::identity(), &points);
        let settled = PoseSolver { wide: 0, settled: f64::INFINITY, ..SOLVER };
        assert_eq!(settled.solve(&CAMERA, &Se3::identity(), &points), first);
    }

    #[test]
    fn a_fixed_translation_stays() {
        let pure_rotation = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.02, -0.03, 0.01));
        let solver = PoseSolver { rotation_only: true, ..SOLVER };
        let found = solver.solve(&CAMERA, &Se3::identity(), &seen(&pure_rotation, 1000));
        assert!(distance(&found, &pure_rotation) < 1e-9, "off by {}", distance(&found, &pure_rotation));
        let found = solver.solve(&CAMERA, &Se3::identity(), &seen(&truth(), 1000));
        assert!(found.translation.norm() < 1e-12, "moved by {}", found.translation);
    }

    /// Positions are off by noise of which nothing is assumed: over many draws poses err as the covariance says.
    #[test]
    fn a_covariance_by_residuals_needs_no_assumption() {
        const DRAWS: usize = 60;
        let (mut nees, mut random) = (0.0, geometry::Random::new(5));
        for _ in 0..DRAWS {
            let mut points = seen(&truth(), 1000);
            points
                .iter_mut()
                .for_each(|point| point.pixel = point.pixel.map(|at| at + 0.5 * random.normal()));
            let found = SOLVER.solve(&CAMERA, &truth(), &points);
            let error = (found * truth().inverse()).log();
            let covariance = robust_covariance(&CAMERA, &found, &points).expect("the points fix all");
            nees += error.dot(&(covariance.cholesky().unwrap().solve(&error))) / 6.0 / DRAWS as f64;
        }
        assert!((0.7..1.5).contains(&nees), "the mean NEES is {nees}");
    }

    #[test]
    fn without_points_the_start_stays() {
        assert!(distance(&SOLVER.solve(&CAMERA, &truth(), &[]), &truth()) < 1e-12);
    }
}
