//! The reciprocal check: two alignments, each way, must undo each other.

use super::{Sim3AlignParams, Sim3Alignment};
use geometry::Sim3;
use nalgebra::{SMatrix, SVector};

/// What the alignments both ways say together.
#[derive(Clone, Debug, PartialEq)]
pub struct ReciprocalVerdict {
    /// `log(a_from_b ∘ b_from_a)`, zero when they undo each other; tangent order (υ, ω, λ).
    pub error: SVector<f64, 7>,
    /// The error's length in standard deviations of both alignments together (Engel 2014, Eq. 20).
    pub mahalanobis: f64,
    /// Whether that is within [`Sim3AlignParams::max_reciprocal_error`].
    pub consistent: bool,
    /// Information-weighted mean of `a_from_b` and `b_from_a⁻¹`.
    pub a_from_b: Sim3,
    /// Its information as left perturbation. Both alignments use the same two images, so it is the
    /// mean of the two, not their sum.
    pub information: SMatrix<f64, 7, 7>,
}

/// Compares the alignment of b in a with that of a in b; `None` when an information is singular.
pub fn reciprocal(
    a_from_b: &Sim3Alignment,
    b_from_a: &Sim3Alignment,
    params: &Sim3AlignParams,
) -> Option<ReciprocalVerdict> {
    let (forward, backward) = (a_from_b.target_from_source, b_from_a.target_from_source);
    let error = (forward * backward).log();
    // exp(ε₁) F exp(ε₂) B = exp(ε₁ + Ad_F ε₂) F B to first order.
    let adjoint = forward.adjoint();
    let backward_covariance = b_from_a.information.try_inverse()?;
    let moved = adjoint * backward_covariance * adjoint.transpose();
    let covariance = a_from_b.information.try_inverse()? + moved;
    let squared = error.dot(&covariance.cholesky()?.solve(&error));
    let mahalanobis = squared.max(0.0).sqrt();
    // B⁻¹ = exp(−log(F B)) F up to first order in the error, with the covariance moved as above.
    let backward_information = moved.try_inverse()?;
    let sum = a_from_b.information + backward_information;
    let towards_backward =
        sum.try_inverse()? * backward_information * (backward.inverse() * forward.inverse()).log();
    Some(ReciprocalVerdict {
        error,
        mahalanobis,
        consistent: mahalanobis <= params.max_reciprocal_error,
        a_from_b: Sim3::exp(&towards_backward) * forward,
        information: (sum + sum.transpose()) * 0.25,
    })
}
