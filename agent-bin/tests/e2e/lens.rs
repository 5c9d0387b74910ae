//! Recordings without a calibration, or with a wrong one.

use crate::support::{Accuracy, Case, Outcome, RATE, drive, hand_held, loopbox, world};
use geometry::{Pinhole, Se3};
use loopbox_tests::{Encoding, Recording, World, trajectory};
use nalgebra::{UnitQuaternion, Vector3};
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
    let record = fs::read_to_string(case.out().join("run.json")).expect("the results hold it");
    let record: serde_json::Value = serde_json::from_str(&record).expect("JSON");
    let deviation = record["calibration"]["focal_deviation"].as_f64().expect("as it was found");
    assert!(deviation > 0.0 && (found / truth - 1.0).abs() < 3.0 * deviation, "{deviation}");
    let measured = Accuracy::of(&case.out(), &case.source().join("groundtruth.txt"));
    assert!(measured.frames >= 118, "{} frames", measured.frames);
    assert!(measured.rmse < 0.004 * measured.path, "{} m of {} m", measured.rmse, measured.path);
}

/// Writes into the JPEGs of a recording that their lens is as long as this on 35 mm film.
fn state_focal(case: &Case, mm: u16) {
    // Its block of metadata: one entry that names a second table, whose one entry is the length.
    let entry = |tag: u16, kind: u16, value: u32| {
        let parts = [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1u32.to_le_bytes(), &value.to_le_bytes()];
        [&1u16.to_le_bytes()[..], &parts.concat(), &[0; 4]].concat()
    };
    let tables = [entry(0x8769, 4, 26), entry(0xa405, 3, mm.into())].concat();
    let block = [b"Exif\0\0II*\0\x08\0\0\0".as_slice(), &tables].concat();
    let length = (block.len() as u16 + 2).to_be_bytes();
    let segment = [&[0xff, 0xe1], &length[..], &block].concat();
    for file in fs::read_dir(case.source().join("images")).expect("we wrote it") {
        let file = file.expect("it is there").path();
        let bytes = fs::read(&file).expect("an image");
        fs::write(&file, [&bytes[..2], &segment, &bytes[2..]].concat()).expect("it can be written");
    }
}

/// A lens that is none of the usual ones, of which only the images say how long it is.
#[test]
fn the_lens_in_the_images_metadata_is_begun_with() {
    let camera = Pinhole { width: 320, height: 240, fx: 420.0, fy: 420.0, cx: 159.5, cy: 119.5 };
    let recording = Recording::render(world(), camera, &trajectory::hand_held(90, 0.8), RATE);
    let case = Case::with_encoding(&recording, Encoding::Jpeg);
    fs::remove_file(case.source().join("camera.yaml")).expect("it is there");
    // 420 pixels of a diagonal of 400 are 45.4 mm of one of 43.27 mm.
    state_focal(&case, 45);
    let outcome = case.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["begun with 45 mm on 35 mm film, by the images' Exif"]);
    let found = focal(&fs::read_to_string(case.out().join("camera.yaml")).expect("the results hold it"));
    assert!((found / camera.fx - 1.0).abs() < 0.02, "{found}\n{outcome}");
}

/// The same of a video: telephones write their lens's length into its metadata.
#[test]
fn the_lens_in_a_videos_metadata_is_begun_with() {
    let camera = Pinhole { width: 320, height: 240, fx: 420.0, fy: 420.0, cx: 159.5, cy: 119.5 };
    let case = Case::new(&Recording::render(world(), camera, &trajectory::hand_held(90, 0.8), RATE));
    fs::remove_file(case.source().join("camera.yaml")).expect("it is there");
    let video = case.source().with_file_name("walk.mp4");
    let mut convert = loopbox();
    convert.arg("convert").arg(case.source()).arg(&video).arg("--fps").arg(RATE.to_string());
    Outcome::of(convert).assert_success();
    let boxed = |kind: &[u8], content: &[&[u8]]| {
        let content = content.concat();
        [&(content.len() as u32 + 8).to_be_bytes()[..], kind, &content].concat()
    };
    let key = boxed(b"mdta", &[b"com.apple.quicktime.camera.focal_length.35mm_equivalent"]);
    let keys = boxed(b"keys", &[&[0, 0, 0, 0, 0, 0, 0, 1], &key]);
    let value = boxed(b"data", &[&[0, 0, 0, 21, 0, 0, 0, 0], &45i32.to_be_bytes()]);
    let list = boxed(b"ilst", &[&boxed(&[0, 0, 0, 1], &[&value])]);
    let metadata = boxed(b"meta", &[&boxed(b"hdlr", &[&[0; 24]]), &keys, &list]);
    let bytes = fs::read(&video).expect("it was written");
    fs::write(&video, [bytes, boxed(b"moov", &[&metadata])].concat()).expect("it can be written");
    let outcome = Outcome::of(case.command_on(&video, &[]));
    outcome.assert_success();
    outcome.assert_says(&["begun with 45 mm on 35 mm film, by the video's metadata"]);
}

