//! New points and the optimisation of their surroundings on rendered views.

use super::*;
use crate::test_scene::{View, exact_map, point_state, pose, quantile};

fn views() -> Vec<View> {
    [(0.0, 0.0), (0.35, 0.05), (-0.3, 0.1)]
        .iter()
        .map(|&(x, z)| View::new(pose(x, 0.0, z, 0.0, 0.0)))
        .collect()
}

/// Keyframe poses and inverse depths of a map moved off the truth, except keyframe 0 and those beyond `last`.
fn disturb(map: &mut LocalMap, last: usize) {
    for (k, state) in map.keyframes.iter_mut().enumerate().take(last + 1).skip(1) {
        let s = if k % 2 == 0 { 1.0 } else { -1.0 };
        let twist = nalgebra::Vector6::new(0.03 * s, -0.02, 0.03, 0.004, -0.006 * s, 0.003);
        state.camera_from_world = Se3::exp(&twist) * state.camera_from_world;
    }
    for (i, point) in map.keyframes.iter_mut().flat_map(|k| &mut k.points).enumerate() {
        point.inverse_depth *= 1.0 + 0.1 * ((i as f64 * 0.618).fract() - 0.5);
    }
}

#[test]
fn new_points_have_the_depth_of_the_scene() {
    let views = views();
    let mut map = exact_map(&views, 40);
    let before: Vec<usize> = map.keyframes.iter().map(|k| k.points.len()).collect();
    let (params, search, track) = Default::default();
    let count = add_points(&mut map, 0, &[1, 2], &params, &search, &track);
    assert_eq!(map.keyframes[0].points.len(), before[0] + count);
    assert!(count > 60, "{count} new points");
    let new = &map.keyframes[0].points[before[0]..];
    let error =
        |p: &crate::local_map::PointState| (p.inverse_depth / views[0].depth_at(p.pixel) as f64 - 1.0).abs();
    let errors: Vec<f64> = new.iter().filter(|p| views[0].smooth_around(p.pixel)).map(error).collect();
    let gross = errors.iter().filter(|&&e| e > 0.1).count() as f64 / errors.len() as f64;
    let median = quantile(errors, 0.5);
    assert!(median < 0.015 && gross < 0.03, "median {median}, gross {gross}");
    for (index, point) in new.iter().enumerate() {
        let at = PointRef { host: 0, index: before[0] + index };
        assert!(!point.observations.is_empty());
        for seen in &point.observations {
            assert!(map.keyframes[seen.keyframe].seen.contains(&at), "who is seen knows who sees");
        }
    }
    let again = add_points(&mut map, 0, &[1, 2], &params, &search, &track);
    assert!(again * 5 < count, "blocks that have a point get no other: {again} after {count}");
}

#[test]
fn the_expected_depths_hold_those_nearby() {
    let at = |x: usize, inverse_depth: f32| ReferencePoint {
        pixel: [x as f32, 50.0],
        inverse_depth,
        variance: 1e-4,
    };
    // A gap with a view far behind the rest, and a few things close by.
    let mut points: Vec<ReferencePoint> = (0..200).map(|x| at(x, 1.0)).collect();
    points.extend((0..6).map(|x| at(400 + x, 0.02)));
    points.extend((0..6).map(|x| at(600 + x, 4.0)));
    let prior = DepthPrior::new(&points);
    for (x, expected) in [(100.0, 1.0), (402.0, 0.02)] {
        let (least, most) = prior.range_near([x, 50.0]);
        assert!(least <= expected && expected < most, "{expected} is not in {least}–{most}");
    }
    let (least, most) = prior.range_near([602.0, 50.0]);
    assert!(least < most, "{least}–{most}");
    assert_eq!(prior.range_near([0.0, 400.0]), prior.overall, "nothing near: anything known");
    let (least, most) = DepthPrior::new(&[]).range_near([0.0, 0.0]);
    assert!(0.0 < least && least < most);
}

#[test]
fn a_disturbed_map_is_put_right() {
    let views = views();
    let truth = exact_map(&views, 16);
    let mut map = truth.clone();
    disturb(&mut map, 2);
    optimise_all(&mut map, 30, &MappingParams::default(), &|| false);
    // Keyframe 0 is held, the scale is not.
    let from_first = |m: &LocalMap, k: usize| {
        m.keyframes[k].camera_from_world * m.keyframes[0].camera_from_world.inverse()
    };
    let scale = from_first(&truth, 1).translation.norm() / from_first(&map, 1).translation.norm();
    for k in 1..3 {
        let (found, exact) = (from_first(&map, k), from_first(&truth, k));
        assert!((found.translation * scale - exact.translation).norm() < 1e-3, "{k}");
        assert!(found.rotation.angle_to(&exact.rotation) < 1e-4, "{k}");
    }
    for (found, exact) in map.keyframes.iter().zip(&truth.keyframes) {
        for (a, b) in found.points.iter().zip(&exact.points).filter(|(_, b)| !b.observations.is_empty()) {
            assert!((a.inverse_depth / scale / b.inverse_depth - 1.0).abs() < 0.02, "{a:?}");
            assert!(a.alive && a.observations.len() == b.observations.len());
        }
    }
}

