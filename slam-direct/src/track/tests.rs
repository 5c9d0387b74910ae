//! Finding rendered frames by the points of a map with exact depths.

use super::*;
use crate::align::AlignParams;
use crate::test_scene::{CAMERA, View as Rendered, exact_map, pose, quantile};
use geometry::GrayImage;

fn views() -> Vec<Rendered> {
    [(0.0, 0.0), (0.4, 0.05)].iter().map(|&(x, z)| Rendered::new(pose(x, 0.0, z, 0.0, 0.0))).collect()
}

/// Distance, metres, and angle, radians, between a pose and a view's.
fn error(camera_from_world: &Se3, truth: &Rendered) -> (f64, f64) {
    let off = *camera_from_world * truth.world_from_camera;
    (off.translation.norm(), off.rotation.angle())
}

/// A frame of a camera that does not move.
fn still(pyramid: &Pyramid, camera_from_world: Se3) -> View<'_> {
    View { pyramid, camera_from_world, motion: Twist::zeros() }
}

fn nearby() -> Se3 {
    Se3::exp(&Vector6::new(0.02, -0.015, 0.03, 0.004, -0.005, 0.003))
}

#[test]
fn a_perturbed_pose_is_refined() {
    let map = exact_map(&views(), 10);
    let frame = Rendered::new(pose(0.2, 0.05, 0.15, 0.04, -0.01));
    let start = nearby() * frame.world_from_camera.inverse();
    let params = TrackParams::default();
    let view = still(&frame.pyramid, start);
    let (mut matched, searched) = match_points(&map, &[0, 1], &view, &params, params.per_cell);
    assert!(
        searched.len() > 100 && matched.len() * 10 > searched.len() * 7,
        "{} of {}",
        matched.len(),
        searched.len()
    );
    let (found, residual_scale) = refine_pose(&map, &view, &mut matched);
    let depths = frame.inverse_depth.data().iter().filter(|&&d| d > 0.0).map(|&d| 1.0 / d as f64);
    let depth = quantile(depths.collect(), 0.5);
    let (metres, radians) = error(&found, &frame);
    assert!(metres < 1e-3 * depth && radians < 5e-4, "off by {metres} m at {depth} m, {radians} rad");
    assert!(residual_scale.is_finite() && residual_scale > 0.0);
    let inliers = matched.iter().filter(|m| m.inlier).count();
    assert!(inliers * 10 > matched.len() * 8, "{inliers} of {}", matched.len());
}

#[test]
fn wrong_matches_are_distinguished_from_right_ones() {
    let map = exact_map(&views(), 10);
    let frame = Rendered::new(pose(0.2, 0.0, 0.1, 0.02, 0.0));
    let start = nearby() * frame.world_from_camera.inverse();
    let params = TrackParams::default();
    let view = still(&frame.pyramid, start);
    let (mut matched, _) = match_points(&map, &[0, 1], &view, &params, params.per_cell);
    for (i, m) in matched.iter_mut().enumerate().filter(|(i, _)| i % 5 == 0) {
        let (x, y) = [(25.0, 9.0), (-14.0, 22.0), (-21.0, -12.0), (11.0, -24.0)][i / 5 % 4];
        m.pixel = [m.pixel[0] + x, m.pixel[1] + y];
    }
    let (found, _) = refine_pose(&map, &view, &mut matched);
    let (metres, radians) = error(&found, &frame);
    assert!(metres < 0.02 && radians < 0.002, "off by {metres} m, {radians} rad");
    let accepted =
        matched.iter().step_by(5).filter(|m| m.inlier && m.information[0] + m.information[2] > 0.5).count();
    assert!(accepted * 20 <= matched.len() / 5, "{accepted} wrong matches are taken for right");
}

