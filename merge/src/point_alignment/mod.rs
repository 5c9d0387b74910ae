//! Similarity between two keyframes from all matched key points with depth.
//!
//! The paper stops at R of the eight-point algorithm and σ, t of the Kalman filter, one after the other: an error
//! of R stays. Here all seven are refined together, over the same matches, each weighted by the covariance of both
//! its points (Segal 2009, "Generalized-ICP", Eq. 2, with known correspondences), with a robust kernel.
//! Noise in the source points is dealt with as in [`scale_filter`](crate::scale_filter): by the Gauss–Helmert
//! model, so that the scale is not drawn towards zero.

#[cfg(test)]
mod tests;

use crate::scale_filter::PointMatch;
use geometry::{Sim3, hat};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// How the similarity is refined over key points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PointAlignmentParams {
    /// Mahalanobis distance at which a match has half the weight of a perfect one (Cauchy's kernel). Default 3;
    /// 1 to 10. Higher trusts the covariances more.
    pub kernel_width: f64,
    /// Largest squared Mahalanobis distance of a match that counts as an inlier. Default 16.266, the 99.9 %
    /// quantile of χ² with 3 degrees of freedom; 6 to 30.
    pub gate: f64,
    /// Fewest inliers; below it there is no result. Default 12; at least 4.
    pub min_inliers: usize,
    /// Least share of inliers among the matches. Default 0.4; 0 to 1.
    pub min_inlier_share: f64,
    /// Most iterations. Default 30; at least 1. Five to ten are usual.
    pub max_iterations: usize,
}

impl Default for PointAlignmentParams {
    fn default() -> Self {
        Self { kernel_width: 3.0, gate: 16.266, min_inliers: 12, min_inlier_share: 0.4, max_iterations: 30 }
    }
}

impl PointAlignmentParams {
    /// Cauchy's weight of a match of squared Mahalanobis distance `squared`.
    fn weight(&self, squared: f64) -> f64 {
        1.0 / (1.0 + squared / self.kernel_width.powi(2))
    }
}

/// A similarity between two keyframes with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointAlignment {
    /// Maps points of the source's camera frame and unit into the target's.
    pub target_from_source: Sim3,
    /// Information of the left perturbation `true = exp(ε) ∘ target_from_source`, tangent order (υ, ω, λ).
    pub information: SMatrix<f64, 7, 7>,
    /// Which matches are inliers, in the order given.
    pub inliers: Vec<bool>,
    /// How many they are.
    pub inlier_count: usize,
    /// Mean squared Mahalanobis distance of the inliers over its expectation, 3: about 1 where the covariances
    /// are right.
    pub normalised_error: f64,
}

/// Why there is no similarity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum PointAlignmentRefusal {
    /// The start is not finite.
    #[error("the starting similarity is not finite")]
    InvalidStart,
    /// The matches leave a degree of freedom open.
    #[error("the matched points leave the similarity open: they lie on a line or too close together")]
    Degenerate,
    /// Too few matches agree.
    #[error("only {inliers} of {given} matched points agree with one similarity")]
    FewInliers {
        /// Matches that agree.
        inliers: usize,
        /// Matches given.
        given: usize,
    },
}

/// Change of the estimate, in units of its own standard deviation, below which it has converged.
const CONVERGED: f64 = 1e-4;

/// Refines `start`, target_from_source, over `matches`.
pub fn align_points(
    matches: &[PointMatch],
    start: Sim3,
    params: &PointAlignmentParams,
) -> Result<PointAlignment, PointAlignmentRefusal> {
    if !start.is_valid() {
        return Err(PointAlignmentRefusal::InvalidStart);
    }
    let mut target_from_source = start;
    for _ in 0..params.max_iterations.max(1) {
        let system =
            System::build(matches, &target_from_source, params.gate, |squared| params.weight(squared));
        let step =
            system.hessian.cholesky().ok_or(PointAlignmentRefusal::Degenerate)?.solve(&system.gradient);
        target_from_source = Sim3::exp(&step) * target_from_source;
        if !target_from_source.is_valid() {
            return Err(PointAlignmentRefusal::Degenerate);
        }
        if step.dot(&(system.hessian * step)) < CONVERGED * CONVERGED {
            break;
        }
    }
    finish(matches, target_from_source, params)
}