#[test]
fn a_large_map_is_put_right_in_parts() {
    let views: Vec<View> = (0..9).map(|i| View::new(pose(0.15 * i as f64, 0.0, 0.0, 0.0, 0.0))).collect();
    let truth = exact_map(&views, 16);
    let mut map = truth.clone();
    disturb(&mut map, 8);
    let count: usize = observations(&map).iter().sum();
    let params = MappingParams { whole: 0.999e-6 * count as f64, ..MappingParams::default() };
    let steps = |map: &LocalMap| -> Vec<f64> {
        let relative =
            |k: usize| map.keyframes[k].camera_from_world * map.keyframes[k - 1].camera_from_world.inverse();
        let ideal = |k: usize| {
            truth.keyframes[k].camera_from_world * truth.keyframes[k - 1].camera_from_world.inverse()
        };
        (1..9).map(|k| relative(k).rotation.angle_to(&ideal(k).rotation)).collect()
    };
    let worst = |map: &LocalMap| steps(map).into_iter().fold(0.0, f64::max);
    let before = worst(&map);
    let stopped = optimise_all(&mut map.clone(), 30, &params, &|| true);
    assert!(stopped.is_empty(), "it is left when that is asked for");
    let changes = optimise_all(&mut map, 30, &params, &|| false);
    assert!(changes.iter().map(|change| change.keyframe).eq(0..9), "each keyframe once: {changes:?}");
    let after = worst(&map);
    assert!(before > 0.005 && after < 0.3 * before, "{before} before, {after} after");
}

#[test]
fn parts_are_of_successive_keyframes_and_about_as_large() {
    let observations = [30, 40, 50, 10, 90, 0, 20];
    assert_eq!(parts(&observations, 0, 100), [0..3, 3..5, 5..7]);
    assert_eq!(parts(&observations, 50, 100), [0..2, 2..5, 5..7]);
    assert!(parts(&observations, 0, 1000).into_iter().eq(std::iter::once(0..7)));
    assert_eq!(parts(&[5, 5], 0, 5), [0..1, 1..2]);
}

