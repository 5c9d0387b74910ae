use super::covariance::{Correspondence, PointNoise, Tangent, covariance, gradient, hessian, objective};
use super::*;
use crate::test_support::Numbers;
use nalgebra::{Matrix3, SVector, UnitQuaternion};

const KINDS: [ResidualKind; 3] =
    [ResidualKind::PointToPoint, ResidualKind::PointToPlane, ResidualKind::Generalized];

/// A point on the walls of a room with a box standing in it, about 4 × 3 × 6 units.
fn on_boxes(numbers: &mut Numbers) -> Vector3<f64> {
    let (a, b) = (numbers.uniform(-1.0, 1.0), numbers.uniform(-1.0, 1.0));
    match numbers.uniform(0.0, 6.0) as usize {
        0 => Vector3::new(2.0 * a, 1.5, 4.0 + 3.0 * b),
        1 => Vector3::new(-2.0, 1.5 * a, 4.0 + 3.0 * b),
        2 => Vector3::new(2.0 * a, 1.5 * b, 7.0),
        3 => Vector3::new(0.8 + 0.5 * a, 0.3, 4.5 + 0.5 * b),
        4 => Vector3::new(0.3, 0.9 + 0.6 * a, 4.5 + 0.5 * b),
        _ => Vector3::new(0.8 + 0.5 * a, 0.9 + 0.6 * b, 4.0),
    }
}

fn boxes(count: usize, numbers: &mut Numbers) -> Vec<Vector3<f64>> {
    (0..count).map(|_| on_boxes(numbers)).collect()
}

/// `points` in the frame `source_from_target` leads to, with noise of deviation `noise` in each coordinate.
fn seen(
    points: &[Vector3<f64>],
    source_from_target: &Sim3,
    noise: f64,
    numbers: &mut Numbers,
) -> Vec<Vector3<f64>> {
    points
        .iter()
        .map(|&p| *source_from_target * p + Vector3::from_fn(|_, _| numbers.normal()) * noise)
        .collect()
}

fn motion(scale: f64) -> Sim3 {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.5, 0.2));
    Sim3::new(rotation, Vector3::new(0.4, -0.2, 0.7), scale)
}

/// `truth` with a guess's error: 3° and 0.2 units.
fn guess(truth: &Sim3) -> Sim3 {
    let error = SVector::<f64, 7>::from([0.1, -0.1, 0.1, 0.03, 0.03, -0.03, 0.0]);
    Sim3::exp(&error) * *truth
}

/// Rotation (rad), translation and ln scale between two similarities, at the middle of the boxes.
fn errors(found: &Sim3, truth: &Sim3) -> (f64, f64, f64) {
    let middle = truth.inverse() * Vector3::new(0.0, 0.0, 4.0);
    let rotation_error = found.rotation.angle_to(&truth.rotation);
    (rotation_error, (*found * middle - *truth * middle).norm(), (found.scale / truth.scale).ln().abs())
}

#[test]
fn a_known_motion_is_found_by_every_kind() {
    for kind in KINDS {
        let mut numbers = Numbers::new(1);
        let truth = motion(1.0);
        let target = boxes(3000, &mut numbers);
        let source = boxes(3000, &mut numbers);
        let target = seen(&target, &Sim3::identity(), 0.01, &mut numbers);
        let source = seen(&source, &truth.inverse(), 0.01, &mut numbers);
        let params = IcpParams { kind, ..Default::default() };
        let found = register(&source.into(), &target.into(), &guess(&truth), &params).unwrap();
        let (rotation_error, shift, _) = errors(&found.target_from_source, &truth);
        // Points of other places pull point-to-point along the walls.
        let bound = if kind == ResidualKind::PointToPoint { 5e-3 } else { 1.5e-3 };
        assert!(
            rotation_error < bound && shift < 2.0 * bound,
            "{kind:?}: {rotation_error} rad, {shift} units"
        );
        let converged = found.converged || kind == ResidualKind::PointToPoint;
        assert!(converged && found.overlap > 0.95, "{kind:?}: {found:?}");
        assert_eq!(found.target_from_source.scale, 1.0);
        assert_eq!(found.information.row(6).norm(), 0.0);
    }
}

