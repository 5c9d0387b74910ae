//! Alignment of rendered frames of which pose and brightness are known.

use super::*;
use crate::test_scene::{CAMERA, View, brightened, pose};
use geometry::{GrayImage, Pyramid};

fn keyframe() -> View {
    View::new(pose(0.0, 0.0, 0.0, 0.0, 0.0))
}

fn reference(view: &View) -> AlignmentReference {
    AlignmentReference::new(&view.pyramid, &CAMERA, &view.points(10), &AlignParams::default())
}

/// Distance, metres, and angle, radians, between two motions.
fn error(found: &Se3, truth: &Se3) -> (f64, f64) {
    let off = *found * truth.inverse();
    (off.translation.norm(), off.rotation.angle())
}

#[test]
fn converges_from_some_pixels_and_degrees_off() {
    let first = keyframe();
    let reference = reference(&first);
    assert!(reference.len() > 300 && !reference.is_empty());
    for at in [
        pose(0.15, 0.0, 0.0, 0.0, 0.0),
        pose(0.0, -0.1, 0.25, 0.0, 0.03),
        pose(-0.1, 0.05, -0.2, 0.05, -0.02),
        pose(0.0, 0.0, 0.0, -0.09, 0.0),
    ] {
        let frame = View::new(at);
        let found = reference.align(&frame.pyramid, &Se3::identity(), Brightness::default());
        let (metres, radians) = error(&found.frame_from_reference, &first.to(&frame));
        assert!(metres < 0.015 && radians < 0.0015, "off by {metres} m, {radians} rad: {found:?}");
        assert!(found.visible_share > 0.7 && found.inlier_share > 0.85, "{found:?}");
        assert!(found.brightness.log_gain.abs() < 0.05, "{found:?}");
    }
}

#[test]
fn follows_gain_and_offset() {
    let (first, second) = (keyframe(), View::new(pose(0.1, 0.0, 0.1, 0.03, 0.0)));
    let reference = reference(&first);
    for (gain, offset) in [(0.6, 0.0), (1.4, -20.0), (0.6, 40.0), (1.0, 15.0), (1.4, 0.0)] {
        let frame = Pyramid::new(brightened(second.pyramid.base(), gain, offset), 5);
        let found = reference.align(&frame, &Se3::identity(), Brightness::default());
        let (metres, radians) = error(&found.frame_from_reference, &first.to(&second));
        assert!(metres < 0.02 && radians < 0.002, "off by {metres} m, {radians} rad: {found:?}");
        // The brightest pixels saturate at the larger gains: what counts is the range between.
        for intensity in [60.0, 140.0] {
            let fitted = found.brightness.log_gain.exp() * intensity + found.brightness.offset;
            let off = fitted - (gain * intensity + offset);
            assert!(off.abs() < 8.0, "{gain} {offset}: {intensity} is {off} off, {found:?}");
        }
    }
}

#[test]
fn the_evidence_tells_a_failure() {
    let first = keyframe();
    let reference = reference(&first);
    let quality = |a: &Alignment| a.visible_share * a.inlier_share;
    let align = |image: &Pyramid| reference.align(image, &Se3::identity(), Brightness::default());
    let good = quality(&align(&first.pyramid));
    assert!(good > 0.95, "{good}");
    let behind = align(&View::new(pose(0.0, 0.0, 0.0, 3.0, 0.0)).pyramid);
    assert!(quality(&behind) < 0.75 * good && behind.rmse > 5.0, "{behind:?}");
    // A picture without contrast fits anything, with a gain that no camera has.
    let black = align(&Pyramid::new(GrayImage::filled(CAMERA.width, CAMERA.height, 0), 5));
    assert!(quality(&black) < 0.5 * good || black.brightness.log_gain < -1.5, "{black:?}");
}

#[test]
fn nothing_to_see_leaves_the_guess_and_says_so() {
    let first = keyframe();
    let guess = pose(0.3, 0.0, 0.0, 0.1, 0.0);
    let empty = AlignmentReference::new(&first.pyramid, &CAMERA, &[], &AlignParams::default());
    assert!(empty.is_empty());
    let found = empty.align(&first.pyramid, &guess, Brightness::default());
    assert_eq!(found.frame_from_reference, guess);
    assert_eq!((found.visible_share, found.inlier_share), (0.0, 0.0));
    let away = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 3.0, 0.0));
    let found = reference(&first).align(&first.pyramid, &away, Brightness::default());
    assert_eq!(found.frame_from_reference, away);
    assert_eq!((found.visible_share, found.inlier_share), (0.0, 0.0));
}

#[test]
fn the_coarse_cost_ranks_guesses() {
    let (first, second) = (keyframe(), View::new(pose(0.0, 0.0, 0.0, 0.2, 0.0)));
    let reference = reference(&first);
    let cost = |guess: &Se3| reference.coarse_cost(&second.pyramid, guess, Brightness::default());
    let truth = first.to(&second);
    assert!(cost(&truth) < 0.7 * cost(&Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.4, 0.0))));
    assert!(cost(&truth) < 0.7 * cost(&Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 3.0, 0.0))));
}

#[test]
fn jacobians_agree_with_differences() {
    let view = keyframe();
    for level in [0, 2] {
        let prepared = Level::new(&view.pyramid, &CAMERA, &view.points(40), level);
        assert!(prepared.points.len() > 10);
        for point in &prepared.points {
            let ray = Vector3::from(point.ray).cast::<f64>();
            let template = |twist: &Vector6<f64>| {
                let at = prepared.camera.project(&(Se3::exp(twist) * (ray / point.inverse_depth as f64)));
                point.gradient[0] as f64 * at.x + point.gradient[1] as f64 * at.y
            };
            for k in 0..6 {
                let mut twist = Vector6::zeros();
                twist[k] = 1e-6;
                let slope = (template(&twist) - template(&-twist)) / 2e-6;
                let analytic = point.jacobian[k] as f64;
                assert!((slope - analytic).abs() < 1e-3 * slope.abs().max(10.0), "{k}: {slope} {analytic}");
            }
        }
    }
}
