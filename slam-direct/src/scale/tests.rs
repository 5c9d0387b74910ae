use super::*;
use crate::test_scene::{View as Rendered, exact_map, pose};

use geometry::{Random, Se3, Sim3};
use map::EdgeKind;
use nalgebra::SMatrix;

/// Keyframes of a camera that goes to the right before the yard.
fn passed(count: u32) -> LocalMap {
    let views: Vec<Rendered> =
        (0..count).map(|i| Rendered::new(pose(0.25 * f64::from(i), 0.0, 0.0, 0.0, 0.0))).collect();
    exact_map(&views, 16)
}

/// The map with all that comes behind a keyframe smaller by a factor about it: poses and points that were first seen there.
fn shrunk_behind(mut map: LocalMap, cut: usize, factor: f64) -> LocalMap {
    let eye = map.keyframes[cut].camera_from_world.inverse().translation;
    for state in map.keyframes.iter_mut().skip(cut + 1) {
        let world_from_camera = state.camera_from_world.inverse();
        let place = eye + (world_from_camera.translation - eye) * factor;
        state.camera_from_world = Se3::new(world_from_camera.rotation, place).inverse();
        state.points.iter_mut().for_each(|point| {
            point.inverse_depth /= factor;
            point.variance /= factor * factor;
        });
    }
    map
}

/// The map without what keyframes of one side of a cut see of points of the other, but for a share, and that as far off as the search for a
/// patch goes.
fn matched_by_chance(mut map: LocalMap, cut: usize, share: f64, seed: u64) -> LocalMap {
    let mut random = Random::new(seed);
    let places: Vec<Se3> = map.keyframes.iter().map(|state| state.camera_from_world).collect();
    let camera = map.camera;
    for (host, state) in map.keyframes.iter_mut().enumerate() {
        let world_from_host = places[host].inverse();
        for point in &mut state.points {
            point.observations.retain_mut(|seen| {
                if (seen.keyframe <= cut) == (host <= cut) {
                    return true;
                }
                let predicted = camera.project(
                    &(places[seen.keyframe] * (world_from_host * (point.ray / point.inverse_depth))),
                );
                seen.pixel =
                    [predicted.x, predicted.y].map(|v| v as f32 + 6.0 * (2.0 * random.unit() as f32 - 1.0));
                random.unit() < share
            });
        }
    }
    map
}

#[test]
fn a_right_map_carries_its_scale_everywhere() {
    let map = passed(8);
    assert_eq!(carried_scale(&map, &[], &Params::default()).breaks, []);
    let noisy = noisy(map, 0.7);
    assert_eq!(carried_scale(&noisy, &[], &Params::default()).breaks, []);
}

/// Where each keyframe sees its points is off by so many pixels, one standard deviation.
fn noisy(mut map: LocalMap, sigma: f32) -> LocalMap {
    let mut random = Random::new(3);
    for seen in map.keyframes.iter_mut().flat_map(|k| &mut k.points).flat_map(|p| &mut p.observations) {
        seen.pixel = seen.pixel.map(|v| v + sigma * random.normal() as f32);
    }
    map
}

#[test]
fn a_scale_that_only_matches_by_chance_carry_is_said_to_break() {
    for (seed, cut) in [(1, 3), (2, 4)] {
        let map = matched_by_chance(shrunk_behind(passed(8), cut, 0.4), cut, 0.2, seed);
        let found = carried_scale(&map, &[], &Params::default()).breaks;
        assert_eq!(found.iter().map(|b| b.before).collect::<Vec<_>>(), [LocalMap::id(cut)], "{found:?}");
    }
}

/// Several keyframes on end are looked at, and where the scale is not carried on, often their neighbours as well.
#[test]
fn a_break_is_another_than_the_one_beside_it() {
    let found = |before| ScaleBreak { before: LocalMap::id(before), points: 9, inliers: 3 };
    assert!(found(4).is_apart_from(None));
    assert!(!found(4).is_apart_from(Some(LocalMap::id(4))));
    assert!(!found(5).is_apart_from(Some(LocalMap::id(4))));
    assert!(found(6).is_apart_from(Some(LocalMap::id(4))));
    assert!(found(2).is_apart_from(Some(LocalMap::id(9))), "of another map");
}

#[test]
fn a_loop_carries_the_scale_over_what_it_spans() {
    let map = matched_by_chance(shrunk_behind(passed(8), 3, 0.4), 3, 0.2, 1);
    assert_eq!(carried_scale(&map, &[loop_between(0, 7)], &Params::default()).breaks, []);
    assert_eq!(
        carried_scale(&map, &[loop_between(0, 3)], &Params::default()).breaks.len(),
        1,
        "it ends before the break"
    );
}

fn loop_between(from: usize, to: usize) -> Edge {
    let (from_from_to, information) = (Sim3::identity(), SMatrix::identity());
    Edge { from: LocalMap::id(from), to: LocalMap::id(to), from_from_to, information, kind: EdgeKind::Loop }
}

#[test]
fn a_tail_without_a_scale_of_its_own_is_none() {
    let mut map = matched_by_chance(shrunk_behind(passed(8), 5, 0.4), 5, 0.2, 1);
    assert_eq!(carried_scale(&map, &[], &Params::default()).breaks.len(), 1);
    // What the last two keyframes see has no depth.
    map.keyframes.iter_mut().skip(6).flat_map(|k| &mut k.points).for_each(|point| point.doubt = 1e3);
    assert_eq!(carried_scale(&map, &[], &Params::default()).breaks, []);
}

#[test]
fn chance_is_a_binomial_tail() {
    assert!((at_least_by_chance(0, 10) - 1.0).abs() < 1e-12);
    assert!((at_least_by_chance(3, 3) - (1.0f64 / 3.0).powi(3)).abs() < 1e-12);
    assert!((at_least_by_chance(1, 2) - 5.0 / 9.0).abs() < 1e-12);
    assert_eq!(at_least_by_chance(0, 0), 1.0);
}
