//! Alignment of rendered keyframes with exact depth.

use super::residual::{Projector, State};
use super::*;
use geometry::{GrayImage, Pinhole, Pyramid, Se3};
use map::SemiDense;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

fn camera() -> Pinhole {
    Pinhole { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 159.5, cy: 119.5 }
}

/// Depth along the ray and texture of a slanted wall with a box before it, whose middle is at `x`.
fn scene(origin: &Vector3<f64>, ray: &Vector3<f64>, x: f64) -> (f64, f64) {
    let wall = (4.0 + 0.3 * origin.x - origin.z) / (ray.z - 0.3 * ray.x);
    let face = (2.8 - origin.z) / ray.z;
    let on_face = origin + ray * face;
    let hit = (on_face.x - x).abs() < 0.5 && (on_face.y - 0.2).abs() < 0.4 && face < wall;
    let t = if hit { face } else { wall };
    let p = origin + ray * t;
    let texture = (3.1 * p.x + 1.3 * p.y).sin()
        + (5.3 * p.y - 2.2 * p.x).sin()
        + 0.6 * (17.0 * p.x).sin() * (13.0 * p.y + 1.0).sin()
        + if hit { 0.8 } else { 0.0 };
    (t, 125.0 + 35.0 * texture)
}

/// A keyframe rendered from `world_from_camera` whose unit is `unit` world units; brightness
/// `gain·I + offset`.
fn render(world_from_camera: &Se3, unit: f64, gain: f64, offset: f64) -> (Pyramid, SemiDense) {
    render_box(world_from_camera, unit, [gain, offset], 0.0)
}

/// The same with the box elsewhere.
fn render_box(world_from_camera: &Se3, unit: f64, [gain, offset]: [f64; 2], at: f64) -> (Pyramid, SemiDense) {
    let camera = camera();
    let mut image = GrayImage::filled(camera.width, camera.height, 0);
    let mut depth = vec![0.0; camera.width * camera.height];
    for y in 0..camera.height {
        for x in 0..camera.width {
            let ray = world_from_camera.rotation * camera.unproject(x as f64, y as f64);
            let (t, value) = scene(&world_from_camera.translation, &ray, at);
            image.set(x, y, (gain * value + offset).round().clamp(0.0, 255.0) as u8);
            depth[y * camera.width + x] = t;
        }
    }
    let mut semi_dense = SemiDense::default();
    for y in 1..camera.height - 1 {
        for x in 1..camera.width - 1 {
            let gx = image.get(x + 1, y) as f32 - image.get(x - 1, y) as f32;
            let gy = image.get(x, y + 1) as f32 - image.get(x, y - 1) as f32;
            if gx.hypot(gy) > 10.0 {
                let pixel = y * camera.width + x;
                let inverse_depth = (unit / depth[pixel]) as f32;
                semi_dense.pixel.push(pixel as u32);
                semi_dense.inverse_depth.push(inverse_depth);
                semi_dense.variance.push((0.01 * inverse_depth).powi(2));
            }
        }
    }
    (Pyramid::new(image, 5), semi_dense)
}

fn pose(x: f64, y: f64, z: f64, yaw: f64, roll: f64) -> Se3 {
    Se3::new(UnitQuaternion::from_euler_angles(0.0, yaw, roll), Vector3::new(x, y, z))
}

fn params() -> Sim3AlignParams {
    Sim3AlignParams { finest_level: 0, min_relative_decrease: 1e-6, ..Default::default() }
}

/// Rotation (rad), translation relative to the scene's distance, scale ratio − 1.
fn errors(estimate: &Sim3, truth: &Sim3) -> (f64, f64, f64) {
    let difference = estimate.inverse() * *truth;
    (difference.rotation.angle(), difference.translation.norm() / 4.0, (difference.scale - 1.0).abs())
}

