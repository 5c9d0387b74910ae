//! The Gauss–Newton step, and the motion that the points constrain least.

use super::covariance::{Correspondence, Tangent, TangentMatrix};
use super::error::OpenDirection;

/// Longest step: a rotation by 0.3 rad or a translation by 0.3 extents. Beyond, the linearisation means nothing.
const LONGEST: f64 = 0.3;

/// Damping, relative to the mean diagonal: keeps steps along directions that the points leave open finite.
const DAMPING: f64 = 1e-6;

/// The step x that lowers `Σ Gᵀ Ω G`, zero where nothing pulls; λ = 0 unless the scale is estimated.
pub(super) fn step(correspondences: &[Correspondence], estimate_scale: bool) -> Tangent {
    let mut hessian = TangentMatrix::zeros();
    let mut gradient = Tangent::zeros();
    for c in correspondences {
        let jacobian = c.jacobian();
        let weighted = c.metric * jacobian;
        hessian += jacobian.transpose() * weighted;
        gradient += weighted.transpose() * c.residual;
    }
    if !estimate_scale {
        fix_scale(&mut hessian);
        gradient[6] = 0.0;
    }
    let mean = hessian.trace() / 7.0;
    hessian += TangentMatrix::identity() * (mean * DAMPING);
    let Some(cholesky) = hessian.cholesky() else { return Tangent::zeros() };
    let step = -cholesky.solve(&gradient);
    step * (LONGEST / step.norm()).min(1.0)
}

/// Takes λ out of a matrix, leaving a mean diagonal in its place.
fn fix_scale(matrix: &mut TangentMatrix) {
    let mean = matrix.fixed_view::<6, 6>(0, 0).trace() / 6.0;
    matrix.row_mut(6).fill(0.0);
    matrix.column_mut(6).fill(0.0);
    matrix[(6, 6)] = mean;
}

/// The unit tangent with the smallest `xᵀ matrix x`, and that value.
pub(super) fn least_constrained(mut matrix: TangentMatrix, estimate_scale: bool) -> OpenDirection {
    if !estimate_scale {
        // Larger than any eigenvalue: λ is never the worst.
        let trace = matrix.trace();
        fix_scale(&mut matrix);
        matrix[(6, 6)] = trace + 1.0;
    }
    let eigen = matrix.symmetric_eigen();
    let least = eigen.eigenvalues.imin();
    OpenDirection {
        tangent: eigen.eigenvectors.column(least).into_owned(),
        constraint: eigen.eigenvalues[least].max(0.0),
    }
}
