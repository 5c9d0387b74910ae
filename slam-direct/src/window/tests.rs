//! The joint optimisation on made-up scenes of which everything is known.

use super::*;
use geometry::sensor::{Sensor, UNKNOWNS};
use geometry::{Pinhole, Se3};
use nalgebra::{Vector2, Vector6};

/// Repeatable numbers in ±1 that fill the interval evenly; `series` tells sequences apart.
pub(super) fn spread(index: usize, series: usize) -> f64 {
    let step = [0.618_033_988_75, 0.754_877_666_25, 0.569_840_290_998, 0.819_172_513_4][series % 4];
    2.0 * ((index + 1) as f64 * step + 0.137 * series as f64).fract() - 1.0
}

fn twist(index: usize, translation: f64, rotation: f64) -> Vector6<f64> {
    let size = [translation, translation, translation, rotation, rotation, rotation];
    Vector6::from_fn(|k, _| size[k] * spread(7 * index + k, k))
}

pub(super) fn cost(problem: &Problem) -> f64 {
    let pairs = Pairs::new(problem);
    problem.cost(&pairs, &pairs.relative(&problem.frames))
}

/// Frames about a third of a unit apart, points 1.5 to 6 units away hosted by each in turn and seen exactly by
/// all others; the frames named in `fixed` may not move.
pub(super) fn scene(frames: usize, points: usize, fixed: &[usize]) -> Problem {
    let camera = Pinhole { width: 640, height: 480, fx: 420.0, fy: 410.0, cx: 319.5, cy: 239.5 };
    let mut problem = Problem {
        camera,
        frames: (0..frames).map(|i| Se3::exp(&twist(i, 0.3, 0.06))).collect(),
        fixed: (0..frames).map(|i| fixed.contains(&i)).collect(),
        points: Vec::new(),
        observations: Vec::new(),
        calibration: None,
    };
    for i in 0..points {
        let (u, v) = (320.0 + 300.0 * spread(i, 0), 240.0 + 220.0 * spread(i, 1));
        add_point(&mut problem, i % frames, [u, v], 1.0 / (3.75 + 2.25 * spread(i, 2)));
    }
    problem
}

/// A point at `pixel` of frame `host`, seen exactly by all others.
fn add_point(problem: &mut Problem, host: usize, pixel: [f64; 2], inverse_depth: f64) {
    let ray = problem.camera.unproject(pixel[0], pixel[1]);
    let first = problem.observations.len();
    for frame in (0..problem.frames.len()).filter(|&f| f != host) {
        let relative = problem.frames[frame] * problem.frames[host].inverse();
        let x = relative.rotation * ray + relative.translation * inverse_depth;
        let at = problem.camera.project(&x);
        // Elongated and tilted, as at an edge of the image.
        let information = [1.0, 0.4 * spread(first, 3), 0.6];
        problem.observations.push(WindowObservation { frame, pixel: [at.x, at.y], information });
    }
    let observations = first..problem.observations.len();
    problem.points.push(WindowPoint { host, ray, inverse_depth, observations, information: 0.0 });
}

/// The problem with its free poses and all its depths moved away.
pub(super) fn perturbed(truth: &Problem, translation: f64, rotation: f64, depth: f64) -> Problem {
    let mut problem = truth.clone();
    for i in 0..problem.frames.len() {
        if !problem.fixed[i] {
            problem.frames[i] = Se3::exp(&twist(i + 31, translation, rotation)) * problem.frames[i];
        }
    }
    for (i, point) in problem.points.iter_mut().enumerate() {
        point.inverse_depth *= 1.0 + depth * spread(i, 3);
    }
    problem
}