#[test]
fn a_disturbed_guess_with_another_unit_and_brightness_is_corrected() {
    let (from, to) = (pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.25, -0.05, 0.1, -0.05, 0.03));
    let (source_pyramid, source_depth) = render(&from, 1.0, 1.0, 0.0);
    // The target's keyframe unit is 1.3 world units.
    let (target_pyramid, target_depth) = render(&to, 1.3, 0.8, 20.0);
    let source = KeyframeView::new(&source_pyramid, &source_depth, &camera());
    let target = KeyframeView::new(&target_pyramid, &target_depth, &camera());
    let truth = Sim3::new(to.rotation, to.translation, 1.3).inverse() * Sim3::from(from);
    let disturbance = Sim3::exp(&SVector::from([0.08, -0.05, 0.08, 0.03, -0.03, 0.05, 0.12]));
    let result = align(&source, &target, disturbance * truth, &params()).unwrap();
    let (rotation, translation, scale) = errors(&result.target_from_source, &truth);
    assert!(rotation < 3e-3 && translation < 3e-3 && scale < 3e-3, "{rotation} {translation} {scale}");
    assert!((result.brightness[0].exp() - 0.8).abs() < 0.02, "{:?}", result.brightness);
    assert!(result.inlier_share > 0.9 && result.rmse < 6.0, "{result:?}");

    let back = align(&target, &source, truth.inverse(), &params()).unwrap();
    let verdict = reciprocal(&back, &result, &params()).unwrap();
    assert!(verdict.consistent, "{verdict:?}");
    let (rotation, translation, scale) = errors(&verdict.a_from_b, &truth.inverse());
    assert!(rotation < 3e-3 && translation < 3e-3 && scale < 3e-3, "{rotation} {translation} {scale}");

    // An alignment that claims to be elsewhere does not undo the other.
    let mut wrong = back.clone();
    wrong.target_from_source =
        Sim3::exp(&SVector::from([0.2, 0.0, 0.0, 0.0, 0.1, 0.0, 0.1])) * back.target_from_source;
    assert!(!reciprocal(&wrong, &result, &params()).unwrap().consistent);
}

