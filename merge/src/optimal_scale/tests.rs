use super::*;
use crate::test_support::Numbers;
use geometry::Sim3;
use nalgebra::{UnitQuaternion, Vector3};

/// Estimates from `(scale, deviation, matches)`.
fn triple(values: [(f64, f64, usize); 3]) -> Neighbourhood {
    values.map(|(scale, deviation, match_count)| {
        Some(PairEstimate { scale, variance: deviation * deviation, match_count })
    })
}

fn mirrored(mut estimates: Neighbourhood) -> Neighbourhood {
    estimates.reverse();
    estimates
}

fn letter(estimates: &Neighbourhood, volume_ratio: f64) -> Result<OptimalScale, OptimalScaleRefusal> {
    algorithm_1(estimates, volume_ratio, &OptimalScaleParams::default())
}

/// Parameters that take the pairs' variances as they stand.
fn independent() -> OptimalScaleParams {
    OptimalScaleParams { shared_deviation: 0.0, ..OptimalScaleParams::default() }
}

fn fused(estimates: &Neighbourhood, volume_ratio: f64) -> Result<OptimalScale, OptimalScaleRefusal> {
    inverse_variance(estimates, volume_ratio, &independent())
}

#[test]
fn algorithm_1_takes_the_closest_two_with_more_matches() {
    // (−1, 0): gap 0.5, γ 90. Then (0, 1): gap 0.25, γ 110: better in both.
    let found = letter(&triple([(1.0, 0.1, 80), (1.5, 0.1, 100), (1.75, 0.3, 120)]), 0.8).unwrap();
    assert_eq!(found.scale, 1.625);
    assert_eq!(found.used, [false, true, true]);
    assert_eq!((found.scale_gap, found.match_count, found.basis), (0.25, 110.0, Basis::Agreement));
    assert!((found.variance - 0.025).abs() < 1e-12);
}

#[test]
fn algorithm_1_depends_on_the_order_of_visit() {
    // The ends' two comes first with a wide gap and many matches, and then bars the closer two.
    let estimates = triple([(1.0, 0.1, 120), (2.0, 0.1, 100), (2.0625, 0.1, 80)]);
    let forward = letter(&estimates, 0.8).unwrap();
    assert_eq!((forward.scale, forward.scale_gap), (1.5, 1.0));
    let backward = letter(&mirrored(estimates), 0.8).unwrap();
    assert_eq!((backward.scale, backward.scale_gap), (2.03125, 0.0625));
    // The default says the same both ways.
    let (forward, backward) = (fused(&estimates, 0.8).unwrap(), fused(&mirrored(estimates), 0.8).unwrap());
    assert_eq!(forward.used, [false, true, true]);
    assert!((forward.scale - backward.scale).abs() < 1e-12);
}

#[test]
fn algorithm_1_falls_back_to_the_centre() {
    let close = triple([(1.0, 0.1, 50), (1.125, 0.2, 60), (1.25, 0.1, 70)]);
    let far = triple([(1.0, 0.1, 50), (7.0, 0.2, 60), (13.0, 0.1, 70)]);
    // The volumes do not fit: at 0.5 exactly, the strict test of the paper fails.
    for (estimates, volume_ratio, scale) in [(close, 0.5, 1.125), (close, 0.2, 1.125), (far, 0.8, 7.0)] {
        let found = letter(&estimates, volume_ratio).unwrap();
        assert_eq!((found.scale, found.basis, found.used), (scale, Basis::Centre, [false, true, false]));
        assert_eq!((found.scale_gap, found.match_count), (0.0, 60.0));
    }
    let mut lost = far;
    lost[1] = None;
    assert_eq!(letter(&lost, 0.8), Err(OptimalScaleRefusal::NoEstimate));
}

#[test]
fn three_that_agree_are_weighted_by_their_information() {
    let found = fused(&triple([(1.0, 0.01, 50), (1.01, 0.02, 60), (0.99, 0.01, 70)]), 0.8).unwrap();
    let logs: [f64; 3] = [0.0, 1.01f64.ln(), 0.99f64.ln()];
    let weights = [1e4, 1.01 * 1.01 / 4e-4, 0.99 * 0.99 / 1e-4];
    let information: f64 = weights.iter().sum();
    let expected = (logs.iter().zip(weights).map(|(l, w)| l * w).sum::<f64>() / information).exp();
    assert!((found.scale - expected).abs() < 1e-12);
    assert!((found.variance - expected * expected / information).abs() < 1e-15);
    assert_eq!((found.used, found.match_count, found.basis), ([true; 3], 60.0, Basis::Agreement));
    assert!((found.scale_gap - 0.02).abs() < 1e-12);
}

