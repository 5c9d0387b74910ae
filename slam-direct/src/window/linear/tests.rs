//! The normal equations against derivatives by differences.

use super::*;
use crate::window::tests::{bent, cost, perturbed, scene, spread};
use geometry::Se3;
use nalgebra::{DMatrix, DVector};

/// Small, with poses and depths off the optimum and a few observations far off.
fn small() -> Problem {
    let mut problem = perturbed(&scene(4, 12, &[0]), 0.03, 0.02, 0.1);
    for (i, seen) in problem.observations.iter_mut().enumerate() {
        let size = if i % 7 == 0 { 20.0 } else { 1.5 };
        seen.pixel = [seen.pixel[0] + size * spread(i, 0), seen.pixel[1] + size * spread(i, 1)];
    }
    problem
}

/// The problem with parameter `index` (six for each free frame, then one for each point) moved by `by`.
fn moved(problem: &Problem, index: usize, by: f64) -> Problem {
    let mut moved = problem.clone();
    let free: Vec<usize> = (0..problem.frames.len()).filter(|&f| !problem.fixed[f]).collect();
    match free.get(index / 6) {
        Some(&frame) => {
            let mut twist = Vector6::zeros();
            twist[index % 6] = by;
            moved.frames[frame] = Se3::exp(&twist) * moved.frames[frame];
        }
        None => moved.points[index - 6 * free.len()].inverse_depth += by,
    }
    moved
}

fn parameters(problem: &Problem) -> usize {
    6 * problem.fixed.iter().filter(|fixed| !**fixed).count() + problem.points.len()
}

/// Residuals of all observations, two each.
fn residuals(problem: &Problem) -> DVector<f64> {
    let mut all = DVector::zeros(2 * problem.observations.len());
    for point in &problem.points {
        for i in point.observations.clone() {
            let seen = &problem.observations[i];
            let relative = problem.frames[seen.frame] * problem.frames[point.host].inverse();
            let x = relative.rotation * point.ray + relative.translation * point.inverse_depth;
            let at = problem.camera.project(&x);
            (all[2 * i], all[2 * i + 1]) = (at.x - seen.pixel[0], at.y - seen.pixel[1]);
        }
    }
    all
}

fn linearised(problem: &Problem) -> Normal {
    let pairs = Pairs::new(problem);
    let mut normal = Normal::new(problem, &pairs).unwrap();
    normal.linearise(problem, &pairs, &pairs.relative(&problem.frames));
    normal
}

/// The gradient as the reduced system sees it: poses, then depths.
fn gradient(normal: &Normal) -> DVector<f64> {
    let depth = normal.depth.iter().map(|d| d.1);
    DVector::from_iterator(
        normal.system.gradient().len() + normal.depth.len(),
        normal.system.gradient().iter().copied().chain(depth),
    )
}

#[test]
fn the_gradient_is_the_slope_of_the_cost() {
    let problem = small();
    let gradient = gradient(&linearised(&problem));
    for (i, &analytic) in gradient.iter().enumerate() {
        let h = 1e-6;
        let slope = (cost(&moved(&problem, i, h)) - cost(&moved(&problem, i, -h))) / (2.0 * h);
        // The cost counts squares, the normal equations half of them.
        assert!((2.0 * analytic - slope).abs() < 1e-4 * slope.abs().max(10.0), "{i}: {analytic} {slope}");
    }
}