/// Largest error of a pose (units and radians) and largest relative error of an inverse depth, after the
/// problem's lengths are multiplied by `scale`.
fn errors(problem: &Problem, truth: &Problem, scale: f64) -> (f64, f64) {
    let pose = |(a, b): (&Se3, &Se3)| {
        let pure_rotation = a.rotation.angle_to(&b.rotation);
        pure_rotation.max((a.translation * scale - b.translation).norm())
    };
    let depth =
        |(a, b): (&WindowPoint, &WindowPoint)| (a.inverse_depth / scale / b.inverse_depth - 1.0).abs();
    (
        problem.frames.iter().zip(&truth.frames).map(pose).fold(0.0, f64::max),
        problem.points.iter().zip(&truth.points).map(depth).fold(0.0, f64::max),
    )
}

#[test]
fn exact_observations_bring_back_poses_and_depths() {
    let truth = scene(5, 80, &[0, 1]);
    let mut problem = perturbed(&truth, 0.06, 0.03, 0.25);
    let before = cost(&problem);
    let after = solve(&mut problem, 30);
    let (pose, depth) = errors(&problem, &truth, 1.0);
    assert!(pose < 1e-6 && depth < 1e-6, "poses off by {pose}, depths by {depth}");
    assert!(after < 1e-9 * before, "{after} from {before}");
    assert_eq!(problem.frames[..2], truth.frames[..2], "fixed frames do not move");
}

#[test]
fn one_fixed_frame_leaves_the_scale_free_and_nothing_else() {
    let mut truth = scene(4, 60, &[0]);
    let world_from_first = truth.frames[0].inverse();
    for frame in &mut truth.frames {
        *frame = *frame * world_from_first;
    }
    let mut problem = perturbed(&truth, 0.05, 0.03, 0.2);
    solve(&mut problem, 40);
    let scale = truth.frames[1].translation.norm() / problem.frames[1].translation.norm();
    assert!((0.5..2.0).contains(&scale), "{scale}");
    let (pose, depth) = errors(&problem, &truth, scale);
    assert!(pose < 1e-5 && depth < 1e-5, "poses off by {pose}, depths by {depth}");
}

#[test]
fn a_fifth_of_gross_outliers_hardly_moves_the_optimum() {
    let truth = scene(5, 150, &[0, 1]);
    let mut problem = perturbed(&truth, 0.03, 0.01, 0.1);
    for i in (0..problem.observations.len()).step_by(5) {
        let seen = &mut problem.observations[i].pixel;
        let (x, y) = (spread(i, 0), spread(i, 1));
        *seen = [seen[0] + 30.0 * x.signum() + 30.0 * x, seen[1] + 30.0 * y.signum() + 30.0 * y];
    }
    solve(&mut problem, 40);
    let (pose, _) = errors(&problem, &truth, 1.0);
    assert!(pose < 0.01, "poses off by {pose}");
    let off = |(a, b): (&WindowPoint, &WindowPoint)| (a.inverse_depth / b.inverse_depth - 1.0).abs();
    let mut depths: Vec<f64> = problem.points.iter().zip(&truth.points).map(off).collect();
    depths.sort_by(f64::total_cmp);
    assert!(depths[depths.len() / 2] < 0.01, "median depth error {}", depths[depths.len() / 2]);
}

/// Noise of `share` of the deviation that an observation's information says.
fn disturb(seen: &mut WindowObservation, share: f64, random: &mut geometry::Random) {
    let [a, b, c] = seen.information;
    // Λ = L Lᵀ, and L⁻ᵀ n has the covariance Λ⁻¹.
    let (l, m) = (a.sqrt(), b / a.sqrt());
    let n = (c - m * m).sqrt();
    let y = random.normal() / n;
    let x = (random.normal() - m * y) / l;
    seen.pixel = [seen.pixel[0] + share * x, seen.pixel[1] + share * y];
}