#[test]
fn one_that_disagrees_is_left_out_wherever_it_stands() {
    let good = (1.5, 0.02, 60);
    for wrong in 0..3 {
        let mut values = [good, good, good];
        values[wrong] = (2.5, 0.02, 900);
        let found = fused(&triple(values), 0.8).unwrap();
        assert!((found.scale - 1.5).abs() < 1e-12);
        assert!((found.variance - 0.0002).abs() < 1e-12);
        assert!(!found.used[wrong]);
    }
}

/// Pairs that claim to know their scales to a tenth of a percent differ by one: depths of real keyframes do.
#[test]
fn what_all_pixels_of_a_keyframe_err_together_separates_no_pairs() {
    let close = triple([(1.0, 0.001, 50), (1.01, 0.001, 60), (1.02, 0.001, 70)]);
    assert!(matches!(fused(&close, 0.8), Err(OptimalScaleRefusal::Inconsistent { .. })));
    let found = inverse_variance(&close, 0.8, &OptimalScaleParams::default()).unwrap();
    assert_eq!(found.used, [true; 3]);
    assert!((found.scale - 1.01).abs() < 1e-4);
    // Three scales known to about 1 % each: their mean is known to 1 %/√3.
    assert!((found.variance.sqrt() - 0.0058).abs() < 1e-3, "{}", found.variance.sqrt());
}

#[test]
fn of_two_twos_the_one_with_more_matches_wins() {
    // The middle agrees with both ends, the ends do not agree with each other.
    let found = fused(&triple([(1.0, 0.02, 50), (1.06, 0.02, 60), (1.12, 0.02, 70)]), 0.8).unwrap();
    assert_eq!(found.used, [false, true, true]);
}

#[test]
fn three_that_disagree_are_refused_and_low_volume_takes_the_centre() {
    let estimates = triple([(1.0, 0.01, 50), (1.5, 0.01, 60), (2.5, 0.01, 70)]);
    assert_eq!(fused(&estimates, 0.8), Err(OptimalScaleRefusal::Inconsistent { scale_gap: 0.5 }));
    let found = fused(&estimates, 0.4).unwrap();
    assert_eq!((found.scale, found.basis), (1.5, Basis::Centre));
}

#[test]
fn missing_and_senseless_estimates_are_distinguished() {
    let mut estimates = triple([(1.0, 0.1, 50), (2.0, 0.1, 60), (3.0, 0.1, 70)]);
    (estimates[0], estimates[1]) = (None, None);
    let found = fused(&estimates, 0.8).unwrap();
    assert_eq!((found.basis, found.used, found.scale_gap), (Basis::Single, [false, false, true], 0.0));
    assert!((found.scale - 3.0).abs() < 1e-12);
    assert_eq!(fused(&[None; 3], 0.8), Err(OptimalScaleRefusal::NoEstimate));
    assert_eq!(fused(&estimates, f64::NAN), Err(OptimalScaleRefusal::InvalidInput));
    for (scale, variance) in [(f64::NAN, 1.0), (-1.0, 1.0), (1.0, 0.0), (1.0, f64::INFINITY)] {
        estimates[2] = Some(PairEstimate { scale, variance, match_count: 9 });
        assert_eq!(fused(&estimates, 0.8), Err(OptimalScaleRefusal::InvalidInput));
        assert_eq!(letter(&estimates, 0.8), Err(OptimalScaleRefusal::InvalidInput));
    }
}

#[test]
fn the_volume_ratio_follows_the_scale_and_ignores_far_points() {
    let numbers = &mut Numbers::new(3);
    let source: Vec<_> = (0..500).map(|_| numbers.vector(1.0)).collect();
    let rotation = numbers.rotation(1.0);
    let truth = Sim3::new(rotation, Vector3::new(4.0, 5.0, 6.0), 1.7);
    let mut target: Vec<_> = source.iter().map(|&point| truth * point).collect();
    assert!((volume_ratio(&source, &target, &truth).unwrap() - 1.0).abs() < 1e-9);
    let half = Sim3::new(rotation, Vector3::zeros(), 0.85);
    assert!((volume_ratio(&source, &target, &half).unwrap() - 0.125).abs() < 1e-9);
    target.extend((0..10).map(|_| numbers.vector(1000.0)));
    assert!(volume_ratio(&source, &target, &truth).unwrap() > 0.85);
}

#[test]
fn clouds_without_a_volume_have_no_ratio() {
    let numbers = &mut Numbers::new(3);
    let cloud: Vec<_> = (0..30).map(|_| numbers.vector(1.0)).collect();
    let same = Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), 1.0);
    let flat: Vec<_> = cloud.iter().map(|p| Vector3::new(p.x, p.y, 2.0)).collect();
    let mut broken = cloud.clone();
    broken[7].y = f64::NAN;
    for bad in [&cloud[..19], &flat, &broken, &[]] {
        assert_eq!(volume_ratio(bad, &cloud, &same), None);
        assert_eq!(volume_ratio(&cloud, bad, &same), None);
    }
}
