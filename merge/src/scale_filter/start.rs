//! A first estimate that wrong matches cannot spoil.

use super::filter::{Observation, State};
use nalgebra::{Matrix3x4, Matrix4, Vector4};

/// The median of `|p_t| / |p_s|`, in logarithms.
pub(super) fn distance_ratio(observations: &[Observation]) -> f64 {
    let mut logs: Vec<f64> = observations.iter().map(|o| (o.target.norm() / o.source.norm()).ln()).collect();
    logs.sort_by(f64::total_cmp);
    let middle = logs.len() / 2;
    let median = if logs.len() % 2 == 1 { logs[middle] } else { 0.5 * (logs[middle - 1] + logs[middle]) };
    median.exp()
}

/// Factor by which the control parameter grows (Yang et al. 2020, §V-A).
const GROWTH: f64 = 1.4;
/// Bound on the rounds: the control parameter then spans 14 powers of ten.
const MAX_ROUNDS: usize = 100;

/// `(σ, t)` by graduated non-convexity with truncated least squares (Yang et al. 2020, Eqs. 12–14), the
/// covariance of the noise taken at `scale`; `gate` is the truncation, a squared Mahalanobis distance.
/// `None` if the points leave the state open.
pub(super) fn graduated(observations: &[Observation], scale: f64, gate: f64) -> Option<State> {
    let informations =
        observations.iter().map(|o| o.noise(scale).try_inverse()).collect::<Option<Vec<_>>>()?;
    let squared_distances = |mean: &Vector4<f64>| -> Vec<f64> {
        let distance = |(o, w): (&Observation, _)| {
            let residual = o.residual(mean);
            residual.dot(&(w * residual))
        };
        observations.iter().zip(&informations).map(distance).collect()
    };
    let solve = |weights: &[f64]| {
        let (mut information, mut vector) = (Matrix4::zeros(), Vector4::zeros());
        for ((o, w), &weight) in observations.iter().zip(&informations).zip(weights) {
            let mut h = Matrix3x4::zeros();
            h.set_column(0, &o.source);
            h.fixed_view_mut::<3, 3>(0, 1).fill_with_identity();
            let weighted = h.transpose() * w * weight;
            information += weighted * h;
            vector += weighted * o.target;
        }
        let covariance = information.try_inverse()?;
        Some(State { mean: covariance * vector, covariance })
    };

    let mut state = solve(&vec![1.0; observations.len()])?;
    let mut distances = squared_distances(&state.mean);
    let largest = distances.iter().copied().fold(0.0, f64::max);
    if largest <= gate {
        return positive(state);
    }
    let mut control = gate / (2.0 * largest - gate);
    for _ in 0..MAX_ROUNDS {
        let weights: Vec<f64> = distances.iter().map(|&d| weight(d, gate, control)).collect();
        state = solve(&weights)?;
        distances = squared_distances(&state.mean);
        if weights.iter().all(|&w| w == 0.0 || w == 1.0) {
            break;
        }
        control *= GROWTH;
    }
    positive(state)
}

/// The weight of a residual of squared distance `d` (Yang et al. 2020, Eq. 14).
fn weight(d: f64, gate: f64, control: f64) -> f64 {
    if d <= control / (control + 1.0) * gate {
        1.0
    } else if d >= (control + 1.0) / control * gate {
        0.0
    } else {
        (gate / d * control * (control + 1.0)).sqrt() - control
    }
}

/// The state if its scale is finite and positive.
fn positive(state: State) -> Option<State> {
    Some(state).filter(|state| state.mean.iter().all(|v| v.is_finite()) && state.mean[0] > 0.0)
}