#[test]
fn no_matches_leave_the_pose() {
    let map = exact_map(&views(), 40);
    let start = pose(1.0, 0.0, 0.0, 0.0, 0.0);
    let black = Pyramid::new(GrayImage::filled(CAMERA.width, CAMERA.height, 0), 5);
    let view = still(&black, map.keyframes[0].camera_from_world);
    let elsewhere = still(&black, start);
    assert_eq!(refine_pose(&map, &elsewhere, &mut []), (start, 1.0));
    let (matched, searched) = match_points(&map, &[0, 1], &view, &TrackParams::default(), 2);
    assert!(matched.is_empty() && !searched.is_empty());
}

#[test]
fn searched_points_are_spread_and_those_out_of_view_are_not_searched() {
    let map = exact_map(&views(), 10);
    let params = TrackParams::default();
    let pyramid = &map.keyframes[0].pyramid;
    let look = |camera_from_world| choose(&map, &[0, 1], &still(pyramid, camera_from_world), &params, 1);
    let searched = look(map.keyframes[0].camera_from_world);
    let cell = |s: &SearchedPoint| (s.pixel[0] as usize / params.cell, s.pixel[1] as usize / params.cell);
    let cells: std::collections::BTreeSet<_> = searched.iter().map(cell).collect();
    assert_eq!(cells.len(), searched.len(), "one for each cell");
    for [x, y] in map.keyframes[0].points.iter().map(|p| p.pixel) {
        let cell = (x as usize / params.cell, y as usize / params.cell);
        assert!(cells.contains(&cell), "{cell:?} holds a point that is not sought");
    }
    let about = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 3.1, 0.0));
    assert!(look(about * map.keyframes[0].camera_from_world).is_empty());
}

#[test]
fn hosts_are_those_whose_points_are_in_sight() {
    let mut all = views();
    all.push(Rendered::new(pose(0.0, 0.0, -8.0, 3.1, 0.0)));
    let map = exact_map(&all, 12);
    let near = [0, 1, 2].map(|keyframe| Near::of(&map, keyframe));
    let seen_from =
        |k: usize, reference| choose_hosts(&map, &near, &map.keyframes[k].camera_from_world, reference, 5);
    let mut hosts = seen_from(0, 0);
    assert_eq!(hosts[0], 0, "the reference leads");
    hosts.sort_unstable();
    assert_eq!(hosts, [0, 1]);
    assert_eq!(seen_from(2, 2), [2]);
    assert_eq!(seen_from(2, 0)[0], 0, "the reference is there even out of sight");
    assert_eq!(choose_hosts(&map, &near, &map.keyframes[0].camera_from_world, 1, 1), [1]);
}

#[test]
fn a_rotation_that_the_motion_model_does_not_predict_is_found() {
    let all = views();
    let map = exact_map(&all, 10);
    let points = map.reference_points(0);
    let reference = AlignmentReference::new(&all[0].pyramid, &CAMERA, &points, &AlignParams::default());
    let frame = Rendered::new(pose(0.0, 0.0, 0.0, 0.14, 0.0));
    let guesses = [Se3::identity()];
    let found = align_from_guesses(&reference, &frame.pyramid, &guesses, Brightness::default(), 0.8);
    let off = found.frame_from_reference * all[0].to(&frame).inverse();
    assert!(off.rotation.angle() < 0.003 && off.translation.norm() < 0.03, "{found:?}");
}