#[test]
fn depths_are_as_uncertain_as_estimated() {
    // So little noise that the kernel weighs all alike: twice.
    const SHARE: f64 = 0.02;
    let truth = scene(5, 60, &[0, 1]);
    let by_poses = variances_by_poses(&truth, &Pairs::new(&truth)).expect("it is held");
    let mut random = geometry::Random::new(3);
    let (mut sum, mut count) = (0.0, 0.0);
    for _ in 0..60 {
        let mut problem = truth.clone();
        problem.observations.iter_mut().for_each(|seen| disturb(seen, SHARE, &mut random));
        solve(&mut problem, 20);
        for ((found, exact), by_poses) in problem.points.iter().zip(&truth.points).zip(&by_poses) {
            let square = (found.inverse_depth - exact.inverse_depth).powi(2) / (2.0 * SHARE * SHARE);
            sum += square / (1.0 / found.information + by_poses);
            count += 1.0;
        }
    }
    let normalised = sum / count;
    assert!((0.8..1.25).contains(&normalised), "normalised squared error {normalised}");
}

#[test]
fn what_shares_little_with_the_rest_has_an_uncertain_scale() {
    // Two groups of frames; only so many points of the first are seen by the second, and none the other way round.
    let relative = |ties: usize| {
        let mut problem = scene(6, 120, &[0, 1, 2]);
        let mut left = ties;
        let mut observations = Vec::new();
        for point in &mut problem.points {
            let first = observations.len();
            let is_old = point.host < 3;
            let is_tie = is_old && left > 0;
            left -= usize::from(is_tie);
            let seen = problem.observations[point.observations.clone()].iter();
            observations.extend(seen.filter(|seen| (seen.frame < 3) == is_old || is_tie));
            point.observations = first..observations.len();
        }
        problem.observations = observations;
        let by_poses = variances_by_poses(&problem, &Pairs::new(&problem)).expect("it is held");
        let new = problem.points.iter().zip(by_poses).filter(|(point, _)| point.host >= 3);
        let mut all: Vec<f64> = new.map(|(point, v)| v.sqrt() / point.inverse_depth).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let (many, few) = (relative(40), relative(3));
    assert!(few > 3.0 * many, "{few} by three points, {many} by forty");
}

#[test]
fn points_at_infinity_fix_rotations() {
    let mut truth = scene(4, 24, &[0, 1]);
    let finite = truth.points.len();
    for i in 0..12 {
        add_point(&mut truth, i % 4, [320.0 + 250.0 * spread(i, 2), 240.0 + 180.0 * spread(i, 3)], 0.0);
    }
    let mut problem = perturbed(&truth, 0.03, 0.02, 0.1);
    for point in &mut problem.points[finite..] {
        point.inverse_depth = 0.02;
    }
    solve(&mut problem, 40);
    for point in &problem.points[finite..] {
        assert!((0.0..1e-5).contains(&point.inverse_depth), "{}", point.inverse_depth);
    }
    let (pose, _) = errors(&problem, &truth, 1.0);
    assert!(pose < 1e-4, "poses off by {pose}");
}

#[test]
fn nothing_to_solve_changes_nothing() {
    let mut empty = scene(0, 0, &[]);
    assert_eq!(solve(&mut empty, 10), 0.0);
    let mut frames_alone = scene(3, 0, &[0]);
    let before = frames_alone.frames.clone();
    assert_eq!(solve(&mut frames_alone, 10), 0.0);
    assert_eq!(frames_alone.frames, before);
}

#[test]
fn a_point_that_nobody_sees_stays_as_it_is() {
    let truth = scene(4, 40, &[0, 1]);
    let mut problem = perturbed(&truth, 0.04, 0.02, 0.1);
    let end = problem.observations.len();
    let lonely = WindowPoint { observations: end..end, inverse_depth: 0.321, ..problem.points[0].clone() };
    problem.points.push(lonely);
    solve(&mut problem, 30);
    let lonely = problem.points.pop().unwrap();
    assert_eq!((lonely.inverse_depth, lonely.information), (0.321, 0.0));
    let (pose, depth) = errors(&problem, &truth, 1.0);
    assert!(pose < 1e-6 && depth < 1e-6, "poses off by {pose}, depths by {depth}");
}

#[test]
fn with_all_frames_fixed_the_depths_are_found() {
    let truth = scene(4, 40, &[0, 1, 2, 3]);
    let mut problem = perturbed(&truth, 0.0, 0.0, 0.4);
    solve(&mut problem, 30);
    assert_eq!(problem.frames, truth.frames);
    let (_, depth) = errors(&problem, &truth, 1.0);
    assert!(depth < 1e-7, "depths off by {depth}");
    for point in &problem.points {
        let information = curvature(&truth, point);
        assert!((point.information / information - 1.0).abs() < 1e-4, "{} {information}", point.information);
    }
}

/// Half the second derivative of a point's cost by its inverse depth, by differences.
fn curvature(truth: &Problem, point: &WindowPoint) -> f64 {
    let (h, base) = (1e-5, point.inverse_depth);
    let cost = |inverse_depth: f64| {
        let alone = WindowPoint { inverse_depth, ..point.clone() };
        cost(&Problem { points: vec![alone], ..truth.clone() })
    };
    0.5 * (cost(base + h) - 2.0 * cost(base) + cost(base - h)) / (h * h)
}

#[test]
fn frames_that_see_nothing_before_them_do_no_harm() {
    let truth = scene(4, 40, &[0, 1]);
    let mut problem = perturbed(&truth, 0.02, 0.01, 0.1);
    problem.frames[3] = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 3.1, 0.0)) * problem.frames[3];
    let before = cost(&problem);
    let after = solve(&mut problem, 30);
    assert!(after < before);
    assert!(problem.frames.iter().all(Se3::is_finite));
    assert!(problem.points.iter().all(|p| p.inverse_depth.is_finite() && p.inverse_depth > 0.0));
    let infinite = problem.squared_residuals().iter().filter(|r| r.is_infinite()).count();
    assert!(infinite >= 25, "the turned frame has its points behind it: {infinite}");
}