#[test]
fn eliminating_the_depths_gives_the_step_of_the_full_system() {
    let problem = small();
    let (n, h) = (parameters(&problem), 1e-6);
    let columns: Vec<DVector<f64>> = (0..n)
        .map(|i| (residuals(&moved(&problem, i, h)) - residuals(&moved(&problem, i, -h))) / (2.0 * h))
        .collect();
    let jacobian = DMatrix::from_columns(&columns);
    let residual = residuals(&problem);
    let mut weight = DMatrix::zeros(residual.len(), residual.len());
    for (i, seen) in problem.observations.iter().enumerate() {
        let r = [residual[2 * i], residual[2 * i + 1]];
        let [a, b, c] = seen.information.map(|v| v * robust_weight(mahalanobis(&r, &seen.information)));
        weight[(2 * i, 2 * i)] = a;
        weight[(2 * i, 2 * i + 1)] = b;
        weight[(2 * i + 1, 2 * i)] = b;
        weight[(2 * i + 1, 2 * i + 1)] = c;
    }
    let full = jacobian.transpose() * &weight * &jacobian;
    let right = jacobian.transpose() * &weight * &residual;
    for lambda in [1e-3, 0.3] {
        let mut damped = full.clone();
        for i in 0..n {
            damped[(i, i)] *= 1.0 + lambda;
        }
        let expected = -damped.lu().solve(&right).unwrap();
        let Step { pose: poses, depth: depths, .. } =
            linearised(&problem).step(&problem, &Pairs::new(&problem), lambda).unwrap();
        let free = poses.iter().zip(&problem.fixed).filter(|(_, fixed)| !**fixed);
        let values =
            free.flat_map(|(p, _)| p.iter().copied().collect::<Vec<_>>()).chain(depths.iter().copied());
        let step = DVector::from_iterator(n, values);
        assert!((&step - &expected).norm() < 1e-4 * expected.norm(), "{step} {expected}");
        assert_eq!(poses[0], Vector6::zeros());
    }
}

/// The residuals in pixels of the image.
fn distorted(problem: &Problem) -> DVector<f64> {
    let calibration = problem.calibration.as_ref().unwrap();
    let mut all = residuals(problem);
    let sensor = &calibration.sensor;
    for (i, (distorted, _)) in calibration.seen.iter().enumerate() {
        let still =
            nalgebra::Vector2::from(distorted.pixel) - distorted.velocity * sensor.delay(distorted.pixel);
        let back = sensor.lens.magnification(still.into()).try_inverse().unwrap();
        let residual = back * all.fixed_rows::<2>(2 * i);
        all.fixed_rows_mut::<2>(2 * i).copy_from(&residual);
    }
    all
}

/// Up to the square of the distortion.
#[test]
fn the_sensor_is_solved_for_with_all_else() {
    const NOW: [f64; UNKNOWNS] = [0.002, 0.003, -0.004];
    let (mut problem, h) = (bent(&small(), [0.01, 0.0, 0.01]), 1e-6);
    // Two frames that hold the scale as well.
    problem.fixed[1] = true;
    problem.set_sensor(NOW);
    let n = parameters(&problem);
    let with_sensor = |k: usize, by: f64| {
        let mut moved = problem.clone();
        moved.set_sensor(std::array::from_fn(|l| NOW[l] + if k == l { by } else { 0.0 }));
        distorted(&moved)
    };
    let mut columns: Vec<DVector<f64>> = (0..n)
        .map(|i| (distorted(&moved(&problem, i, h)) - distorted(&moved(&problem, i, -h))) / (2.0 * h))
        .collect();
    columns.extend((0..UNKNOWNS).map(|k| (with_sensor(k, h) - with_sensor(k, -h)) / (2.0 * h)));
    let jacobian = DMatrix::from_columns(&columns);
    let residual = distorted(&problem);
    let mut weight = DMatrix::zeros(residual.len(), residual.len());
    for (i, (_, information)) in problem.calibration.as_ref().unwrap().seen.iter().enumerate() {
        let r = [residual[2 * i], residual[2 * i + 1]];
        let [a, b, c] = information.map(|v| v * robust_weight(mahalanobis(&r, information)));
        weight.fixed_view_mut::<2, 2>(2 * i, 2 * i).copy_from(&nalgebra::Matrix2::new(a, b, b, c));
    }
    let mut full = jacobian.transpose() * &weight * &jacobian;
    let mut right = jacobian.transpose() * &weight * &residual;
    let prior = 1.0 / (0.02 * 0.02);
    for (k, value) in NOW.into_iter().enumerate() {
        full[(n + k, n + k)] += prior;
        right[n + k] += value * prior;
    }
    let expected = -full.lu().solve(&right).unwrap();
    let step = linearised(&problem).step(&problem, &Pairs::new(&problem), 0.0).unwrap();
    let off = |found: f64, expected: f64| (found - expected).abs() > 0.01 * expected.abs() + 1e-4;
    for (k, &by) in step.sensor.iter().enumerate() {
        assert!(!off(by, expected[n + k]), "{k}: {by} {}", expected[n + k]);
    }
    for (i, &depth) in step.depth.iter().enumerate() {
        let expected = expected[n - problem.points.len() + i];
        assert!(!off(depth, expected), "{i}: {depth} {expected}");
    }
}
