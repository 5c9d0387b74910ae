//! The trajectory optimised whenever a loop is closed, in place of the paper's ISAM (§3.2.3).
//!
//! Odometry steps connect successive keyframes, and every loop measures the sum of the steps between its two keyframes.
//! The unknowns are the steps' errors y with covariance Σ, the loops' residuals are `r + A y` with covariance
//! R, and the minimum is `y = −Σ Aᵀ (A Σ Aᵀ + R)⁻¹ r`: a system of six unknowns a loop, whatever the length of the
//! way, whose blocks are differences of sums along it. So a further loop costs one walk along the way and no solution of the whole graph. Motions are
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
/// `steps[k]` is pose `k + 1` in the frame of pose `k`, as measured, with `covariances[k]` of a right increment (υ, ω), m² and rad².
pub fn smooth(
    steps: &[Se3],
    covariances: &[Matrix6<f64>],
    constraints: &[Constraint],
) -> (Vec<Se3>, Vec<f64>) {
    let mut current = steps.to_vec();
    let mut errors = vec![Vector6::zeros(); steps.len()];
    let mut weights = vec![1.0; constraints.len()];
    for round in 0..ROUNDS {
        let chain = Chain::new(&current, &errors, covariances);
        let rows: Vec<Row> = constraints.iter().map(|c| Row::new(c, &chain)).collect();
        let Some(duals) = solve(&rows, constraints, &weights, &chain) else { break };
        errors = chain.errors(&rows, &duals, covariances);
        for ((step, measured), error) in current.iter_mut().zip(steps).zip(&errors) {
            *step = *measured * Se3::exp(error);
        }
        // Graduated: the kernel narrows round by round, so that a true loop after a long way is not lost.
        let width = KERNEL * f64::max(1.0, 64.0 * 0.25f64.powi(round as i32));
        let poses = poses(&current);
        for (weight, c) in weights.iter_mut().zip(constraints) {
            let residual = residual(c, &poses);
            let squared = residual.component_div(&variances(c.deviation)).dot(&residual);
            *weight = (width * width / (width * width + squared)).powi(2);
        }
    }
    (current, weights)
}

/// The covariance of errors that are the same along all axes, standard deviations in metres and radians.
pub(crate) fn isotropic(deviation: (f64, f64)) -> Matrix6<f64> {
    Matrix6::from_diagonal(&variances(deviation))
}

fn variances((translation, rotation): (f64, f64)) -> Vector6<f64> {
    let (t, r) = (translation * translation, rotation * rotation);
    Vector6::new(t, t, t, r, r, r)
}

/// The poses that steps lead to, the first at the origin.
fn poses(steps: &[Se3]) -> Vec<Se3> {
    let mut poses = vec![Se3::identity()];
    for (k, step) in steps.iter().enumerate() {
        poses.push(poses[k] * *step);
    }
    poses
}

fn residual(constraint: &Constraint, poses: &[Se3]) -> Vector6<f64> {
    let predicted = poses[constraint.from].inverse() * poses[constraint.to];
    (constraint.from_from_to.inverse() * predicted).log()
}

/// A way, and sums along it. A right increment of step k is carried through the steps after it to the end of a loop: its derivative there
/// is Ad(X_to⁻¹ X_(k+1)), with the poses X, of which the second factor is the same for all loops.
struct Chain {
    poses: Vec<Se3>,
    /// Of the steps before each pose, the sum of Ad(X) Σ Ad(X)ᵀ.
    covariances: Vec<Matrix6<f64>>,
    /// The same of Ad(X) y.
    errors: Vec<Vector6<f64>>,
}

impl Chain {
    fn new(steps: &[Se3], errors: &[Vector6<f64>], of_steps: &[Matrix6<f64>]) -> Self {
        let poses = poses(steps);
        let (mut covariances, mut sums) = (vec![Matrix6::zeros()], vec![Vector6::zeros()]);
        for (k, (error, covariance)) in errors.iter().zip(of_steps).enumerate() {
            let adjoint = poses[k + 1].adjoint();
            covariances.push(covariances[k] + adjoint * covariance * adjoint.transpose());
            sums.push(sums[k] + adjoint * error);
        }
        Self { poses, covariances, errors: sums }
    }

    /// The steps' errors `−Σ Aᵀ` duals.
    fn errors(&self, rows: &[Row], duals: &[Vector6<f64>], of_steps: &[Matrix6<f64>]) -> Vec<Vector6<f64>> {
        let mut changes = vec![Vector6::zeros(); self.poses.len()];
        for (row, dual) in rows.iter().zip(duals) {
            let pulled = row.to_end.transpose() * dual;
            changes[row.from] += pulled;
            changes[row.to] -= pulled;
        }
        let mut pulled = Vector6::zeros();
        let error = |((pose, change), covariance): ((&Se3, &Vector6<f64>), &Matrix6<f64>)| {
            pulled += change;
            -covariance * (pose.adjoint().transpose() * pulled)
        };
        self.poses[1..].iter().zip(&changes).zip(of_steps).map(error).collect()
    }
}

/// A loop's residual without the errors that the steps have now, and where it begins and ends.
struct Row {
    from: usize,
    to: usize,
    residual: Vector6<f64>,
    /// Ad(X_to⁻¹).
    to_end: Matrix6<f64>,
}

impl Row {
    fn new(constraint: &Constraint, chain: &Chain) -> Self {
        let (from, to) = (constraint.from, constraint.to);
        let to_end = chain.poses[to].inverse().adjoint();
        let now = to_end * (chain.errors[to] - chain.errors[from]);
        Self { from, to, residual: residual(constraint, &chain.poses) - now, to_end }
    }

