//! Levenberg–Marquardt over poses, depths and lens; depths are eliminated by the Schur complement.

use super::problem::{FreePoint, Lenses, Predicted, Problem, ray};
use crate::window::{robust_cost, robust_weight};
use geometry::Se3;
use nalgebra::{DMatrix, DVector, Vector2, Vector6};

const MAX_STEPS: usize = 30;
/// The cost falls by a smaller share: done.
const CONVERGED: f64 = 1e-6;
/// Cost of an observation that cannot be predicted: that of an outlier of a hundred deviations.
const UNSEEN: f64 = 1e4;

/// What came out beside the values in the problem.
pub(super) struct Solution {
    /// Standard deviations of the lens' terms, as if all observations were independent.
    pub deviations: Vec<f64>,
    /// Root mean square of the normalised residuals, robustly weighted.
    pub residual: f64,
}

/// The normal equations, depths eliminated.
struct Normal {
    /// Poses but the first, then the terms of the lens.
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    /// Of each point: information and gradient of its inverse depth, and how it depends on the rest.
    points: Vec<Eliminated>,
    cost: f64,
    weighted: f64,
}

struct Eliminated {
    information: f64,
    gradient: f64,
    /// Indices into the unknowns with their values.
    coupling: Vec<(usize, f64)>,
}

/// Solves the problem in place; nothing where the equations are singular.
pub(super) fn solve(problem: &mut Problem) -> Option<()> {
    let mut damping = 1e-3;
    let mut normal = linearise(problem, damping)?;
    for _ in 0..MAX_STEPS {
        let before = (problem.poses.clone(), depths(problem), problem.terms.clone());
        let (cost, improved) = match step(&normal) {
            Some(delta) => {
                apply(problem, &normal, &delta);
                let cost = cost(problem).unwrap_or(f64::INFINITY);
                (cost, cost < normal.cost)
            }
            None => (f64::INFINITY, false),
        };
        if improved {
            let share = (normal.cost - cost) / normal.cost;
            damping = (damping * 0.2_f64).max(1e-9);
            if share < CONVERGED {
                break;
            }
            // Large: one at a time.
            drop(normal);
            normal = linearise(problem, damping)?;
        } else {
            (problem.poses, problem.terms) = (before.0, before.2);
            problem.points.iter_mut().zip(before.1).for_each(|(point, depth)| point.inverse_depth = depth);
            damping *= 10.0;
            if damping > 1e6 {
                break;
            }
            drop(normal);
            normal = linearise(problem, damping)?;
        }
    }
    Some(())
}

/// What a problem that is solved says of its solution; nothing where the equations are singular.
pub(super) fn solution(problem: &Problem) -> Option<Solution> {
    let normal = linearise(problem, 0.0)?;
    let size = normal.hessian.nrows();
    let inverse = normal.hessian.clone().cholesky()?.inverse();
    let first = size - problem.terms.len();
    let freedom = (2 * problem.observations.len()).saturating_sub(size + problem.points.len()).max(1);
    // Robust weights are two at the minimum; see `robust_weight`.
    let residual = (0.5 * normal.weighted / freedom as f64).sqrt();
    let deviations = (first..size).map(|i| residual * inverse[(i, i)].max(0.0).sqrt()).collect();
    Some(Solution { deviations, residual })
}

fn depths(problem: &Problem) -> Vec<f64> {
    problem.points.iter().map(|point| point.inverse_depth).collect()
}

/// The unknowns' place: the first pose is fixed.
fn of_pose(pose: usize) -> Option<usize> {
    pose.checked_sub(1).map(|i| 6 * i)
}

/// The normal equations of the problem as it stands; nothing where its lens is none.
fn linearise(problem: &Problem, damping: f64) -> Option<Normal> {
    let lenses = problem.lenses()?;
    let first_term = 6 * (problem.poses.len() - 1);
    let size = first_term + problem.terms.len();
    let mut normal = Normal {
        hessian: DMatrix::zeros(size, size),
        gradient: DVector::zeros(size),
        points: Vec::with_capacity(problem.points.len()),
        cost: 0.0,
        weighted: 0.0,
    };
    for point in &problem.points {
        normal.add_point(problem, &lenses, point);
    }
    damp(&mut normal.hessian, damping);
    normal.eliminate_depths(damping);
    normal.cost += add_priors(problem, &mut normal.hessian, &mut normal.gradient, first_term);
    normal.hessian.fill_upper_triangle_with_lower_triangle();
    Some(normal)
}