/// A short way straight ahead says little of the focal length: what is stated is kept.
#[test]
fn a_stated_lens_is_kept_where_the_motion_says_less() {
    let ahead =
        |i: usize| Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, -1.3, 3.0 + 0.02 * i as f64));
    let path: Vec<Se3> = (0..60).map(ahead).collect();
    let recording = Recording::render(world(), Recording::SMALL_CAMERA, &path, RATE);
    let case = Case::with_encoding(&recording, Encoding::Jpeg);
    fs::remove_file(case.source().join("camera.yaml")).expect("it is there");
    state_focal(&case, 23);
    let outcome = case.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["begun with 23 mm", "a guess"]);
    let found = focal(&fs::read_to_string(case.out().join("camera.yaml")).expect("the results hold it"));
    assert!((found / 210.0 - 1.0).abs() < 0.02, "{found}\n{outcome}");
}

#[test]
fn a_wrong_focal_length_is_noticed_with_its_size() {
    let path = trajectory::hand_held(90, 1.2);
    let (case, _) = with_focal(&Recording::render(world(), Recording::SMALL_CAMERA, &path, RATE), 1.3);
    let outcome = case.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["the focal length looks", "too long or more", "mapped anew with other lenses"]);
    let percent = |text: &str| -> f64 {
        let (number, _) = text.split_once(' ').expect("a word");
        number.parse().expect("a number")
    };
    let output: Vec<f64> = outcome.text.split("the focal length looks ").skip(1).map(percent).collect();
    assert_eq!(output.len(), 2, "at once by the map, then mapped anew\n{outcome}");
    assert!((output[0] - 30.0).abs() <= 5.0 && (output[1] - 30.0).abs() <= 1.5, "{output:?} %");
}

/// A focal length that is 30 % too long bends the images of a camera that walks: what is in the middle agrees with one pose and what is at
/// the border with another.
#[test]
fn what_a_wrong_focal_length_bends_is_not_taken_for_what_moves() {
    let path = trajectory::walk(150, RATE, 9);
    let recording = Recording::render(&World::yard(7), Recording::SMALL_CAMERA, &path, RATE);
    let outcome = with_focal(&recording, 1.3).0.run(&[]);
    outcome.assert_success();
    outcome.assert_says(&["150 of 150 frames tracked", "the focal length looks"]);
    assert!(!outcome.text.contains("moves against the rest"), "{outcome}");
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

/// Rows that are read one after the other bend the images of a camera that moves: the recording tells by how much.
#[test]
fn a_rolling_shutter_is_found_and_costs_little() {
    const READOUT: f64 = 0.025;
    let path = trajectory::walk(150, RATE, 3);
    let rolling =
        Case::new(&Recording::render_rolling(world(), Recording::SMALL_CAMERA, &path, RATE, READOUT));
    let mapped = |case: &Case, arguments: &[&str]| {
        let outcome = case.run(arguments);
        outcome.assert_success();
        let map = case.map();
        let output = map.agents.values().next().and_then(|about| about.provenance.get("readout rows"));
        let readout: f64 = output.expect("it is said with the map").parse().expect("a number");
        (readout, Accuracy::of(&case.out(), &case.source().join("groundtruth.txt")))
    };
    let (readout, solved) = mapped(&rolling, &[]);
    assert!((readout / READOUT - 1.0).abs() < 0.1, "{readout} s");
    let params = tempfile::NamedTempFile::new().expect("a temporary file");
    fs::write(params.path(), "[mapping]\nreadout_sigma = 0.0\n").expect("it can be written");
    let params = params.path().to_str().expect("a plain name");
    let (none, ignored) = mapped(&rolling, &["--force", "--params", params]);
    assert_eq!(none, 0.0);
    assert!(solved.frames >= 148 && ignored.frames >= 140, "{} and {} frames", solved.frames, ignored.frames);
    assert!(2.0 * solved.rmse < ignored.rmse, "{} m, and {} m without", solved.rmse, ignored.rmse);
    let global = Case::new(&Recording::render(world(), Recording::SMALL_CAMERA, &path, RATE));
    let (none, accuracy) = mapped(&global, &[]);
    assert_eq!(none, 0.0, "a camera that exposes all rows at once");
    assert!(accuracy.rmse < 0.002 * accuracy.path, "{} m of {} m", accuracy.rmse, accuracy.path);
}