#[test]
fn the_fused_similarity_lies_between_the_two() {
    let (pyramid, depth) = render(&pose(0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0, 0.0);
    let view = KeyframeView::new(&pyramid, &depth, &camera());
    let aligned = align(&view, &view, Sim3::identity(), &params()).unwrap();
    let moved = |size: f64| {
        let tangent = SVector::from([1.0, 0.5, -0.2, 0.3, 0.1, 0.4, 0.2]) * size;
        Sim3Alignment { target_from_source: Sim3::exp(&tangent), ..aligned.clone() }
    };
    // One says 2e-3, the other nothing: with equal information the mean is half way.
    let verdict = reciprocal(&moved(2e-3), &moved(0.0), &params()).unwrap();
    let expected = moved(1e-3).target_from_source.log();
    assert!((verdict.a_from_b.log() - expected).norm() < 1e-5, "{}", verdict.a_from_b.log());
}

#[test]
fn what_cannot_be_aligned_is_refused_with_its_reason() {
    let (pyramid, depth) = render(&pose(0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0, 0.0);
    let view = KeyframeView::new(&pyramid, &depth, &camera());
    let refuse = |source: &KeyframeView, target: &KeyframeView, guess| {
        align(source, target, guess, &params()).unwrap_err()
    };
    let mut nan = Sim3::identity();
    nan.translation.x = f64::NAN;
    assert_eq!(refuse(&view, &view, nan), AlignRefusal::InvalidGuess);
    let empty = SemiDense::default();
    let blind = KeyframeView::new(&pyramid, &empty, &camera());
    assert!(matches!(refuse(&blind, &view, Sim3::identity()), AlignRefusal::TooFewPoints { points: 0, .. }));
    assert!(matches!(refuse(&view, &blind, Sim3::identity()), AlignRefusal::TooLittleDepth { .. }));
    let turned = Sim3::from(pose(0.0, 0.0, 0.0, 3.0, 0.0));
    assert!(matches!(refuse(&view, &view, turned), AlignRefusal::OutOfView { .. }));
}

#[test]
fn poisoned_depths_are_left_out() {
    let (pyramid, mut depth) = render(&pose(0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0, 0.0);
    depth.inverse_depth[0] = f32::NAN;
    depth.inverse_depth[1] = -1.0;
    depth.variance[2] = 0.0;
    *depth.pixel.last_mut().unwrap() = u32::MAX;
    let view = KeyframeView::new(&pyramid, &depth, &camera());
    assert_eq!(view.depth(0).points.len(), depth.len() - 4);
    assert!(
        view.depth(view.levels() - 1)
            .points
            .iter()
            .all(|p| p.inverse_depth.is_finite() && p.inverse_depth > 0.0)
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn jacobians_match_numeric_ones(
        tangent in prop::array::uniform7(-0.05f64..0.05),
        brightness in prop::array::uniform2(-0.2f64..0.2),
        skip in 0usize..500,
    ) {
        let (pyramid, depth) = render(&pose(0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0, 0.0);
        let view = KeyframeView::new(&pyramid, &depth, &camera());
        let state = State { target_from_source: Sim3::exp(&SVector::from(tangent)), brightness };
        let params = params();
        let evaluate = |state: &State, point| {
            Projector::new(state, [camera(); 2], pyramid.base(), view.depth(0), &params).evaluate(point, 90)
        };
        for point in view.depth(0).points.iter().skip(skip).step_by(997) {
            let Some(term) = evaluate(&state, point) else { continue };
            let mut photometric = Vector9::zeros();
            for (&column, value) in [0, 1, 2, 3, 4, 5, 7, 8].iter().zip(term.photometric_by) {
                photometric[column] = value;
            }
            let mut depth = Vector9::zeros();
            if let Some(term) = term.depth {
                for (&column, value) in [2, 3, 4, 6].iter().zip(term.by) {
                    depth[column] = value;
                }
            }
            for column in 0..9 {
                let h = 1e-7;
                let mut step = Vector9::zeros();
                step[column] = h;
                let plus = evaluate(&state.updated(&step), point);
                let minus = evaluate(&state.updated(&-step), point);
                let (Some(plus), Some(minus)) = (plus, minus) else { continue };
                let here = term.photometric;
                let (ahead, behind) = ((plus.photometric - here) / h, (here - minus.photometric) / h);
                let tolerance = 1e-4 * (1.0 + photometric.amax());
                // Interpolated intensities have a kink at each pixel: there is no slope to compare with.
                if (ahead - behind).abs() > tolerance {
                    continue;
                }
                let slope = (plus.photometric - minus.photometric) / (2.0 * h);
                prop_assert!((slope - photometric[column]).abs() < tolerance, "{column}: {slope} {photometric}");
                if let (Some(plus), Some(minus)) = (plus.depth, minus.depth) {
                    let slope = (plus.residual - minus.residual) / (2.0 * h);
                    prop_assert!((slope - depth[column]).abs() < 1e-5, "{column}: {slope} {depth}");
                }
            }
        }
    }
}

/// The scene's keyframe from a pose, as alignment takes it.
fn view_from(world_from_camera: &Se3) -> KeyframeView {
    let (pyramid, depth) = render(world_from_camera, 1.0, 1.0, 0.0);
    KeyframeView::new(&pyramid, &depth, &camera())
}

#[test]
fn keyframes_of_one_place_hardly_contradict_each_other() {
    let (from, to) = (pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.25, -0.05, 0.1, -0.05, 0.03));
    let target_from_source = Sim3::from(to.inverse() * from);
    let found = compare(&view_from(&from), &view_from(&to), &target_from_source, &CompareParams::default());
    assert!(found.seen as f64 > 0.7 * found.points as f64, "{found:?}");
    assert!(found.agree as f64 > 0.9 * found.seen as f64, "{found:?}");
    // The box hides a part of the wall from one of both; nothing is looked through.
    assert!(found.through_share() < 0.02 && found.missing_share() < 0.02, "{found:?}");
}

/// A wall that should stand nearer: the target looks through it. The other way round it hides what is behind it, which
/// is no contradiction.
#[test]
fn what_is_looked_through_is_distinguished_from_what_is_hidden() {
    let here = view_from(&pose(0.0, 0.0, 0.0, 0.0, 0.0));
    let ahead =
        |metres: f64| Sim3::from(Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, metres)));
    let params = CompareParams::default();
    let nearer = compare(&here, &here, &ahead(-1.2), &params);
    assert!(nearer.through_share() > 0.5, "{nearer:?}");
    let farther = compare(&here, &here, &ahead(1.5), &params);
    assert!(farther.hidden > farther.agree && farther.through_share() < 0.1, "{farther:?}");
}

/// A box that one keyframe sees and the other does not is absent there, both of one place lack nothing.
#[test]
fn a_thing_that_is_not_there_is_looked_through_as_a_whole() {
    let (compare, params) = (CompareParams::default(), PatchParams::default());
    let (from, to) = (pose(0.0, 0.0, 0.0, 0.0, 0.0), pose(0.25, -0.05, 0.1, -0.05, 0.03));
    let motion = Sim3::from(to.inverse() * from);
    let same = compare_patches(&view_from(&from), &view_from(&to), &motion, &compare, &params);
    assert!(same.points > 1000 && same.absent == 0 && same.unlike == 0, "{same:?}");
    let (similar, depth) = render(&to, 1.0, 1.0, 0.0);
    let (_, of_wall) = render_box(&to, 1.0, [1.0, 0.0], 100.0);
    let blank = Pyramid::new(GrayImage::filled(camera().width, camera().height, 128), 5);
    let without = KeyframeView::new(&blank, &of_wall, &camera());
    let other = compare_patches(&view_from(&from), &without, &motion, &compare, &params);
    assert!(other.absent >= 3 * params.min_points && other.absent_share() > 0.01, "{other:?}");
    assert_eq!(other.absent_views, 1);
    // Where it looks the same a depth is wrong.
    let mistaken = KeyframeView::new(&similar, &of_wall, &camera());
    let found = compare_patches(&view_from(&from), &mistaken, &motion, &compare, &params);
    assert!(found.absent < other.absent / 3, "{found:?}");
    // What the box would hide is no contradiction.
    let wall = KeyframeView::new(&similar, &of_wall, &camera());
    let box_before = KeyframeView::new(&blank, &depth, &camera());
    let back = compare_patches(&wall, &box_before, &Sim3::identity(), &compare, &params);
    assert_eq!(back.absent, 0, "{back:?}");
}

/// Where the target shows nothing, what the source sees is missing.
#[test]
fn a_blank_image_lacks_everything() {
    let source = view_from(&pose(0.0, 0.0, 0.0, 0.0, 0.0));
    let blank = Pyramid::new(GrayImage::filled(camera().width, camera().height, 128), 5);
    let target = KeyframeView::new(&blank, &SemiDense::default(), &camera());
    let found = compare(&source, &target, &Sim3::identity(), &CompareParams::default());
    assert!(found.seen > 100 && found.missing_share() > 0.95, "{found:?}");
    assert_eq!((found.agree, found.through, found.hidden), (0, 0, 0));
    // And nothing is seen behind the camera.
    let behind = Sim3::from(Se3::new(
        UnitQuaternion::from_euler_angles(0.0, std::f64::consts::PI, 0.0),
        Vector3::zeros(),
    ));
    assert_eq!(compare(&source, &source, &behind, &CompareParams::default()).seen, 0);
}