impl Normal {
    /// Adds a point's observations, and the point.
    fn add_point(&mut self, problem: &Problem, lenses: &Lenses, point: &FreePoint) {
        let first_term = 6 * (problem.poses.len() - 1);
        let world_from_host = problem.poses[point.host].inverse();
        let mut eliminated = Eliminated { information: 0.0, gradient: 0.0, coupling: Vec::new() };
        let Some(rays) = lenses.rays(&point.pixel) else {
            self.cost += robust_cost(UNSEEN) * point.observations.len() as f64;
            self.points.push(eliminated);
            return;
        };
        let mut columns = Vec::new();
        for observation in &problem.observations[point.observations.clone()] {
            let frame_from_host = problem.poses[observation.frame] * world_from_host;
            let predicted = lenses.predict(&frame_from_host, &rays, point.inverse_depth, &observation.pixel);
            let Some(predicted) = predicted else {
                self.cost += robust_cost(UNSEEN);
                continue;
            };
            columns.clear();
            add_columns(
                &mut columns,
                &predicted,
                &frame_from_host,
                observation.frame,
                point.host,
                first_term,
            );
            self.add(&predicted, &observation.information, &columns, &mut eliminated);
        }
        eliminated.coupling.sort_by_key(|(i, _)| *i);
        eliminated.coupling.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            kept.1 += if same { next.1 } else { 0.0 };
            same
        });
        // Half of it was the host's, once for each observation, and it is kept for all points.
        eliminated.coupling.shrink_to_fit();
        self.points.push(eliminated);
    }

    /// Adds an observation, robustly weighted, that depends on the unknowns by these columns and on its point's depth.
    fn add(
        &mut self,
        predicted: &Predicted,
        information: &[f64; 3],
        columns: &[(usize, Vector2<f64>)],
        eliminated: &mut Eliminated,
    ) {
        let squared = squared(&predicted.residual, information);
        let weight = robust_weight(squared);
        self.cost += robust_cost(squared);
        self.weighted += weight * squared;
        let [xx, xy, yy] = information.map(|value| weight * value);
        let inform = |v: &Vector2<f64>| Vector2::new(xx * v.x + xy * v.y, xy * v.x + yy * v.y);
        let by_depth = inform(&predicted.by_inverse_depth);
        eliminated.information += by_depth.dot(&predicted.by_inverse_depth);
        eliminated.gradient += by_depth.dot(&predicted.residual);
        for (i, column) in columns {
            let informed = inform(column);
            self.gradient[*i] += informed.dot(&predicted.residual);
            eliminated.coupling.push((*i, informed.dot(&predicted.by_inverse_depth)));
            for (j, other) in columns.iter().filter(|(j, _)| j <= i) {
                self.hessian[(*i, *j)] += informed.dot(other);
            }
        }
    }

    /// Eliminates the points' damped depths.
    fn eliminate_depths(&mut self, damping: f64) {
        for point in &mut self.points {
            point.information *= 1.0 + damping;
            if point.information <= 0.0 {
                continue;
            }
            for (at, (j, b)) in point.coupling.iter().enumerate() {
                let by_depth = b / point.information;
                self.gradient[*j] -= by_depth * point.gradient;
                // Column by column, as the matrix lies in memory.
                let mut column = self.hessian.column_mut(*j);
                for (i, a) in &point.coupling[at..] {
                    column[*i] -= a * by_depth;
                }
            }
        }
    }
}

fn damp(hessian: &mut DMatrix<f64>, damping: f64) {
    for i in 0..hessian.nrows() {
        hessian[(i, i)] *= 1.0 + damping;
    }
}

