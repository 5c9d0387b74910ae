//! The linear Kalman filter on `x = (σ, t)`.

use super::PointMatch;
use nalgebra::{Cholesky, Const, Matrix3, Matrix3x4, Matrix4, Vector3, Vector4};

/// A match with the source point turned into the target camera's axes.
pub(super) struct Observation {
    /// `R p_s`, source units.
    pub source: Vector3<f64>,
    /// `R P_s Rᵀ`.
    pub source_covariance: Matrix3<f64>,
    /// `p_t`, target units.
    pub target: Vector3<f64>,
    /// `P_t`.
    pub target_covariance: Matrix3<f64>,
}

/// Mean and covariance of `(σ, t)`.
#[derive(Clone)]
pub(super) struct State {
    pub mean: Vector4<f64>,
    pub covariance: Matrix4<f64>,
}

/// Standard deviation of the vague prior, in multiples of σ and of the points' distance: it must say next to
/// nothing against a handful of matches, yet leave the first update well conditioned.
const VAGUE: f64 = 100.0;

impl State {
    /// A prior about `state` that says next to nothing.
    pub(super) fn vague(state: &State, observations: &[Observation]) -> Self {
        let distance = observations.iter().map(|o| o.target.norm()).sum::<f64>() / observations.len() as f64;
        let (scale, translation) = ((VAGUE * state.mean[0]).powi(2), (VAGUE * distance).powi(2));
        let variances = Vector4::new(scale, translation, translation, translation);
        Self { mean: state.mean, covariance: Matrix4::from_diagonal(&variances) }
    }
}

impl Observation {
    /// `rotation` is R, target_from_source.
    pub(super) fn new(pair: &PointMatch, rotation: &Matrix3<f64>) -> Self {
        Self {
            source: rotation * pair.source.position,
            source_covariance: rotation * pair.source.covariance * rotation.transpose(),
            target: pair.target.position,
            target_covariance: pair.target.covariance,
        }
    }

    /// `p_t − σ R p_s − t`, target units.
    pub(super) fn residual(&self, mean: &Vector4<f64>) -> Vector3<f64> {
        self.target - self.source * mean[0] - mean.fixed_rows::<3>(1)
    }

    /// Covariance of the residual at `scale`, `P_t + σ² R P_s Rᵀ`.
    pub(super) fn noise(&self, scale: f64) -> Matrix3<f64> {
        self.target_covariance + self.source_covariance * (scale * scale)
    }

    /// Squared Mahalanobis distance of the residual, χ² with 3 degrees of freedom for a right match and a
    /// well-known state; `None` if the noise is not positive definite.
    pub(super) fn squared_distance(&self, state: &State) -> Option<f64> {
        let residual = self.residual(&state.mean);
        let noise = self.noise(state.mean[0]).cholesky()?;
        Some(residual.dot(&noise.solve(&residual)))
    }

    /// The measurement `z = H x + noise` linearised about `about`: `(z, H, covariance of the noise)`.
    ///
    /// H holds the source point q̂ as match and state together put it, not as measured; z makes up for it.
    fn linearised(&self, about: &State) -> Option<(Vector3<f64>, Matrix3x4<f64>, Matrix3<f64>)> {
        let scale = about.mean[0];
        let noise = self.noise(scale);
        let weighted = noise.cholesky()?.solve(&self.residual(&about.mean));
        let correction = self.source_covariance * weighted * scale;
        let mut h = Matrix3x4::zeros();
        h.set_column(0, &(self.source + correction));
        h.fixed_view_mut::<3, 3>(0, 1).fill_with_identity();
        Some((self.target + correction * scale, h, noise))
    }
}

/// One pass of the filter: from `prior`, one update per observation in order, linearised about `about`.
/// `None` if an innovation's covariance is not positive definite.
pub(super) fn pass<'a>(
    prior: &State,
    about: &State,
    observations: impl Iterator<Item = &'a Observation>,
) -> Option<State> {
    let mut state = prior.clone();
    for observation in observations {
        let (z, h, noise) = observation.linearised(about)?;
        let innovation: Cholesky<f64, Const<3>> =
            (h * state.covariance * h.transpose() + noise).cholesky()?;
        let gain = innovation.solve(&(h * state.covariance)).transpose();
        state.mean += gain * (z - h * state.mean);
        // Joseph's form keeps the covariance symmetric and positive.
        let keep = Matrix4::identity() - gain * h;
        state.covariance = keep * state.covariance * keep.transpose() + gain * noise * gain.transpose();
    }
    Some(state)
}