#[test]
fn information_is_bounded_by_intensity_noise_and_by_position() {
    let params = TrackParams { patch_sigma: 2.0, position_sigma: 0.5, ..TrackParams::default() };
    // Much contrast: only the positional floor is left. Little: only the noise counts.
    let strong = position_information(&[1e6, 0.0, 1e6], 0.0, 0, &params);
    assert!((strong[0] - 4.0).abs() < 1e-3 && strong[1] == 0.0, "{strong:?}");
    let coarser = position_information(&[1e6, 0.0, 1e6], 0.0, 1, &params);
    assert!((coarser[0] - 1.0).abs() < 1e-3, "a level up, pixels are twice as large: {coarser:?}");
    let weak = position_information(&[0.04, 0.01, 0.02], 0.0, 0, &params);
    assert!((weak[0] - 0.01).abs() < 1e-4 && (weak[1] - 0.0025).abs() < 1e-4, "{weak:?}");
    let poor = position_information(&[0.04, 0.01, 0.02], 4.0, 0, &params);
    assert!((poor[0] / weak[0] - 0.25).abs() < 1e-2, "a worse match is worth less: {poor:?}");
    // (Λ⁻¹) = σ_I² H⁻¹ + σ_0²: an edge is known across and unknown along.
    let edge = position_information(&[100.0, 0.0, 0.0], 0.0, 0, &params);
    assert!((1.0 / edge[0] - (4.0 / 100.0 + 0.25)).abs() < 1e-4 && edge[2] == 0.0, "{edge:?}");
}

#[test]
fn uncertain_depth_takes_information_along_the_line_only() {
    let information = [2.0, 0.5, 1.0];
    let (j, variance) = ([3.0, -1.0], 0.7);
    let left = with_depth_variance(&information, &j, variance);
    let matrix = |i: &[f64; 3]| nalgebra::Matrix2::new(i[0], i[1], i[1], i[2]);
    let j = nalgebra::Vector2::from(j);
    let expected =
        (matrix(&information).try_inverse().unwrap() + j * j.transpose() * variance).try_inverse().unwrap();
    assert!((matrix(&left) - expected).norm() < 1e-12);
    assert_eq!(with_depth_variance(&information, &[3.0, -1.0], 0.0), information);
}

#[test]
fn the_positional_uncertainty_is_learnt_slowly_and_within_bounds() {
    let at = |position_sigma| TrackParams { position_sigma, ..TrackParams::default() };
    assert!(learn_position_sigma(&at(0.3), 4.0) > 0.3 && learn_position_sigma(&at(0.3), 0.25) < 0.3);
    assert_eq!(learn_position_sigma(&at(0.3), 1.0), 0.3);
    let learnt =
        |residual_scale| (0..500).fold(0.3, |sigma, _| learn_position_sigma(&at(sigma), residual_scale));
    assert_eq!(learnt(1e9), 1.0);
    assert_eq!(learnt(0.0), TrackParams::default().least_position_sigma);
}

#[test]
fn the_rows_of_a_rolling_shutter_tell_how_the_camera_turns() {
    let mut map = exact_map(&views(), 10);
    map.sensor.readout = [0.0, 0.02];
    let frame = Rendered::new(pose(0.2, 0.0, 0.1, 0.02, 0.0));
    let twist = Twist::new(0.0, 0.0, 0.0, 0.8, -1.5, 0.4);
    let camera_from_world = frame.world_from_camera.inverse();
    let relative = camera_from_world * map.keyframes[0].camera_from_world.inverse();
    let matched: Vec<Matched> = map.keyframes[0]
        .points
        .iter()
        .enumerate()
        .map(|(index, point)| {
            let x = relative.rotation * point.ray + relative.translation * point.inverse_depth;
            let ideal = map.camera.project(&x).into();
            let pixel =
                map.sensor.distorted_pixel(ideal, &twist, point.inverse_depth / x.z).map(|v| v as f32);
            let at = PointRef { host: 0, index };
            Matched { at, pixel, information: [4.0, 0.0, 4.0], rmse: 1.0, squared: 0.0, inlier: true }
        })
        .collect();
    let view = View { pyramid: &frame.pyramid, camera_from_world, motion: twist * 0.5 };
    let found = motion_by_rows(&map, &view, &matched, 1.0);
    assert!((found - twist).norm() < 0.05 * twist.norm(), "{found}");
    let by_prior = motion_by_rows(&map, &view, &matched, 1e-4);
    assert!((by_prior - view.motion).norm() < 0.01, "{by_prior}");
}
