//! Robust nonlinear least squares of few unknowns, with covariance.

use nalgebra::{Const, DimMin, SMatrix, SVector};

/// Takes residuals, of one or two rows, with their derivatives by the unknowns.
pub(super) trait Sink<const N: usize> {
    /// Takes one residual.
    fn add<const D: usize>(&mut self, residual: SVector<f64, D>, jacobian: SMatrix<f64, D, N>);
}

/// What is minimised: Huber's cost of residuals.
pub(super) trait Problem<const N: usize> {
    /// What is searched for.
    type State: Clone;
    /// Gives all residuals at `state`, in fixed order.
    fn residuals(&self, state: &Self::State, sink: &mut impl Sink<N>);
    /// The state after a step.
    fn step(&self, state: &Self::State, by: &SVector<f64, N>) -> Self::State;
}

/// The normal equations of one state.
struct Normal<const N: usize> {
    bound: f64,
    hessian: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: f64,
}

impl<const N: usize> Sink<N> for Normal<N> {
    fn add<const D: usize>(&mut self, residual: SVector<f64, D>, jacobian: SMatrix<f64, D, N>) {
        let size = residual.norm();
        let weight = if size <= self.bound { 1.0 } else { self.bound / size };
        self.cost += if size <= self.bound { size * size } else { self.bound * (2.0 * size - self.bound) };
        for (residual, row) in residual.iter().zip(jacobian.row_iter()) {
            let weighted = row * weight;
            self.gradient += weighted.transpose() * *residual;
            for (column, &value) in row.iter().enumerate() {
                for (entry, &other) in self.hessian.column_mut(column).iter_mut().zip(weighted.iter()) {
                    *entry += value * other;
                }
            }
        }
    }
}

/// Minimises by Levenberg–Marquardt from `state` on; `bound` is the residual from which Huber's cost is linear.
pub(super) fn minimise<const N: usize, P: Problem<N>>(
    problem: &P,
    mut state: P::State,
    bound: f64,
    iterations: usize,
) -> P::State {
    let normal = |state: &P::State| {
        let (hessian, gradient) = (SMatrix::zeros(), SVector::zeros());
        let mut normal = Normal { bound, hessian, gradient, cost: 0.0 };
        problem.residuals(state, &mut normal);
        normal
    };
    let mut at = normal(&state);
    let mut damping = 1e-6;
    for _ in 0..iterations {
        let mut damped = at.hessian;
        for i in 0..N {
            damped[(i, i)] += damping * at.hessian[(i, i)] + f64::MIN_POSITIVE;
        }
        let Some(factor) = damped.cholesky() else {
            break;
        };
        let by = -factor.solve(&at.gradient);
        let next_state = problem.step(&state, &by);
        let next = normal(&next_state);
        if next.cost <= at.cost {
            let settled = at.cost - next.cost <= 1e-10 * at.cost;
            (state, at) = (next_state, next);
            damping *= 0.1;
            if settled {
                break;
            }
        } else {
            damping = (damping * 100.0).max(1e-4);
            if damping > 1e6 {
                break;
            }
        }
    }
    state
}

/// The two sums of Huber's sandwich estimator.
struct Sandwich<const N: usize> {
    bound: f64,
    count: usize,
    bread: SMatrix<f64, N, N>,
    filling: SMatrix<f64, N, N>,
}

impl<const N: usize> Sink<N> for Sandwich<N> {
    fn add<const D: usize>(&mut self, residual: SVector<f64, D>, jacobian: SMatrix<f64, D, N>) {
        let size = residual.norm();
        let (slope, influence) = if size <= self.bound {
            (SMatrix::<f64, D, D>::identity(), residual)
        } else {
            // Beyond the bound the influence only turns with the residual.
            let along = residual / size;
            let across = SMatrix::<f64, D, D>::identity() - along * along.transpose();
            (across * (self.bound / size), along * self.bound)
        };
        self.count += D;
        self.bread += jacobian.transpose() * slope * jacobian;
        let pull = jacobian.transpose() * influence;
        self.filling += pull * pull.transpose();
    }
}

/// The covariance of a minimum, from the residuals themselves (Huber 1967): it holds for Huber's cost and for noise
/// that differs from match to match. Nothing where the residuals leave an unknown open.
pub(super) fn covariance<const N: usize, P: Problem<N>>(
    problem: &P,
    state: &P::State,
    bound: f64,
) -> Option<SMatrix<f64, N, N>>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let mut sums = Sandwich { bound, count: 0, bread: SMatrix::zeros(), filling: SMatrix::zeros() };
    problem.residuals(state, &mut sums);
    if sums.count <= N {
        return None;
    }
    let inverse = sums.bread.cholesky()?.inverse();
    let freedom = sums.count as f64 / (sums.count - N) as f64;
    let covariance = inverse * sums.filling * inverse * freedom;
    let usable = covariance.iter().all(|v| v.is_finite()) && covariance.cholesky().is_some();
    usable.then_some(covariance)
}
