//! What PCR-Pro measures of a keyframe pair.

use crate::estimate::Estimate;
use crate::pair::{PairParams, PairRefusal, matched_points, view_pair};
use crate::prepared::PreparedKeyframe;
use crate::scale_filter::{PairScale, pair_scale};
use geometry::{Sim3, hat};
use nalgebra::{Matrix3, SMatrix, UnitQuaternion};

/// R of the eight-point algorithm, then σ and t of the Kalman filter (§IV-C1 and §IV-C2).
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// γ: how many key points match.
    pub match_count: usize,
    /// R, target_from_source.
    pub rotation: UnitQuaternion<f64>,
    /// Covariance of ω in `R_true = exp(ω) R`, rad².
    pub rotation_covariance: Matrix3<f64>,
    /// σ and t, target keyframe units.
    pub scale: PairScale,
}

impl Measurement {
    /// Measures a pair of keyframes.
    ///
    /// # Errors
    /// When the images do not fit or the depths leave no scale.
    pub fn new(
        source: &PreparedKeyframe,
        target: &PreparedKeyframe,
        params: &PairParams,
    ) -> Result<Self, PairRefusal> {
        let views = view_pair(source, target, params)?;
        let rotation = views.relative_pose.target_from_source;
        let scale = pair_scale(&matched_points(source, target, &views), &rotation, &params.scale_filter)?;
        Ok(Self {
            match_count: views.match_count(),
            rotation,
            rotation_covariance: views.relative_pose.rotation_covariance,
            scale,
        })
    }

    /// The similarity of Eq. 1, target_from_source.
    pub fn target_from_source(&self) -> Sim3 {
        Sim3::new(self.rotation, self.scale.translation, self.scale.scale)
    }

    /// Variance of ln σ.
    pub fn log_scale_variance(&self) -> f64 {
        self.scale.variance / (self.scale.scale * self.scale.scale)
    }

    /// The similarity with its information. R is estimated before σ and t, which take it as exact; their errors are
    /// taken as independent here. `None` where a covariance is singular.
    pub fn estimate(&self) -> Option<Estimate> {
        let (scale, translation) = (self.scale.scale, self.scale.translation);
        // Of ε in `true = exp(ε) ∘ T` by (ω, σ, t): t_true = t + υ + ω × t + λ t and σ_true = σ + λ σ.
        let mut by_parts = SMatrix::<f64, 7, 7>::zeros();
        by_parts.fixed_view_mut::<3, 3>(0, 0).copy_from(&hat(&translation));
        by_parts.fixed_view_mut::<3, 1>(0, 3).copy_from(&(-translation / scale));
        by_parts.fixed_view_mut::<3, 3>(0, 4).fill_with_identity();
        by_parts.fixed_view_mut::<3, 3>(3, 0).fill_with_identity();
        by_parts[(6, 3)] = scale.recip();
        let mut covariance = SMatrix::<f64, 7, 7>::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation_covariance);
        covariance.fixed_view_mut::<4, 4>(3, 3).copy_from(&self.scale.covariance);
        let information = (by_parts * covariance * by_parts.transpose()).cholesky()?.inverse();
        Some(Estimate { a_from_b: self.target_from_source(), information })
    }
}
