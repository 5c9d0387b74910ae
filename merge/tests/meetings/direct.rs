//! Direct refinement of keyframes with exact depths.

use crate::rendered::rendered_map;
use crate::yard::{past, yard};
use backend::sim3_align::Sim3AlignParams;
use geometry::{Se3, Sim3};
use map::{KeyframeId, Map};
use merge::direct::refine_directly;
use merge::key_points::KeyPointParams;
use merge::prepared::PreparedMap;
use nalgebra::SVector;
use place_recog::KeyframeFeatures;
use place_recog::features::Features;
use std::sync::LazyLock;

/// Three keyframes, 30 cm apart.
fn keyframes() -> &'static Map {
    static MAP: LazyLock<Map> =
        LazyLock::new(|| rendered_map(yard(), &past(0.0, 0.6, 0.3, &Se3::identity())));
    &MAP
}

/// No features are needed to align images.
fn featureless(map: &Map) -> KeyframeFeatures {
    map.keyframes.keys().map(|&id| (id, Features::default())).collect()
}

/// A start that is off by `size` in each degree of freedom.
fn off(truth: &Sim3, size: f64) -> Sim3 {
    let signs = [1.0, -1.0, 1.0, 0.3, 0.3, -0.3, 1.0];
    Sim3::exp(&(SVector::from(signs) * size)) * *truth
}

#[test]
fn a_pair_is_refined_to_the_truth() {
    let (map, key_points) = (keyframes(), KeyPointParams::default());
    let features = featureless(map);
    let prepared = PreparedMap::new(map, &features, &key_points);
    let [i, j] = [KeyframeId(2), KeyframeId(0)];
    let truth = prepared.world_from(j).unwrap().inverse() * prepared.world_from(i).unwrap();
    let (source, target) = (prepared.get(i).unwrap(), prepared.get(j).unwrap());
    // The better of two starts is taken.
    let starts = [off(&truth, 0.3), off(&truth, 0.02)];
    let refined = refine_directly(source, target, &starts, &Sim3AlignParams::default()).unwrap();
    // The boxes are some 4 m away.
    let error = (refined.estimate.a_from_b * truth.inverse()).log();
    assert!(error.amax() < 5e-3, "{error}");
    assert!(refined.inlier_share > 0.8 && refined.overlap > 0.6, "{refined:?}");
    assert!(refined.estimate.information.cholesky().is_some());
}

#[test]
fn keyframes_without_a_common_view_are_refused() {
    let (map, key_points) = (keyframes(), KeyPointParams::default());
    let features = featureless(map);
    let here = PreparedMap::new(map, &features, &key_points);
    let elsewhere = rendered_map(&loopbox_tests::World::yard(8), &past(0.0, 0.0, 0.3, &Se3::identity()));
    let features = featureless(&elsewhere);
    let there = PreparedMap::new(&elsewhere, &features, &key_points);
    let (source, target) = (here.get(KeyframeId(0)).unwrap(), there.get(KeyframeId(0)).unwrap());
    let refined = refine_directly(source, target, &[Sim3::identity()], &Sim3AlignParams::default());
    // Where it does not refuse outright, the share that agrees tells.
    assert!(refined.as_ref().map_or(true, |refined| refined.inlier_share < 0.5), "{refined:?}");
}

/// Neighbours are those in time among the keyframes that have features.
#[test]
fn keyframes_without_features_are_not_there() {
    let (map, key_points) = (keyframes(), KeyPointParams::default());
    let mut features = featureless(map);
    features.remove(KeyframeId(1));
    let prepared = PreparedMap::new(map, &features, &key_points);
    assert_eq!(prepared.order(), [KeyframeId(0), KeyframeId(2)]);
    assert_eq!(prepared.neighbours(KeyframeId(0)), (None, Some(KeyframeId(2))));
    assert_eq!(prepared.neighbours(KeyframeId(1)), (None, None));
    assert!(prepared.get(KeyframeId(1)).is_none() && prepared.get(KeyframeId(2)).is_some());
}