#[test]
fn the_weight_is_the_slope_of_the_cost() {
    for squared in [0.0, 0.3, 1.0, 5.0, 40.0, 1e4] {
        let h = 1e-5 * (1.0 + squared);
        let slope = (robust_cost(squared + h) - robust_cost(squared)) / h;
        assert!((slope / robust_weight(squared) - 1.0).abs() < 1e-4, "{squared}");
    }
}

/// A chain of frames, each of whose points its next three see: twice the frames are twice the work.
#[test]
fn the_system_of_a_long_path_grows_with_its_length() {
    let work = |frames: usize| {
        let mut chain = scene(frames, 20 * frames, &[0]);
        for point in &mut chain.points {
            let near = |o: &WindowObservation| o.frame > point.host && o.frame <= point.host + 3;
            let seen: Vec<_> =
                chain.observations[point.observations.clone()].iter().copied().filter(near).collect();
            let first = chain.observations.len();
            chain.observations.extend(seen);
            point.observations = first..chain.observations.len();
        }
        let pairs = Pairs::new(&chain);
        linear::Normal::new(&chain, &pairs).unwrap().entries() + pairs.ends.len()
    };
    let (short, long) = (work(20), work(40));
    assert!(long as f64 <= 2.2 * short as f64, "{long} entries and pairs after {short}");
}

#[test]
fn a_request_to_stop_leaves_what_is_reached() {
    let mut problem = perturbed(&scene(5, 80, &[0, 1]), 0.06, 0.03, 0.25);
    let before = cost(&problem);
    let pairs = Pairs::new(&problem);
    let asked = std::cell::Cell::new(0);
    let stop = || asked.replace(asked.get() + 1) == 2;
    let left = solve_within(&mut problem, &pairs, &Limits { iterations: 30, stop: &stop }).unwrap();
    assert!(left < 0.5 * before && (left - cost(&problem)).abs() < 1e-9 * left);
    assert_eq!(asked.get(), 3, "no step after the wish");
}

