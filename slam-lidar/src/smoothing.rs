//! The trajectory smoothed as loops come.
//!
//! Keyframes hang on each other by the odometry's steps, and every loop says what the steps between its ends must add
//! up to. The unknowns are the steps' errors y with covariance Σ, the loops' residuals are `r + A y` with covariance
//! R, and the minimum is `y = −Σ Aᵀ (A Σ Aᵀ + R)⁻¹ r`: a system of six unknowns a loop, whatever the length of the
//! way. So a further loop costs the length of the way it closes and not a new solution of the whole graph. Motions are
//! in SE(3); nothing here has a scale.

use geometry::Se3;
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

/// A loop: `from_from_to` was measured.
#[derive(Clone, Copy, Debug)]
pub struct Constraint {
    /// Index of the earlier pose.
    pub from: usize,
    /// Index of the later pose.
    pub to: usize,
    /// The measured motion between them.
    pub from_from_to: Se3,
    /// Standard deviations of the measurement, metres and radians.
    pub deviation: (f64, f64),
}

/// Rounds of linearisation and of weights.
const ROUNDS: usize = 8;
/// Width of the robust kernel (Geman–McClure) on a loop's residual, standard deviations; wider at first.
const KERNEL: f64 = 5.0;

/// Steps that agree with the loops as well as they can, and each loop's weight, 0–1: a wrong one ends near 0.
///
/// `steps[k]` is pose `k + 1` in the frame of pose `k`, as measured, with standard deviations `deviation`.
pub fn smooth(steps: &[Se3], deviation: (f64, f64), constraints: &[Constraint]) -> (Vec<Se3>, Vec<f64>) {
    let mut current = steps.to_vec();
    let mut errors = vec![Vector6::zeros(); steps.len()];
    let mut weights = vec![1.0; constraints.len()];
    let covariance = variances(deviation);
    for round in 0..ROUNDS {
        let rows: Vec<Row> = constraints.iter().map(|c| Row::new(c, &current, &errors)).collect();
        let Some(duals) = solve(&rows, constraints, &weights, &covariance) else { break };
        errors.iter_mut().for_each(|e| *e = Vector6::zeros());
        for (row, dual) in rows.iter().zip(&duals) {
            for (k, a) in (row.from..).zip(&row.jacobians) {
                errors[k] -= covariance.component_mul(&(a.transpose() * dual));
            }
        }
        for ((step, measured), error) in current.iter_mut().zip(steps).zip(&errors) {
            *step = *measured * Se3::exp(error);
        }
        // Graduated: the kernel narrows round by round, so that a true loop after a long way is not lost.
        let width = KERNEL * f64::max(1.0, 64.0 * 0.25f64.powi(round as i32));
        for (weight, c) in weights.iter_mut().zip(constraints) {
            let residual = residual(c, &current);
            let squared = residual.component_div(&variances(c.deviation)).dot(&residual);
            *weight = (width * width / (width * width + squared)).powi(2);
        }
    }
    (current, weights)
}

fn variances((translation, rotation): (f64, f64)) -> Vector6<f64> {
    let (t, r) = (translation * translation, rotation * rotation);
    Vector6::new(t, t, t, r, r, r)
}

fn residual(constraint: &Constraint, steps: &[Se3]) -> Vector6<f64> {
    let predicted = steps[constraint.from..constraint.to].iter().fold(Se3::identity(), |p, step| p * *step);
    (constraint.from_from_to.inverse() * predicted).log()
}

/// A loop's residual without the errors that the steps have now, and its derivatives by them.
struct Row {
    from: usize,
    residual: Vector6<f64>,
    jacobians: Vec<Matrix6<f64>>,
}

impl Row {
    fn new(constraint: &Constraint, steps: &[Se3], errors: &[Vector6<f64>]) -> Self {
        let (from, to) = (constraint.from, constraint.to);
        let mut jacobians = vec![Matrix6::zeros(); to - from];
        let mut rest = Se3::identity();
        // A right increment of a step is carried through the steps after it.
        for k in (from..to).rev() {
            jacobians[k - from] = rest.inverse().adjoint();
            rest = steps[k] * rest;
        }
        let now: Vector6<f64> = jacobians.iter().zip(&errors[from..to]).map(|(a, e)| a * e).sum();
        Self { from, residual: residual(constraint, steps) - now, jacobians }
    }