    /// `A Σ Bᵀ` over the steps that both loops go through.
    fn shared(&self, other: &Self, chain: &Chain) -> Matrix6<f64> {
        let (start, end) = (self.from.max(other.from), self.to.min(other.to));
        if start >= end {
            return Matrix6::zeros();
        }
        self.to_end * (chain.covariances[end] - chain.covariances[start]) * other.to_end.transpose()
    }
}

/// `(A Σ Aᵀ + R)⁻¹ r`, loop by loop; none when there is no loop or rounding makes the system indefinite.
fn solve(
    rows: &[Row],
    constraints: &[Constraint],
    weights: &[f64],
    chain: &Chain,
) -> Option<Vec<Vector6<f64>>> {
    let n = rows.len();
    let (mut system, mut right) = (DMatrix::zeros(6 * n, 6 * n), DVector::zeros(6 * n));
    for i in 0..n {
        for j in 0..=i {
            let mut block = rows[i].shared(&rows[j], chain);
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

    /// As the sums have it, step by step.
    #[test]
    fn sums_along_the_chain_are_those_of_its_steps() {
        let (_, steps) = ring();
        // Steps of which some are guessed along a direction.
        let covariances: Vec<Matrix6<f64>> = (0..steps.len())
            .map(|k| {
                let along = Vector6::new(0.6, 0.0, 0.8, 0.0, 0.0, 0.0) * if k % 4 == 0 { 0.3 } else { 0.0 };
                isotropic((0.01, 0.002)) + along * along.transpose()
            })
            .collect();
        let errors: Vec<Vector6<f64>> =
            (0..steps.len()).map(|k| Vector6::from_fn(|i, _| 1e-3 * ((k * 7 + i * 3) % 11) as f64)).collect();
        let chain = Chain::new(&steps, &errors, &covariances);
        let deviation = (0.01, 0.002);
        let loops = [(5, 60), (20, 90), (70, 95)].map(|(from, to)| Constraint {
            from,
            to,
            from_from_to: Se3::identity(),
            deviation,
        });
        let rows = loops.each_ref().map(|c| Row::new(c, &chain));
        let jacobian = |c: &Constraint, k: usize| {
            steps[k + 1..c.to].iter().fold(Se3::identity(), |p, step| p * *step).inverse().adjoint()
        };
        let within = |c: &Constraint| c.from..c.to;
        for (i, a) in loops.iter().enumerate() {
            let now: Vector6<f64> = within(a).map(|k| jacobian(a, k) * errors[k]).sum();
            let expected = residual(a, &chain.poses) - now;
            assert!((rows[i].residual - expected).norm() < 1e-9);
            for (j, b) in loops.iter().enumerate() {
                let both = within(a).filter(|k| within(b).contains(k));
                let sum: Matrix6<f64> =
                    both.map(|k| jacobian(a, k) * covariances[k] * jacobian(b, k).transpose()).sum();
                assert!((rows[i].shared(&rows[j], &chain) - sum).norm() < 1e-9 * sum.norm().max(1.0));
            }
        }
        let duals = [1.0, -2.0, 0.5].map(|scale| Vector6::from_fn(|i, _| scale * (i as f64 - 2.0)));
        let found = chain.errors(&rows, &duals, &covariances);
        for (k, error) in found.iter().enumerate() {
            let pulls = loops.iter().zip(&duals).filter(|(c, _)| within(c).contains(&k));
            let pull: Vector6<f64> = pulls.map(|(c, dual)| jacobian(c, k).transpose() * dual).sum();
            let expected: Vector6<f64> = -covariances[k] * pull;
            assert!((error - expected).norm() < 1e-12 + 1e-9 * expected.norm(), "step {k}");
        }
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
        let covariances = vec![isotropic((0.005, 0.001)); measured.len()];
        let (smoothed, weights) = smooth(&measured, &covariances, &loops);
        assert!(ends(&smoothed) < 0.005, "{}", ends(&smoothed));
        assert!(weights[..5].iter().all(|w| *w > 0.8) && weights[5] < 0.01, "{weights:?}");
        assert_eq!(smooth(&measured, &covariances, &[]).0, measured);
    }

    /// Of 30 m in the middle 10 are guessed, which fell 2 m short: what a loop says of the end belongs there.
    #[test]
    fn a_loop_stretches_what_was_guessed() {
        let step = |length: f64| Se3::exp(&Vector6::new(length, 0.0, 0.0, 0.0, 0.0, 0.0));
        let is_guessed = |k: usize| (10..20).contains(&k);
        let truth = vec![step(1.0); 30];
        let measured: Vec<Se3> = (0..30).map(|k| step(if is_guessed(k) { 0.8 } else { 1.0 })).collect();
        let mut guess = Matrix6::zeros();
        guess[(0, 0)] = 0.5f64.powi(2);
        let known = isotropic((0.005, 0.0005));
        let covariances: Vec<Matrix6<f64>> =
            (0..30).map(|k| if is_guessed(k) { known + guess } else { known }).collect();
        let from_from_to = truth.iter().fold(Se3::identity(), |p, s| p * *s);
        let found = Constraint { from: 0, to: 30, from_from_to, deviation: (0.01, 0.001) };
        let (smoothed, weights) = smooth(&measured, &covariances, &[found]);
        assert!(weights[0] > 0.9, "{weights:?}");
        for (k, (step, truth)) in smoothed.iter().zip(&truth).enumerate() {
            assert!((step.translation - truth.translation).norm() < 0.02, "{k}: {:?}", step.translation);
        }
    }
}