/// The scene as a sensor of these values shows it, of which nothing is known, while its image moves by hundreds of pixels a
/// second.
pub(super) fn bent(truth: &Problem, unknowns: [f64; UNKNOWNS]) -> Problem {
    let sensor = Sensor::ideal(truth.camera).with(unknowns);
    let distorted = |ideal: [f64; 2], index: usize| {
        let velocity = Vector2::new(400.0 * spread(index, 2), 300.0 * spread(index, 3));
        let still = Vector2::from(sensor.lens.distort(ideal));
        let mut pixel = still;
        for _ in 0..5 {
            pixel = still + velocity * sensor.delay(pixel.into());
        }
        DistortedPixel { pixel: pixel.into(), velocity }
    };
    let host = |(i, p): (usize, &WindowPoint)| distorted(truth.camera.project(&p.ray).into(), 31 * i + 7);
    let hosts = truth.points.iter().enumerate().map(host).collect();
    let seen =
        truth.observations.iter().enumerate().map(|(i, o)| (distorted(o.pixel, i), o.information)).collect();
    let calibration = Calibration {
        sensor: Sensor::ideal(truth.camera),
        sigma: [0.02; UNKNOWNS],
        variance: [0.0; UNKNOWNS],
        hosts,
        seen,
    };
    let mut problem = Problem { calibration: Some(calibration), ..truth.clone() };
    problem.set_sensor([0.0; UNKNOWNS]);
    problem
}

/// What is found of the sensor.
fn found(problem: &Problem) -> [f64; UNKNOWNS] {
    problem.calibration.as_ref().unwrap().sensor.unknowns()
}

#[test]
fn a_bent_lens_is_straightened_and_a_rolling_shutter_found() {
    let truth = scene(6, 200, &[0, 1]);
    for unknowns in [[-0.02, 0.0, 0.0], [0.0; 3], [0.015, 0.0, 0.02], [0.0, 0.0, -0.03], [-0.01, 0.015, 0.0]]
    {
        let mut problem = perturbed(&bent(&truth, unknowns), 0.03, 0.01, 0.1);
        solve(&mut problem, 30);
        for (found, truth) in found(&problem).into_iter().zip(unknowns) {
            assert!((found - truth).abs() < 0.02 * truth.abs() + 1e-4, "{found} for {unknowns:?}");
        }
        let (pose, depth) = errors(&problem, &truth, 1.0);
        assert!(pose < 1e-3 && depth < 1e-2, "{unknowns:?}: poses off by {pose}, depths by {depth}");
    }
    for unknowns in [[-0.02, 0.0, 0.0], [0.0, 0.0, 0.02]] {
        let mut problem = bent(&truth, unknowns);
        problem.calibration.as_mut().unwrap().sigma =
            unknowns.map(|value| if value == 0.0 { 0.02 } else { 0.0 });
        solve(&mut problem, 30);
        for (found, truth) in found(&problem).into_iter().zip(unknowns) {
            assert!(truth == 0.0 || found == 0.0, "what is known is not changed: {found}");
        }
    }
    let mut uncorrected = bent(&truth, [-0.02, 0.0, 0.0]);
    uncorrected.calibration = None;
    solve(&mut uncorrected, 30);
    assert!(errors(&uncorrected, &truth, 1.0).1 > 0.01, "what it costs not to ask");
}

#[test]
fn few_sightings_leave_the_sensor_as_it_was_calibrated() {
    let mut problem = bent(&scene(3, 4, &[0, 1]), [0.0; 3]);
    for (i, (_, information)) in problem.calibration.as_mut().unwrap().seen.iter_mut().enumerate() {
        *information = [0.01 + 1e-4 * spread(i, 0), 0.0, 0.01];
    }
    for (distorted, _) in &mut problem.calibration.as_mut().unwrap().seen {
        distorted.velocity *= 0.01;
    }
    problem.set_sensor([0.015, 0.0, 0.01]);
    solve(&mut problem, 30);
    let found = found(&problem);
    assert!(found.iter().all(|value| value.abs() < 2e-4), "{found:?}");
}