#[test]
fn the_scale_is_found_where_asked_for() {
    let mut numbers = Numbers::new(2);
    let truth = motion(1.7);
    let target = boxes(3000, &mut numbers);
    let source = seen(&boxes(3000, &mut numbers), &truth.inverse(), 0.005, &mut numbers);
    let (source, target) = (Cloud::from(source), Cloud::from(target));
    let initial = Sim3 { scale: truth.scale * 1.04, ..guess(&truth) };
    let params = IcpParams { estimate_scale: true, ..Default::default() };
    let found = register(&source, &target, &initial, &params).unwrap();
    let (rotation_error, shift, ratio) = errors(&found.target_from_source, &truth);
    assert!(
        rotation_error < 2e-3 && shift < 4e-3 && ratio < 2e-3,
        "{rotation_error} rad, {shift} units, {ratio}"
    );
    assert!(found.information[(6, 6)] > 0.0);
    let strict = IcpParams { max_log_scale_change: 0.02, ..params };
    let refused = register(&source, &target, &initial, &strict).unwrap_err();
    assert!(matches!(refused, IcpRefusal::ScaleRanAway { .. }), "{refused}");
}

#[test]
fn outliers_and_missing_parts_are_borne() {
    for kind in [ResidualKind::PointToPlane, ResidualKind::Generalized] {
        let mut numbers = Numbers::new(3);
        let truth = motion(1.0);
        let target: Vec<_> = boxes(4000, &mut numbers).into_iter().filter(|p| p.z < 6.0).collect();
        let scene: Vec<_> = boxes(4000, &mut numbers).into_iter().filter(|p| p.z > 2.0).collect();
        let mut source = seen(&scene, &truth.inverse(), 0.01, &mut numbers);
        for point in source.iter_mut().step_by(5) {
            // Two of five with the next line: anywhere in the room.
            *point = truth.inverse() * (Vector3::new(0.0, 0.0, 4.0) + numbers.vector(2.0));
        }
        for point in source.iter_mut().skip(1).step_by(5) {
            *point = truth.inverse() * (Vector3::new(0.0, 0.0, 4.0) + numbers.vector(2.0));
        }
        let params = IcpParams { kind, ..Default::default() };
        let found = register(&source.into(), &target.into(), &guess(&truth), &params).unwrap();
        let (rotation_error, shift, _) = errors(&found.target_from_source, &truth);
        assert!(rotation_error < 4e-3 && shift < 1e-2, "{kind:?}: {rotation_error} rad, {shift} units");
        assert!(found.overlap < 0.85, "{kind:?}: {}", found.overlap);
    }
}

#[test]
fn a_wall_leaves_its_motions_open() {
    for kind in KINDS {
        let mut numbers = Numbers::new(4);
        let mut wall = |noise: f64| -> Cloud {
            let at = |n: &mut Numbers| Vector3::new(n.uniform(-2.0, 2.0), n.uniform(-2.0, 2.0), 3.0);
            let points = (0..2000).map(|_| at(&mut numbers)).collect::<Vec<_>>();
            seen(&points, &Sim3::identity(), noise, &mut numbers).into()
        };
        for noise in [0.0, 0.005] {
            let (source, target) = (wall(noise), wall(noise));
            let params = IcpParams { kind, ..Default::default() };
            let refused = register(&source, &target, &Sim3::identity(), &params).unwrap_err();
            let IcpRefusal::Degenerate(open) = refused else { panic!("{kind:?}: {refused}") };
            // Along the wall, or about its normal.
            assert!(open.translation().z.abs() < 0.1, "{open}");
            assert!(open.rotation().xy().norm() < 0.1, "{open}");
        }
    }
}

#[test]
fn a_line_leaves_its_direction_open() {
    let mut numbers = Numbers::new(5);
    let mut line = || -> Cloud {
        let points: Vec<_> = (0..500).map(|_| Vector3::new(0.0, numbers.uniform(-2.0, 2.0), 3.0)).collect();
        seen(&points, &Sim3::identity(), 0.002, &mut numbers).into()
    };
    let (source, target) = (line(), line());
    let params = IcpParams { kind: ResidualKind::Generalized, ..Default::default() };
    let refused = register(&source, &target, &Sim3::identity(), &params).unwrap_err();
    let IcpRefusal::Degenerate(open) = refused else { panic!("{refused}") };
    // Along the line, about it, or both.
    assert!(open.translation().xz().norm() < 0.1 && open.rotation().xz().norm() < 0.1, "{open}");
    let params = IcpParams { kind: ResidualKind::PointToPlane, ..Default::default() };
    let refused = register(&source, &target, &Sim3::identity(), &params).unwrap_err();
    assert!(
        matches!(refused, IcpRefusal::FewCorrespondences { .. } | IcpRefusal::Degenerate(_)),
        "{refused}"
    );
}

