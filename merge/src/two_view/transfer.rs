//! How well matches fit a plane, or a turn without translation, and the refinement of both.
//!
//! A homography predicts where the ray of the target is; the error of a match has two rows, is Sampson's too, and in
//! radians: what the two rays must turn together to agree.

use super::epipolar::{linearise, moved, turned};
use super::least_squares::{Problem, Sink};
use super::linear::{PlanePose, Pose};
use super::rays::{Rays, tangent_basis};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix3x2, SMatrix, SVector, Vector2, Vector3};

/// The error across the target's ray, its covariance for unit noise, and whether the point is in front.
fn misfit(rays: &Rays, homography: &Matrix3<f64>, index: usize) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let predicted = homography * rays.source[index];
    let basis = &rays.target_basis[index];
    let depth = rays.target[index].dot(&predicted);
    let ahead = depth > 1e-9;
    if !ahead {
        return None;
    }
    let stretch = basis.tr_mul(&(homography * rays.source_basis[index]));
    let covariance = Matrix2::identity() * (depth * depth) + stretch * stretch.transpose();
    Some((basis.tr_mul(&predicted), covariance))
}

/// Squared error of a match under a homography, squared radians; infinite behind the camera.
pub(super) fn squared_error(rays: &Rays, homography: &Matrix3<f64>, index: usize) -> f64 {
    let Some((error, c)) = misfit(rays, homography, index) else {
        return f64::INFINITY;
    };
    let determinant = c.m11 * c.m22 - c.m12 * c.m12;
    (c.m22 * error.x * error.x - 2.0 * c.m12 * error.x * error.y + c.m11 * error.y * error.y) / determinant
}

/// The cost of a homography, as [`super::epipolar::cost`].
pub(super) fn cost(rays: &Rays, homography: &Matrix3<f64>, limit: f64, best: f64) -> Option<f64> {
    let mut sum = 0.0;
    for index in 0..rays.len() {
        sum += squared_error(rays, homography, index).min(limit);
        // Also stops at a NaN.
        let can_win = sum < best;
        if !can_win {
            return None;
        }
    }
    Some(sum)
}

/// The matches whose squared error is below `limit`.
pub(super) fn inliers(rays: &Rays, homography: &Matrix3<f64>, limit: f64) -> Vec<usize> {
    (0..rays.len()).filter(|&i| squared_error(rays, homography, i) < limit).collect()
}

/// The error of a match, whitened, with what whitens its derivatives.
fn whitened(rays: &Rays, homography: &Matrix3<f64>, index: usize) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    let (error, covariance) = misfit(rays, homography, index)?;
    let root = covariance.cholesky()?.unpack();
    let residual = root.solve_lower_triangular(&error)?;
    let whitening = root.solve_lower_triangular(&rays.target_basis[index].transpose())?;
    Some((residual, whitening))
}

/// The rotation that fits some matches best, with no translation.
pub(super) struct RotationFit<'a> {
    pub(super) rays: &'a Rays,
    pub(super) matches: &'a [usize],
}

impl Problem<3> for RotationFit<'_> {
    type State = Matrix3<f64>;

    fn residuals(&self, state: &Matrix3<f64>, sink: &mut impl Sink<3>) {
        for &index in self.matches {
            if let Some((residual, whitening)) = whitened(self.rays, state, index) {
                let source = state * self.rays.source[index];
                sink.add(residual, -whitening * source.cross_matrix());
            }
        }
    }

    fn step(&self, state: &Matrix3<f64>, by: &SVector<f64, 3>) -> Matrix3<f64> {
        turned(state, by)
    }
}

/// The pose and plane that fit best: matches on the plane by both rows of their error, others by their epipolar
/// error.
pub(super) struct PlaneFit<'a> {
    pub(super) rays: &'a Rays,
    pub(super) on_plane: &'a [usize],
    pub(super) off_plane: &'a [usize],
}

impl PlaneFit<'_> {
    fn add_off_plane(&self, state: &PlanePose, pose: &Pose, sink: &mut impl Sink<8>) {
        let length = state.shift.norm();
        let across = Matrix3::identity() - pose.direction * pose.direction.transpose();
        for &index in self.off_plane {
            let (residual, by_rotation, by_direction) =
                linearise(self.rays, index, &pose.rotation, &pose.direction);
            let mut jacobian = SMatrix::<f64, 1, 8>::zeros();
            jacobian.fixed_columns_mut::<3>(0).copy_from(&by_rotation.transpose());
            jacobian.fixed_columns_mut::<3>(3).copy_from(&(across * by_direction / length).transpose());
            sink.add(nalgebra::Vector1::new(residual), jacobian);
        }
    }
}

impl Problem<8> for PlaneFit<'_> {
    type State = PlanePose;

    fn residuals(&self, state: &PlanePose, sink: &mut impl Sink<8>) {
        let homography = state.homography();
        let basis = tangent_basis(&state.normal);
        for &index in self.on_plane {
            let Some((residual, whitening)) = whitened(self.rays, &homography, index) else {
                continue;
            };
            let source = &self.rays.source[index];
            let mut jacobian = SMatrix::<f64, 2, 8>::zeros();
            let turned = state.rotation * source;
            jacobian.fixed_columns_mut::<3>(0).copy_from(&(-whitening * turned.cross_matrix()));
            jacobian.fixed_columns_mut::<3>(3).copy_from(&(whitening * state.normal.dot(source)));
            let by_normal = whitening * state.shift * basis.tr_mul(source).transpose();
            jacobian.fixed_columns_mut::<2>(6).copy_from(&by_normal);
            sink.add(residual, jacobian);
        }
        if let Some(pose) = state.pose() {
            self.add_off_plane(state, &pose, sink);
        }
    }

    fn step(&self, state: &PlanePose, by: &SVector<f64, 8>) -> PlanePose {
        PlanePose {
            rotation: turned(&state.rotation, &by.fixed_rows::<3>(0).into_owned()),
            shift: state.shift + by.fixed_rows::<3>(3),
            normal: moved(&state.normal, &by.fixed_rows::<2>(6).into_owned()),
        }
    }
}

/// What turns small changes of [`PlaneFit`]'s unknowns into those of rotation and direction.
pub(super) fn pose_by_plane(shift: &Vector3<f64>) -> SMatrix<f64, 5, 8> {
    let length = shift.norm();
    let basis: Matrix3x2<f64> = tangent_basis(&(shift / length));
    let mut derivative = SMatrix::<f64, 5, 8>::zeros();
    derivative.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    derivative.fixed_view_mut::<2, 3>(3, 3).copy_from(&(basis.transpose() / length));
    derivative
}
