//! Levenberg–Marquardt over the window.

use super::linear::Normal;
use super::problem::Problem;
use geometry::Se3;

/// Inverse depths stay above this share of their value per step, so that no point jumps through infinity.
const MIN_DEPTH_FACTOR: f64 = 0.2;

/// Minimises the robust cost over the free poses and all inverse depths; stops after `iterations`
/// steps or when the cost falls by less than one part in ten million. Returns the cost that is left.
pub(crate) fn solve(problem: &mut Problem, iterations: usize) -> f64 {
    let mut cost = problem.cost();
    let mut lambda = 1e-5;
    let mut done = 0;
    let mut normal = Normal::new(problem);
    let mut refused = 0;
    while done < iterations && refused < 6 {
        let accepted = normal.step(problem, lambda).map(|step| {
            let candidate = moved(problem, &step);
            let cost = candidate.cost();
            (candidate, cost)
        });
        match accepted {
            Some((candidate, new_cost)) if new_cost < cost => {
                let small = cost - new_cost < 1e-7 * cost;
                *problem = candidate;
                cost = new_cost;
                lambda = (lambda * 0.2).max(1e-9);
                done += 1;
                refused = 0;
                normal = Normal::new(problem);
                if small {
                    break;
                }
            }
            _ => {
                lambda = (lambda * 10.0).max(1e-6);
                refused += 1;
            }
        }
    }
    for (point, information) in problem.points.iter_mut().zip(normal.depth_information()) {
        point.information = information;
    }
    cost
}

fn moved(problem: &Problem, (pose, depth): &(Vec<nalgebra::Vector6<f64>>, Vec<f64>)) -> Problem {
    let mut candidate = problem.clone();
    for ((frame, delta), fixed) in candidate.frames.iter_mut().zip(pose).zip(&problem.fixed) {
        if !fixed {
            *frame = (Se3::exp(delta) * *frame).renormalized();
        }
    }
    for (point, delta) in candidate.points.iter_mut().zip(depth) {
        let moved = point.inverse_depth + delta;
        point.inverse_depth = moved.max(MIN_DEPTH_FACTOR * point.inverse_depth);
    }
    candidate
}