    /// `A Σ Bᵀ` over the steps that both loops go through.
    fn shared(&self, other: &Self, covariance: &Vector6<f64>) -> Matrix6<f64> {
        let start = self.from.max(other.from);
        let end = (self.from + self.jacobians.len()).min(other.from + other.jacobians.len());
        let product = |k: usize| {
            let (a, b) = (&self.jacobians[k - self.from], &other.jacobians[k - other.from]);
            a * Matrix6::from_diagonal(covariance) * b.transpose()
        };
        (start..end).map(product).sum()
    }
}

/// `(A Σ Aᵀ + R)⁻¹ r`, loop by loop; none when there is no loop or rounding makes the system indefinite.
fn solve(
    rows: &[Row],
    constraints: &[Constraint],
    weights: &[f64],
    covariance: &Vector6<f64>,
) -> Option<Vec<Vector6<f64>>> {
    let n = rows.len();
    let (mut system, mut right) = (DMatrix::zeros(6 * n, 6 * n), DVector::zeros(6 * n));
    for i in 0..n {
        for j in 0..=i {
            let mut block = rows[i].shared(&rows[j], covariance);
            if i == j {
                block +=
                    Matrix6::from_diagonal(&(variances(constraints[i].deviation) / weights[i].max(1e-9)));
            }
            system.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(&block);
            system.fixed_view_mut::<6, 6>(6 * j, 6 * i).copy_from(&block.transpose());
        }
        right.fixed_rows_mut::<6>(6 * i).copy_from(&rows[i].residual);
    }
    let solution = (n > 0).then(|| system.cholesky())??.solve(&right);
    Some((0..n).map(|i| solution.fixed_rows::<6>(6 * i).into_owned()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A round way of 100 steps that drifts by some centimetres a turn, and the true steps.
    fn ring() -> (Vec<Se3>, Vec<Se3>) {
        let step = |drift: f64| {
            Se3::exp(&Vector6::new(
                0.5 + 1e-3 * drift,
                0.0,
                0.0,
                0.0,
                0.0,
                std::f64::consts::TAU / 50.0 + 2e-4 * drift,
            ))
        };
        let truth = vec![step(0.0); 100];
        let measured = (0..100).map(|k| step(f64::from(k % 3))).collect();
        (truth, measured)
    }

    fn ends(steps: &[Se3]) -> f64 {
        steps.iter().fold(Se3::identity(), |p, s| p * *s).translation.norm()
    }

    #[test]
    fn loops_take_the_drift_away_and_wrong_ones_do_not_count() {
        let (truth, measured) = ring();
        let between = |from: usize, to: usize| truth[from..to].iter().fold(Se3::identity(), |p, s| p * *s);
        let deviation = (0.01, 0.002);
        let mut loops: Vec<Constraint> = [(0, 100), (0, 50), (10, 60), (20, 70), (30, 80)]
            .map(|(from, to)| Constraint { from, to, from_from_to: between(from, to), deviation })
            .into();
        let wrong = Se3::exp(&Vector6::new(4.0, 0.0, 0.0, 0.0, 0.0, 0.0)) * between(40, 90);
        loops.push(Constraint { from: 40, to: 90, from_from_to: wrong, deviation });
        assert!(ends(&measured) > 0.03, "{}", ends(&measured));
        let (smoothed, weights) = smooth(&measured, (0.005, 0.001), &loops);
        assert!(ends(&smoothed) < 0.005, "{}", ends(&smoothed));
        assert!(weights[..5].iter().all(|w| *w > 0.8) && weights[5] < 0.01, "{weights:?}");
        assert_eq!(smooth(&measured, (0.005, 0.001), &[]).0, measured);
    }
}
