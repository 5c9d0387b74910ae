//! Recordings without a calibration, or with a wrong one.

use crate::support::{Accuracy, Case, RATE, drive, hand_held, world};
use loopbox_tests::{Recording, trajectory};
use std::fs;

/// The focal length in a calibration file.
fn focal(text: &str) -> f64 {
    let line = text.lines().find_map(|line| line.strip_prefix("fx: ")).expect("a focal length");
    line.trim().parse().expect("a number")
}

/// The recording with its focal length made `factor` times as long in its calibration file; gives the true one.
fn with_focal(recording: &Recording, factor: f64) -> (Case, f64) {
    let case = Case::new(recording);
    let file = case.source().join("camera.yaml");
    let text = fs::read_to_string(&file).expect("we wrote it");
    let truth = focal(&text);
    let scaled = |line: &str| match line.split_once(": ") {
        Some((key @ ("fx" | "fy"), value)) => {
            format!("{key}: {}\n", factor * value.parse::<f64>().expect("a number"))
        }
        _ => format!("{line}\n"),
    };
    fs::write(&file, text.lines().map(scaled).collect::<String>()).expect("it can be written");
    (case, truth)
}

#[test]
fn a_recording_without_a_calibration_is_calibrated_from_itself() {
    let case = Case::new(&hand_held(120));
    let file = case.source().join("camera.yaml");
    let truth = focal(&fs::read_to_string(&file).expect("we wrote it"));
    fs::remove_file(&file).expect("it is there");
    let outcome = case.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["no calibration came with it", "focal length"]);
    let found = focal(&fs::read_to_string(case.out().join("camera.yaml")).expect("the results hold it"));
    assert!((found / truth - 1.0).abs() < 0.02, "{found} for {truth}\n{outcome}");
    let measured = Accuracy::of(&case.out(), &case.source().join("groundtruth.txt"));
    assert!(measured.frames >= 118, "{} frames", measured.frames);
    assert!(measured.rmse < 0.004 * measured.path, "{} m of {} m", measured.rmse, measured.path);
}

#[test]
fn a_wrong_focal_length_is_noticed_with_its_size() {
    let path = trajectory::hand_held(90, 1.2);
    let (case, _) = with_focal(&Recording::render(world(), Recording::SMALL_CAMERA, &path, RATE), 1.3);
    let outcome = case.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["the focal length looks", "too long"]);
    let (_, rest) = outcome.text.split_once("the focal length looks ").expect("said above");
    let percent: f64 = rest.split(' ').next().expect("a word").parse().expect("a number");
    assert!((percent - 30.0).abs() <= 5.0, "{percent} %");
}

#[test]
fn a_right_focal_length_is_not_doubted() {
    for recording in [hand_held(120), drive()] {
        let (case, _) = with_focal(&recording, 1.0);
        let outcome = case.run(&[]);
        outcome.assert_success();
        assert!(!outcome.text.contains("the focal length looks"), "{outcome}");
    }
}

#[test]
fn a_field_of_view_is_a_number_of_degrees() {
    let case = Case::new(&drive());
    case.run(&["--fov", "650"]).assert_refused(&["--fov 650", "degrees"]);
}

#[test]
fn wide_images_are_worked_on_at_half_their_size() {
    let case = Case::new(&hand_held(60));
    let outcome = case.run(&["--max-width", "200"]);
    outcome.assert_success();
    let map = case.map();
    let keyframe = map.keyframes.values().next().expect("a keyframe");
    let camera = map.camera(keyframe);
    assert_eq!((camera.width, camera.height), (160, 120));
    let measured = Accuracy::of(&case.out(), &case.source().join("groundtruth.txt"));
    assert!(measured.frames >= 58 && measured.rmse < 0.01 * measured.path, "{} m", measured.rmse);
    case.run(&["--max-width", "20"]).assert_refused(&["--max-width 20"]);
}
