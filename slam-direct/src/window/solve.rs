//! Levenberg–Marquardt over the window.

use super::linear::{Normal, Step};
use super::pairs::Pairs;
use super::problem::{Problem, WindowPoint};
use backend::SystemError;
use geometry::Se3;
use geometry::sensor::UNKNOWNS;

/// Inverse depths stay above this share of their value per step, so that no point jumps through infinity.
const MIN_DEPTH_FACTOR: f64 = 0.2;

/// When to end.
pub(crate) struct Limits<'a> {
    /// Steps at most.
    pub iterations: usize,
    /// Asked before each attempted step: whether to leave it at what is reached.
    pub stop: &'a dyn Fn() -> bool,
}

impl Limits<'_> {
    /// So many steps, come what may.
    pub fn steps(iterations: usize) -> Self {
        Self { iterations, stop: &|| false }
    }
}

/// Minimises the robust cost of a small problem in so many steps at most. Returns the cost that is left.
pub(crate) fn solve(problem: &mut Problem, iterations: usize) -> f64 {
    let (pairs, stop) = (Pairs::new(problem), || false);
    let solved = minimise(problem, &pairs, &Limits { iterations, stop: &stop });
    solved.map_or(f64::INFINITY, |(cost, _)| cost)
}

/// Says of a small problem that is solved how well its sensor is known, where that is an unknown.
pub(crate) fn weigh_sensor(problem: &mut Problem) {
    if problem.calibration.is_none() {
        return;
    }
    let pairs = Pairs::new(problem);
    let Ok(mut normal) = Normal::new(problem, &pairs) else { return };
    normal.linearise(problem, &pairs, &pairs.relative(&problem.frames));
    set_variances(problem, &pairs, &mut normal);
}

/// Minimises the robust cost over the free poses and all inverse depths; stops at its `limits` or when the cost
/// falls by less than one part in ten million. Returns the cost that is left.
///
/// # Errors
/// When there is not enough memory; the problem is as it was.
pub(crate) fn solve_within(
    problem: &mut Problem,
    pairs: &Pairs,
    limits: &Limits,
) -> Result<f64, SystemError> {
    let (cost, mut normal) = minimise(problem, pairs, limits)?;
    set_variances(problem, pairs, &mut normal);
    Ok(cost)
}

/// Gives the cost that is left and the normal equations there.
fn minimise(problem: &mut Problem, pairs: &Pairs, limits: &Limits) -> Result<(f64, Normal), SystemError> {
    let mut relative = pairs.relative(&problem.frames);
    let mut cost = problem.cost(pairs, &relative);
    let mut normal = Normal::new(problem, pairs)?;
    normal.linearise(problem, pairs, &relative);
    let (mut lambda, mut done, mut refused) = (1e-5, 0, 0);
    while done < limits.iterations && refused < 6 && !(limits.stop)() {
        let step = normal.step(problem, pairs, lambda);
        let before = step.map(|step| advance(problem, &step));
        let moved = pairs.relative(&problem.frames);
        let new_cost = before.as_ref().map_or(f64::INFINITY, |_| problem.cost(pairs, &moved));
        if new_cost < cost {
            let small = cost - new_cost < 1e-7 * cost;
            (cost, relative) = (new_cost, moved);
            lambda = (lambda * 0.2f64).max(1e-9);
            done += 1;
            refused = 0;
            normal.linearise(problem, pairs, &relative);
            if small {
                break;
            }
        } else {
            if let Some(before) = before {
                before.restore(problem);
            }
            lambda = (lambda * 10.0).max(1e-6);
            refused += 1;
        }
    }
    for (point, information) in problem.points.iter_mut().zip(normal.depth_information()) {
        point.information = information;
    }
    Ok((cost, normal))
}

/// Sets how well the sensor is known, by the normal equations at the minimum.
fn set_variances(problem: &mut Problem, pairs: &Pairs, normal: &mut Normal) {
    let known = normal.sensor_variances(problem, pairs);
    if let Some((calibration, known)) = problem.calibration.as_mut().zip(known) {
        calibration.variance =
            std::array::from_fn(|k| if calibration.sigma[k] > 0.0 { known[k] } else { 0.0 });
    }
}

/// Values of a problem before a step.
struct Before {
    frames: Vec<Se3>,
    inverse_depths: Vec<f64>,
    sensor: Option<[f64; UNKNOWNS]>,
}

impl Before {
    fn restore(self, problem: &mut Problem) {
        problem.frames = self.frames;
        if let Some(unknowns) = self.sensor {
            problem.set_sensor(unknowns);
        }
        for (point, inverse_depth) in problem.points.iter_mut().zip(self.inverse_depths) {
            point.inverse_depth = inverse_depth;
        }
    }
}

/// Takes a step; gives what was before it.
fn advance(problem: &mut Problem, Step { pose, depth, sensor: by }: &Step) -> Before {
    let frames = problem.frames.clone();
    let sensor = problem.calibration.as_ref().map(|calibration| calibration.sensor.unknowns());
    if let Some(unknowns) = sensor {
        problem.set_sensor(std::array::from_fn(|k| unknowns[k] + by[k]));
    }
    for ((frame, delta), fixed) in problem.frames.iter_mut().zip(pose).zip(&problem.fixed) {
        if !fixed {
            *frame = (Se3::exp(delta) * *frame).renormalized();
        }
    }
    let step = |(point, delta): (&mut WindowPoint, &f64)| {
        let moved = (point.inverse_depth + delta).max(MIN_DEPTH_FACTOR * point.inverse_depth);
        std::mem::replace(&mut point.inverse_depth, moved)
    };
    let inverse_depths = problem.points.iter_mut().zip(depth).map(step).collect();
    Before { frames, inverse_depths, sensor }
}