#[test]
fn unusable_input_is_refused_with_its_reason() {
    let mut numbers = Numbers::new(6);
    let good: Cloud = boxes(500, &mut numbers).into();
    let params = IcpParams::default();
    let identity = Sim3::identity();
    let refusal = |source: &Cloud, target: &Cloud, initial: &Sim3| {
        register(source, target, initial, &params).unwrap_err()
    };
    let empty = Cloud::default();
    let too_few = |side, given| IcpRefusal::TooFew { side, given, needed: 50 };
    assert_eq!(refusal(&empty, &good, &identity), too_few(Side::Source, 0));
    assert_eq!(refusal(&good, &boxes(49, &mut numbers).into(), &identity), too_few(Side::Target, 49));

    let mut broken = good.clone();
    broken.points[7].y = f64::NAN;
    assert_eq!(refusal(&good, &broken, &identity), IcpRefusal::InvalidPoint { side: Side::Target, index: 7 });
    let mut negative = Cloud { covariances: Some(vec![Matrix3::identity(); 500]), ..good.clone() };
    negative.covariances.as_mut().unwrap()[3][(1, 1)] = -1.0;
    let invalid = IcpRefusal::InvalidPoint { side: Side::Source, index: 3 };
    assert_eq!(refusal(&negative, &good, &identity), invalid);
    let short = Cloud { covariances: Some(vec![Matrix3::identity(); 499]), ..good.clone() };
    let counts = IcpRefusal::CovarianceCount { side: Side::Source, points: 500, covariances: 499 };
    assert_eq!(refusal(&short, &good, &identity), counts);

    let flat = Sim3 { scale: 0.0, ..identity };
    assert_eq!(refusal(&good, &good, &flat), IcpRefusal::InvalidInitial);
    let one_place: Cloud = vec![Vector3::new(1.0, 2.0, 3.0); 500].into();
    assert_eq!(refusal(&good, &one_place, &identity), IcpRefusal::NoExtent);
    let away = Sim3 { translation: Vector3::new(100.0, 0.0, 0.0), ..identity };
    assert!(matches!(refusal(&good, &good, &away), IcpRefusal::LittleOverlap { overlap: 0.0, .. }));
}

#[test]
fn the_same_input_gives_the_same_output() {
    let run = || {
        let mut numbers = Numbers::new(7);
        let truth = motion(1.0);
        let target = boxes(800, &mut numbers);
        let source = seen(&boxes(800, &mut numbers), &truth.inverse(), 0.01, &mut numbers);
        register(&source.into(), &target.into(), &guess(&truth), &IcpParams::default()).unwrap()
    };
    assert_eq!(run(), run());
}

#[test]
fn a_common_unit_changes_nothing() {
    let mut numbers = Numbers::new(8);
    let truth = motion(1.0);
    let target: Cloud = boxes(800, &mut numbers).into();
    let source: Cloud = seen(&boxes(800, &mut numbers), &truth.inverse(), 0.01, &mut numbers).into();
    let found = register(&source, &target, &guess(&truth), &IcpParams::default()).unwrap();
    let unit = Sim3 { scale: 20.0, ..Sim3::identity() };
    let initial = unit * guess(&truth);
    let larger = register(&source, &target.moved(&unit), &initial, &IcpParams::default()).unwrap();
    let back = unit.inverse() * larger.target_from_source;
    assert!((back.inverse() * found.target_from_source).log().norm() < 1e-6);
    let expected = unit.adjoint() * found.covariance * unit.adjoint().transpose();
    assert!((larger.covariance - expected).norm() < 1e-6 * expected.norm());
    assert!((larger.rmse / 20.0 - found.rmse).abs() < 1e-6);
}

/// Correspondences of points moved by exp(x), residuals anything.
fn correspondences(pairs: &[Correspondence], x: &Tangent) -> Vec<Correspondence> {
    let motion = Sim3::exp(x);
    pairs
        .iter()
        .map(|c| {
            let moved = motion * c.moved;
            Correspondence { moved, residual: c.residual + moved - c.moved, ..*c }
        })
        .collect()
}

fn any_correspondences(numbers: &mut Numbers, to_the_letter: bool) -> Vec<Correspondence> {
    (0..20)
        .map(|index| {
            let root = Matrix3::from_fn(|_, _| numbers.normal());
            let metric = if to_the_letter { Matrix3::identity() } else { root * root.transpose() };
            let (moved, residual) = (numbers.vector(2.0), numbers.vector(0.3));
            Correspondence { source: index, target: index / 2, moved, residual, metric }
        })
        .collect()
}

#[test]
fn derivatives_of_eq_2_are_those_by_differences() {
    for to_the_letter in [true, false] {
        let pairs = any_correspondences(&mut Numbers::new(9), to_the_letter);
        let at = |x: &Tangent| objective(&correspondences(&pairs, x));
        let (analytic, second) = (gradient(&pairs), hessian(&pairs));
        let h = 1e-4;
        let unit = |k: usize| Tangent::from_fn(|row, _| if row == k { h } else { 0.0 });
        for k in 0..7 {
            let numeric = (at(&unit(k)) - at(&-unit(k))) / (2.0 * h);
            assert!((numeric - analytic[k]).abs() < 1e-5 * analytic.norm(), "{k}: {numeric}");
            for l in 0..7 {
                let mixed = at(&(unit(k) + unit(l))) - at(&(unit(k) - unit(l))) - at(&(unit(l) - unit(k)))
                    + at(&(-unit(k) - unit(l)));
                let numeric = mixed / (4.0 * h * h);
                assert!((numeric - second[(k, l)]).abs() < 1e-4 * second.norm(), "{k} {l}: {numeric}");
            }
        }
    }
}

