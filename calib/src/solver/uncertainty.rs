//! How well the parameters are known.

use super::LensModel;
use super::bundle::Normal;
use super::model::Parameters;
use faer::linalg::solvers::DenseSolveCore;
use nalgebra::DMatrix;

/// A parameter with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// `fx`, `fy`, `cx`, `cy` (pixels) or a term of the distortion.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its standard deviation, as far as the corners' scatter tells.
    pub sigma: f64,
}

/// Covariance of the camera's parameters: inverse of their information when the poses are adjusted too, times the
/// variance of a residual. With it the condition of the information, each parameter scaled to unit information.
/// `None` when some parameter is not determined at all.
pub(crate) fn covariance(normal: &Normal, model: LensModel, variance: f64) -> Option<(DMatrix<f64>, f64)> {
    let count = model.parameter_count();
    let information = normal.information(count)?;
    let scale: Vec<f64> = (0..count).map(|i| information[(i, i)].sqrt()).collect();
    if scale.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
        return None;
    }
    let scaled = faer::Mat::<f64>::from_fn(count, count, |i, j| information[(i, j)] / (scale[i] * scale[j]));
    let eigen = scaled.self_adjoint_eigenvalues(faer::Side::Lower).ok()?;
    let least = eigen.iter().copied().fold(f64::INFINITY, f64::min);
    let largest = eigen.iter().copied().fold(0.0, f64::max);
    if least <= f64::EPSILON * largest {
        return None;
    }
    let inverse = scaled.llt(faer::Side::Lower).ok()?.inverse();
    let covariance =
        DMatrix::from_fn(count, count, |i, j| inverse[(i, j)] / (scale[i] * scale[j]) * variance);
    Some((covariance, largest / least))
}

/// Each parameter with the square root of its variance.
pub(crate) fn estimates(
    model: LensModel,
    parameters: &Parameters,
    covariance: &DMatrix<f64>,
) -> Vec<Estimate> {
    let names = model.parameter_names().iter().enumerate();
    names
        .map(|(i, name)| Estimate { name, value: parameters[i], sigma: covariance[(i, i)].max(0.0).sqrt() })
        .collect()
}