/// The evidence of the converged estimate.
fn finish(
    matches: &[PointMatch],
    target_from_source: Sim3,
    params: &PointAlignmentParams,
) -> Result<PointAlignment, PointAlignmentRefusal> {
    // Inliers count in full here: the kernel's weights would understate what is known.
    let unit = |squared: f64| if squared <= params.gate { 1.0 } else { 0.0 };
    let system = System::build(matches, &target_from_source, params.gate, unit);
    let inlier_count = system.inliers.iter().filter(|inlier| **inlier).count();
    let needed =
        params.min_inliers.max(4).max((params.min_inlier_share * matches.len() as f64).ceil() as usize);
    if inlier_count < needed {
        return Err(PointAlignmentRefusal::FewInliers { inliers: inlier_count, given: matches.len() });
    }
    let normalised_error = system.inlier_error / (3.0 * inlier_count as f64);
    let information = (system.hessian + system.hessian.transpose()) * (0.5 / normalised_error.max(1.0));
    if information.cholesky().is_none() {
        return Err(PointAlignmentRefusal::Degenerate);
    }
    Ok(PointAlignment {
        target_from_source,
        information,
        inliers: system.inliers,
        inlier_count,
        normalised_error,
    })
}

/// The normal equations at an estimate.
struct System {
    hessian: SMatrix<f64, 7, 7>,
    gradient: SVector<f64, 7>,
    inliers: Vec<bool>,
    /// Sum of the inliers' squared Mahalanobis distances.
    inlier_error: f64,
}

impl System {
    /// `weight` gives that of a match from its squared Mahalanobis distance.
    fn build(
        matches: &[PointMatch],
        target_from_source: &Sim3,
        gate: f64,
        weight: impl Fn(f64) -> f64,
    ) -> Self {
        let linear = target_from_source.rotation.to_rotation_matrix().into_inner() * target_from_source.scale;
        let mut system = Self {
            hessian: SMatrix::zeros(),
            gradient: SVector::zeros(),
            inliers: Vec::with_capacity(matches.len()),
            inlier_error: 0.0,
        };
        for pair in matches {
            system.add(pair, target_from_source, &linear, gate, &weight);
        }
        system
    }

    fn add(
        &mut self,
        pair: &PointMatch,
        target_from_source: &Sim3,
        linear: &Matrix3<f64>,
        gate: f64,
        weight: &impl Fn(f64) -> f64,
    ) {
        let moved = *target_from_source * pair.source.position;
        let residual = pair.target.position - moved;
        let noise = pair.target.covariance + linear * pair.source.covariance * linear.transpose();
        let Some(information) = noise.cholesky().map(|c| c.inverse()) else {
            self.inliers.push(false);
            return;
        };
        let weighted = information * residual;
        let squared = residual.dot(&weighted);
        let inlier = squared <= gate;
        self.inliers.push(inlier);
        if inlier {
            self.inlier_error += squared;
        }
        // Where the estimate and both measurements together put the source point, in the target's frame.
        let corrected = moved + linear * pair.source.covariance * linear.transpose() * weighted;
        let jacobian = left_jacobian(&corrected);
        let weight = weight(squared);
        self.hessian += jacobian.transpose() * information * jacobian * weight;
        self.gradient += jacobian.transpose() * weighted * weight;
    }
}

/// Derivative of `exp(ε) p` by ε at 0, tangent order (υ, ω, λ).
pub(crate) fn left_jacobian(point: &Vector3<f64>) -> SMatrix<f64, 3, 7> {
    let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-hat(point)));
    jacobian.set_column(6, point);
    jacobian
}
