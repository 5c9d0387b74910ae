use super::*;
use crate::test_support::Numbers;
use crate::test_support::point_scene::{CAMERA, Scene, measure, scene, scene_to, visible};
use geometry::Sim3;
use nalgebra::{Matrix3, Vector2, Vector4};

/// The state of `scene`.
fn truth(scene: &Scene) -> Vector4<f64> {
    let Sim3 { translation: t, scale, .. } = scene.target_from_source;
    Vector4::new(scale, t.x, t.y, t.z)
}

fn estimate(scene: &Scene) -> Result<PairScale, ScaleRefusal> {
    pair_scale(&scene.matches, &scene.target_from_source.rotation, &ScaleFilterParams::default())
}

fn mean(pair: &PairScale) -> Vector4<f64> {
    let t = pair.translation;
    Vector4::new(pair.scale, t.x, t.y, t.z)
}

#[test]
fn exact_points_give_the_exact_state() {
    for seed in 0..20 {
        let scene = scene(seed, 30, 0.0, 0.0);
        let pair = estimate(&scene).unwrap();
        // What is left is the pull of the vague prior.
        assert!((mean(&pair) - truth(&scene)).norm() < 1e-6 * scene.target_from_source.scale, "seed {seed}");
        assert_eq!((pair.used, pair.gated), (30, 0));
        assert_eq!(pair.variance, pair.covariance[(0, 0)]);
    }
}

#[test]
fn wrong_matches_are_gated_and_do_not_move_the_scale() {
    for seed in 0..50 {
        let scene = scene(seed, 80, 0.3, 1.0);
        let pair = estimate(&scene).unwrap();
        let error = (pair.scale / scene.target_from_source.scale).ln();
        assert!(error.abs() < 0.03, "seed {seed}: log error {error}");
        assert!((20..=32).contains(&pair.gated), "seed {seed}: {} gated", pair.gated);
    }
}

/// The normalised estimation error squared of σ and of the state, averaged over 200 seeds.
fn average_nees(relative: f64, wrong: f64) -> [f64; 2] {
    let (mut of_scale, mut of_state) = (0.0, 0.0);
    for seed in 0..200 {
        let scene = scene_to(relative, seed, 60, wrong, 1.0);
        let pair = estimate(&scene).unwrap();
        let error = mean(&pair) - truth(&scene);
        of_scale += error[0] * error[0] / pair.variance / 200.0;
        of_state += error.dot(&(pair.covariance.try_inverse().unwrap() * error)) / 200.0;
    }
    [of_scale, of_state]
}

/// The 0.05 % and 99.95 % quantiles of χ² with 200 and with 800 degrees of freedom, over 200.
const OF_SCALE: std::ops::RangeInclusive<f64> = 0.70..=1.36;
const OF_STATE: std::ops::RangeInclusive<f64> = 3.37..=4.69;

#[test]
fn the_covariance_is_honest() {
    for wrong in [0.0, 0.3] {
        let [of_scale, of_state] = average_nees(0.01, wrong);
        assert!(OF_SCALE.contains(&of_scale), "scale: {of_scale}, {wrong} wrong");
        assert!(OF_STATE.contains(&of_state), "state: {of_state}, {wrong} wrong");
    }
}

#[test]
fn the_variance_of_the_scale_is_honest_for_coarse_depths_too() {
    for wrong in [0.0, 0.3] {
        let [of_scale, _] = average_nees(0.03, wrong);
        assert!(OF_SCALE.contains(&of_scale), "scale: {of_scale}, {wrong} wrong");
    }
}

#[test]
fn source_and_target_may_change_places() {
    let mut scene = scene(3, 60, 0.2, 1.0);
    let forward = estimate(&scene).unwrap();
    scene.target_from_source.rotation = scene.target_from_source.rotation.inverse();
    scene.matches.iter_mut().for_each(|m| std::mem::swap(&mut m.source, &mut m.target));
    let backward = estimate(&scene).unwrap();
    assert_eq!(forward.used, backward.used);
    assert!((forward.scale * backward.scale - 1.0).abs() < 1e-6);
    assert!((forward.distance_ratio * backward.distance_ratio - 1.0).abs() < 1e-12);
}

