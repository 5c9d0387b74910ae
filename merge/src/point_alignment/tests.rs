use super::*;
use crate::test_support::Numbers;
use crate::test_support::point_scene::{Scene, scene, scene_to};

/// The true similarity, wrong by about `size`.
fn disturbed(scene: &Scene, seed: u64, size: f64) -> Sim3 {
    let numbers = &mut Numbers::new(seed + 1000);
    let step = SVector::<f64, 7>::from_fn(|_, _| numbers.uniform(-size, size));
    Sim3::exp(&step) * scene.target_from_source
}

fn error(scene: &Scene, found: &PointAlignment) -> SVector<f64, 7> {
    (scene.target_from_source * found.target_from_source.inverse()).log()
}

#[test]
fn exact_points_give_the_exact_similarity() {
    for seed in 0..20 {
        let scene = scene(seed, 30, 0.0, 0.0);
        let params = PointAlignmentParams::default();
        let found = align_points(&scene.matches, disturbed(&scene, seed, 0.05), &params).unwrap();
        assert!(error(&scene, &found).norm() < 1e-6, "seed {seed}: {}", error(&scene, &found));
        assert_eq!(found.inlier_count, 30);
    }
}

#[test]
fn wrong_matches_have_next_to_no_say() {
    for seed in 0..50 {
        let scene = scene(seed, 120, 0.3, 1.0);
        let params = PointAlignmentParams::default();
        let found = align_points(&scene.matches, disturbed(&scene, seed, 0.02), &params).unwrap();
        let error = error(&scene, &found);
        assert!(error.fixed_rows::<3>(3).norm() < 0.5f64.to_radians(), "seed {seed}: {error}");
        assert!(error[6].abs() < 0.02, "seed {seed}: {error}");
        assert!((75..=95).contains(&found.inlier_count), "seed {seed}: {} inliers", found.inlier_count);
    }
}

/// The normalised squared error has seven degrees of freedom: its mean over many scenes tells whether the
/// information is true.
#[test]
fn the_information_is_consistent() {
    let runs = 300;
    let mut sum = 0.0;
    for seed in 0..runs {
        let scene = scene_to(0.01, seed, 80, 0.0, 1.0);
        let params = PointAlignmentParams::default();
        let found = align_points(&scene.matches, scene.target_from_source, &params).unwrap();
        let error = error(&scene, &found);
        sum += error.dot(&(found.information * error));
    }
    let mean = sum / runs as f64;
    assert!((6.2..8.2).contains(&mean), "normalised squared error {mean} of 7");
}

/// Noise in the source's points must not shrink the scale: both directions give the same.
#[test]
fn swapping_source_and_target_inverts_the_result() {
    let mut gap = 0.0;
    for seed in 0..20 {
        let scene = scene(seed, 60, 0.0, 1.0);
        let swapped: Vec<PointMatch> =
            scene.matches.iter().map(|m| PointMatch { source: m.target, target: m.source }).collect();
        let params = PointAlignmentParams::default();
        let there = align_points(&scene.matches, scene.target_from_source, &params).unwrap();
        let back = align_points(&swapped, scene.target_from_source.inverse(), &params).unwrap();
        gap += (there.target_from_source * back.target_from_source).scale.ln() / 20.0;
    }
    assert!(gap.abs() < 1e-3, "{gap}");
}

#[test]
fn what_does_not_fix_the_similarity_is_refused() {
    let scene = scene(1, 60, 0.0, 1.0);
    let params = PointAlignmentParams::default();
    let start = scene.target_from_source;
    let one_point = vec![scene.matches[0]; 40];
    assert_eq!(align_points(&[], start, &params), Err(PointAlignmentRefusal::Degenerate));
    assert!(align_points(&one_point, start, &params).is_err());
    let few = align_points(&scene.matches[..8], start, &params);
    assert_eq!(few, Err(PointAlignmentRefusal::FewInliers { inliers: 8, given: 8 }));
    let invalid = Sim3 { scale: f64::NAN, ..start };
    assert_eq!(align_points(&scene.matches, invalid, &params), Err(PointAlignmentRefusal::InvalidStart));
}