/// Adds the unknowns that an observation depends on but its depth, with the derivatives of the pixel by them.
fn add_columns(
    columns: &mut Vec<(usize, Vector2<f64>)>,
    predicted: &Predicted,
    frame_from_host: &Se3,
    frame: usize,
    host: usize,
    first_term: usize,
) {
    if let Some(at) = of_pose(frame) {
        columns.extend(predicted.by_twist.iter().enumerate().map(|(k, column)| (at + k, *column)));
    }
    if let Some(at) = of_pose(host) {
        // exp(ε) of the host on its left is exp(−Ad ε) of the relative pose.
        let adjoint = frame_from_host.adjoint();
        let column =
            |k: usize| -(0..6).map(|l| predicted.by_twist[l] * adjoint[(l, k)]).sum::<Vector2<f64>>();
        columns.extend((0..6).map(|k| (at + k, column(k))));
    }
    columns.extend(predicted.by_terms.iter().enumerate().map(|(k, column)| (first_term + k, *column)));
}

/// What is known before of the lens; and the unit of the world, which no observation tells, held by the distance of the
/// farthest keyframe. Gives the cost.
fn add_priors(
    problem: &Problem,
    hessian: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
    first_term: usize,
) -> f64 {
    let mut cost = 0.0;
    for (k, deviation) in problem.prior_deviations().into_iter().take(problem.terms.len()).enumerate() {
        let information = 1.0 / (deviation * deviation);
        hessian[(first_term + k, first_term + k)] += information;
        gradient[first_term + k] += information * problem.terms[k];
        cost += information * problem.terms[k] * problem.terms[k];
    }
    let distance = |pose: &Se3| pose.translation.norm();
    let farthest = (1..problem.poses.len())
        .max_by(|a, b| distance(&problem.poses[*a]).total_cmp(&distance(&problem.poses[*b])));
    if let Some((at, translation)) =
        farthest.and_then(|pose| Some((of_pose(pose)?, problem.poses[pose].translation)))
        && translation.norm() > 0.0
    {
        let direction = translation.normalize();
        let information = 1e8 / translation.norm_squared();
        for i in 0..3 {
            for j in 0..=i {
                hessian[(at + i, at + j)] += information * direction[i] * direction[j];
            }
        }
    }
    cost
}

fn step(normal: &Normal) -> Option<DVector<f64>> {
    Some(normal.hessian.clone().cholesky()?.solve(&-&normal.gradient))
}

fn apply(problem: &mut Problem, normal: &Normal, delta: &DVector<f64>) {
    for (pose, value) in problem.poses.iter_mut().enumerate() {
        if let Some(at) = of_pose(pose) {
            let twist = Vector6::from_iterator(delta.rows(at, 6).iter().copied());
            *value = (Se3::exp(&twist) * *value).renormalized();
        }
    }
    let count = problem.terms.len();
    problem.terms += delta.rows(delta.len() - count, count);
    for (point, eliminated) in problem.points.iter_mut().zip(&normal.points) {
        if eliminated.information > 0.0 {
            let rest: f64 = eliminated.coupling.iter().map(|(i, value)| value * delta[*i]).sum();
            point.inverse_depth -= (eliminated.gradient + rest) / eliminated.information;
        }
    }
}

/// Robust cost of all observations and of what is known before.
fn cost(problem: &Problem) -> Option<f64> {
    let lenses = Lenses { middle: problem.lens(&problem.terms)?, perturbed: Vec::new() };
    let unseen = robust_cost(UNSEEN);
    let mut cost = 0.0;
    for point in &problem.points {
        let ray = ray(&lenses.middle, &point.pixel);
        let world_from_host = problem.poses[point.host].inverse();
        for observation in &problem.observations[point.observations.clone()] {
            let frame_from_host = problem.poses[observation.frame] * world_from_host;
            let residual = ray.and_then(|ray| {
                lenses.residual(&frame_from_host, &ray, point.inverse_depth, &observation.pixel)
            });
            cost +=
                residual.map_or(unseen, |residual| robust_cost(squared(&residual, &observation.information)));
        }
    }
    let terms = problem.terms.iter().zip(problem.prior_deviations());
    cost += terms.map(|(term, deviation)| (term / deviation).powi(2)).sum::<f64>();
    Some(cost)
}

fn squared(residual: &Vector2<f64>, information: &[f64; 3]) -> f64 {
    crate::window::mahalanobis(&[residual.x, residual.y], information)
}