/// `εᵀ cov⁻¹ ε` of a registration's error with its predicted covariance.
fn normalised_squared_error(covariance: &TangentMatrix, error: &Tangent) -> f64 {
    let inverse = covariance.fixed_view::<6, 6>(0, 0).into_owned().try_inverse().unwrap();
    let error = error.fixed_rows::<6>(0).into_owned();
    error.dot(&(inverse * error))
}

#[test]
fn eq_3_predicts_the_scatter_of_fixed_correspondences() {
    // Points seen twice with noise that differs by point and direction; each target point stands for two sources.
    let mut numbers = Numbers::new(10);
    let truth: Vec<_> = (0..60).map(|_| numbers.vector(2.0)).collect();
    let noise: Vec<Matrix3<f64>> = (0..120)
        .map(|_| Matrix3::from_diagonal(&Vector3::from_fn(|_, _| numbers.uniform(0.005, 0.03))))
        .collect();
    let trials = 400;
    let (mut scatter, mut predicted) = (TangentMatrix::zeros(), TangentMatrix::zeros());
    for _ in 0..trials {
        let mut draw = |deviation: &Matrix3<f64>| deviation * Vector3::from_fn(|_, _| numbers.normal());
        let targets: Vec<_> = (0..60).map(|k| truth[k] + draw(&noise[60 + k])).collect();
        let mut pairs: Vec<_> = (0..60)
            .map(|index| {
                let target = index / 2;
                let moved = truth[target] + draw(&noise[index]);
                let residual = moved - targets[target];
                Correspondence { source: index, target, moved, residual, metric: Matrix3::identity() }
            })
            .collect();
        let mut x = Sim3::identity();
        for _ in 0..5 {
            let step = solve::step(&pairs, true);
            pairs = correspondences(&pairs, &step);
            x = Sim3::exp(&step) * x;
        }
        assert!(gradient(&pairs).norm() < 1e-6);
        let squared = |m: &Matrix3<f64>| m * m;
        let noise: Vec<_> = (0..60)
            .map(|k| PointNoise { source: squared(&noise[k]), target: squared(&noise[60 + k / 2]) })
            .collect();
        let error = x.log();
        scatter += error * error.transpose() / f64::from(trials);
        predicted += covariance(&pairs, &noise, true).unwrap() / f64::from(trials);
    }
    // 400 trials know a standard deviation to 3.5 %; the bound is four times that.
    for k in 0..7 {
        let ratio = (scatter[(k, k)] / predicted[(k, k)]).sqrt();
        assert!((0.86..1.14).contains(&ratio), "deviation of {k}: {ratio} of the predicted");
    }
}

#[test]
fn the_covariance_of_registrations_is_that_of_monte_carlo() {
    for (kind, given) in [
        (ResidualKind::PointToPlane, true),
        (ResidualKind::PointToPlane, false),
        (ResidualKind::Generalized, true),
    ] {
        let mut numbers = Numbers::new(11);
        let truth = motion(1.0);
        let deviation = 0.01;
        let params = IcpParams { kind, ..Default::default() };
        let trials = 40;
        let mut squared = 0.0;
        for _ in 0..trials {
            let mut cloud = |motion: &Sim3| -> Cloud {
                let points = boxes(600, &mut numbers);
                let points = seen(&points, motion, deviation, &mut numbers);
                let covariance = Matrix3::identity() * deviation * deviation;
                Cloud { covariances: given.then(|| vec![covariance; points.len()]), points }
            };
            let (target, source) = (cloud(&Sim3::identity()), cloud(&truth.inverse()));
            let found = register(&source, &target, &truth, &params).unwrap();
            let error = (truth * found.target_from_source.inverse()).log();
            squared += normalised_squared_error(&found.covariance, &error) / f64::from(trials);
        }
        // 6 for six degrees of freedom if all is right; measured 6.6, 9.2 (noise not given) and 3.9 (generalised).
        // Eq. 3 knows neither normals of noisy points nor the choice of neighbours, and trimming hides noise that
        // is not given. The stated bound: deviations right within a factor of 1.5.
        let ratio = (squared / 6.0).sqrt();
        assert!((1.0 / 1.5..1.5).contains(&ratio), "{kind:?}, noise given: {given}: {ratio}");
    }
}
