//! How well the parameters are known.

use super::LensModel;
use super::bundle::Normal;
use super::model::Parameters;
use faer::linalg::solvers::DenseSolveCore;
use nalgebra::{DMatrix, DVector};

/// A parameter with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// `fx`, `fy`, `cx`, `cy` (pixels) or a term of the distortion.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Its standard deviation: by how much it would be another had other views of the same kind been taken.
    pub sigma: f64,
}

/// Covariance of the camera's parameters. With it the condition of the information, each parameter scaled to unit
/// information. `None` when some parameter is not determined at all.
///
/// Where each corner errs by itself, that is the inverse of the information when the poses are adjusted too, times the
/// `variance` of a residual. A lens that the model does not quite fit, a board that is not quite flat and motion blur
/// bend all corners of a view alike, which by that would go unseen. So a parameter that scatters more when one view
/// after the other is left out has the standard deviation of that scatter.
pub(crate) fn covariance(normal: &Normal, model: LensModel, variance: f64) -> Option<(DMatrix<f64>, f64)> {
    let count = model.parameter_count();
    let views = normal.by_view(count)?;
    let information = views.iter().fold(DMatrix::zeros(count, count), |sum, (own, _)| sum + own);
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
    let independent =
        DMatrix::from_fn(count, count, |i, j| inverse[(i, j)] / (scale[i] * scale[j]) * variance);
    let scatter = scatter(&views, &information);
    let wider = |i: usize| {
        let ratio = scatter.as_ref().map_or(1.0, |scatter| (scatter[i] / independent[(i, i)]).sqrt());
        if ratio.is_finite() { ratio.max(1.0) } else { 1.0 }
    };
    let wider: Vec<f64> = (0..count).map(wider).collect();
    let covariance = DMatrix::from_fn(count, count, |i, j| independent[(i, j)] * wider[i] * wider[j]);
    Some((covariance, largest / least))
}

/// Variance of each parameter by how it moves, in one step, when one view after the other is left out (jackknife,
/// Efron 1982); `None` when it takes every view to determine it.
fn scatter(views: &[(DMatrix<f64>, DVector<f64>)], information: &DMatrix<f64>) -> Option<DVector<f64>> {
    let without = |(own, gradient): &(DMatrix<f64>, DVector<f64>)| {
        Some((information - own).cholesky()?.solve(gradient))
    };
    let moved = views.iter().map(without).collect::<Option<Vec<_>>>()?;
    let count = moved.len() as f64;
    let zero = || DVector::zeros(information.nrows());
    let mean = moved.iter().fold(zero(), |sum, step| sum + step) / count;
    let squared = moved.iter().fold(zero(), |sum, step| sum + (step - &mean).map(|v| v * v));
    Some(squared * ((count - 1.0) / count))
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