#[test]
fn the_order_of_the_matches_does_not_matter() {
    let mut scene = scene(5, 60, 0.3, 1.0);
    let forward = estimate(&scene).unwrap();
    scene.matches.reverse();
    let backward = estimate(&scene).unwrap();
    assert_eq!(forward.used, backward.used);
    assert!((forward.scale / backward.scale - 1.0).abs() < 1e-8);
}

#[test]
fn the_covariance_of_an_unprojected_pixel_is_that_of_samples() {
    let numbers = &mut Numbers::new(1);
    let point = Vector3::new(0.8, -0.5, 4.0);
    let expected = measure(&point, 0.0, numbers);
    assert!((expected.position - point).norm() < 1e-12);
    let mut sampled = Matrix3::zeros();
    let noise = 0.1;
    for _ in 0..20_000 {
        let error = (measure(&point, noise, numbers).position - point) / noise;
        sampled += error * error.transpose() / 20_000.0;
    }
    assert!((sampled - expected.covariance).norm() < 0.03 * expected.covariance.norm());
    // The lateral part is a thousand times smaller: the direction across the ray, on its own.
    let across = point.cross(&Vector3::x()).normalize();
    let ratio = across.dot(&(sampled * across)) / across.dot(&(expected.covariance * across));
    assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
}

#[test]
fn pixels_without_a_depth_give_no_point() {
    let pixel = Vector2::new(3.0, 4.0);
    for [inverse_depth, pixel_variance, variance] in
        [[0.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [f64::NAN, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, f64::INFINITY]]
    {
        let point = MeasuredPoint::unproject(&CAMERA, pixel, inverse_depth, pixel_variance, variance);
        assert_eq!(point, None);
    }
}

#[test]
fn too_few_matches_are_refused() {
    let scene = scene(0, 7, 0.0, 1.0);
    assert_eq!(estimate(&scene), Err(ScaleRefusal::TooFew { given: 7, needed: 8 }));
}

#[test]
fn points_too_close_together_are_refused() {
    let mut scene = scene(0, 40, 0.0, 0.0);
    let numbers = &mut Numbers::new(9);
    for m in &mut scene.matches {
        let source = Vector3::new(0.1, 0.2, 4.0) + numbers.vector(0.004);
        m.source = measure(&source, 1.0, numbers);
        m.target = measure(&(scene.target_from_source.rotation * source * 1.3), 1.0, numbers);
    }
    assert_eq!(estimate(&scene), Err(ScaleRefusal::Degenerate));
    let first = scene.matches[0];
    scene.matches.fill(first);
    assert_eq!(estimate(&scene), Err(ScaleRefusal::Degenerate));
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let good = scene(0, 20, 0.0, 1.0);
    let spoils: [fn(&mut PointMatch); 4] = [
        |m| m.source.position.x = f64::NAN,
        |m| m.target.covariance[(1, 1)] = f64::INFINITY,
        |m| m.target.position = Vector3::zeros(),
        |m| m.source.covariance = Matrix3::zeros(),
    ];
    for spoil in spoils {
        let mut matches = good.matches.clone();
        spoil(&mut matches[4]);
        let found = pair_scale(&matches, &good.target_from_source.rotation, &ScaleFilterParams::default());
        assert_eq!(found, Err(ScaleRefusal::InvalidMatch { index: 4 }));
    }
    let rotation = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(f64::NAN, 0.0, 0.0, 0.0));
    let found = pair_scale(&good.matches, &rotation, &ScaleFilterParams::default());
    assert_eq!(found, Err(ScaleRefusal::InvalidRotation));
}

#[test]
fn unrelated_points_are_refused() {
    for seed in 0..20 {
        assert!(estimate(&scene(seed, 60, 1.0, 1.0)).is_err(), "seed {seed}");
    }
}

#[test]
fn a_scale_far_from_the_ratio_of_distances_is_refused() {
    // All source points at distance about 4, the target camera 40 units back: distances grow, the scale is 1.
    let mut scene = scene(2, 40, 0.0, 0.0);
    let numbers = &mut Numbers::new(4);
    for m in &mut scene.matches {
        let source = visible(numbers);
        m.source = measure(&source, 0.0, numbers);
        m.target = measure(
            &(scene.target_from_source.rotation * source + Vector3::new(0.0, 0.0, 40.0)),
            0.0,
            numbers,
        );
    }
    assert!(matches!(estimate(&scene), Err(ScaleRefusal::CrossCheck { .. })));
}