#[test]
fn unit_changes_tell_the_factor_of_each_keyframe() {
    let views = views();
    let truth = exact_map(&views, 20);
    let active = BTreeSet::from([0, 1, 2]);
    let mut window = Window::build(&truth, &active, 25);
    let before = window.frame_depths();
    for frame in &mut window.problem.frames {
        frame.translation *= 1.25;
    }
    for point in &mut window.problem.points {
        point.inverse_depth /= 1.25;
    }
    let changes = window.scale_changes(&before);
    assert_eq!(changes.iter().map(|c| c.keyframe).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(changes.iter().all(|c| (c.factor - 1.25).abs() < 1e-5), "{changes:?}");
}

#[test]
fn an_optimisation_that_undoes_a_wrong_unit_reports_it() {
    let mut all = views();
    all.push(View::new(pose(0.1, 0.1, 0.2, 0.0, 0.0)));
    let mut truth = exact_map(&all, 16);
    // Keyframe 3 sees only what it hosts.
    for point in truth.keyframes[..3].iter_mut().flat_map(|k| &mut k.points) {
        point.observations.retain(|o| o.keyframe != 3);
    }
    truth.keyframes[3].seen.clear();
    let mut map = truth.clone();
    // With that, it is 20 % too large as seen from keyframe 0's camera, and the rest is fixed.
    let world_from_first = map.keyframes[0].camera_from_world.inverse();
    let mut from_first = map.keyframes[3].camera_from_world * world_from_first;
    from_first.translation *= 1.2;
    map.keyframes[3].camera_from_world = from_first * world_from_first.inverse();
    for point in &mut map.keyframes[3].points {
        point.inverse_depth /= 1.2;
    }
    let changes = optimise(&mut map, &BTreeSet::from([3]), 25, [0.0; UNKNOWNS], |_| Limits::steps(30));
    assert_eq!(changes.len(), 1);
    assert_eq!(changes[0].keyframe, 3);
    let (found, exact) = (map.keyframes[3].camera_from_world, truth.keyframes[3].camera_from_world);
    assert!((found * exact.inverse()).log().norm() < 1e-3);
    for k in 0..3 {
        assert_eq!(map.keyframes[k].camera_from_world, truth.keyframes[k].camera_from_world, "{k} is fixed");
    }
    assert!((1.2 * changes[0].factor - 1.0).abs() < 1e-3, "{changes:?}");
}

#[test]
fn observations_that_disagree_go_and_points_without_any_die() {
    let views = views();
    let mut map = exact_map(&views, 20);
    let watched = |map: &LocalMap| {
        let points = map.keyframes[0].points.iter().enumerate();
        points.filter(|(_, p)| p.observations.len() == 2).map(|(i, _)| i).collect::<Vec<_>>()
    };
    let [one, both] = watched(&map)[..2] else { panic!("two points are seen by both") };
    map.keyframes[0].points[one].observations[1].pixel[1] += 60.0;
    for seen in &mut map.keyframes[0].points[both].observations {
        // Off the epipolar lines, to different sides.
        seen.pixel[1] += if seen.keyframe == 1 { 60.0 } else { -60.0 };
    }
    optimise_all(&mut map, 20, &MappingParams::default(), &|| false);
    let (one, both) = (PointRef { host: 0, index: one }, PointRef { host: 0, index: both });
    assert!(map.point(one).alive);
    assert_eq!(map.point(one).observations.iter().map(|o| o.keyframe).collect::<Vec<_>>(), [1]);
    assert!(!map.point(both).alive);
    assert!(map.keyframes[1].seen.contains(&one) && !map.keyframes[2].seen.contains(&one));
    assert!(!map.keyframes[1].seen.contains(&both) && !map.keyframes[2].seen.contains(&both));
}

#[test]
fn points_searched_in_vain_are_dropped() {
    let views = views();
    let mut map = exact_map(&views, 40);
    for (point, (searched, found)) in map.keyframes[0].points.iter_mut().zip([(8, 1), (8, 2), (7, 0), (0, 0)])
    {
        (point.searched, point.found) = (searched, found);
    }
    cull_unfound(&mut map, [0], 0.25);
    let alive: Vec<bool> = map.keyframes[0].points.iter().take(4).map(|p| p.alive).collect();
    assert_eq!(alive, [false, true, true, true]);
}

#[test]
fn observations_are_added_once_and_only_where_they_agree() {
    let views = views();
    let mut map = exact_map(&views, 40);
    map.keyframes[1].points.push(point_state(views[1].points(40)[0]));
    let index = map.keyframes[1].points.len() - 1;
    let matched = |host, squared| Matched {
        at: PointRef { host, index },
        pixel: [50.0, 60.0],
        information: [1.0, 0.0, 1.0],
        rmse: 2.0,
        squared,
        inlier: true,
    };
    add_observations(&mut map, 0, &[matched(1, 1.1 * OBSERVED)]);
    assert!(map.keyframes[1].points[index].observations.is_empty());
    add_observations(&mut map, 0, &[matched(1, 0.5), matched(1, 0.5)]);
    assert_eq!(map.keyframes[1].points[index].observations.len(), 1);
    add_observations(&mut map, 1, &[matched(1, 0.5)]);
    assert_eq!(map.keyframes[1].points[index].observations.len(), 1, "a host does not observe its own");
}

#[test]
fn flow_is_split_into_rotation_and_parallax() {
    let views = views();
    let map = exact_map(&views, 20);
    let rotation = Se3::exp(&nalgebra::Vector6::new(0.0, 0.0, 0.0, 0.0, 0.1, 0.0));
    let (all, parallax) = median_flow(&map.camera, &map.reference_points(0), &rotation).unwrap();
    assert!((18.0..26.0).contains(&all) && parallax < 1e-3, "{all} {parallax}");
    let aside = Se3::exp(&nalgebra::Vector6::new(0.2, 0.0, 0.0, 0.0, 0.0, 0.0));
    let (all, parallax) = median_flow(&map.camera, &map.reference_points(0), &aside).unwrap();
    assert!((all - parallax).abs() < 1e-3);
    let mut depths: Vec<f32> = map.reference_points(0).iter().map(|p| p.inverse_depth).collect();
    let expected = 0.2 * 210.0 * median(&mut depths).unwrap();
    assert!((parallax / expected - 1.0).abs() < 0.01, "{parallax} {expected}");
    let empty = crate::test_scene::bare_map(&views);
    assert_eq!(median_flow(&empty.camera, &empty.reference_points(0), &rotation), None);
}
