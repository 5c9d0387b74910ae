//! Text files and folders that do not say what they should.

use crate::support::{Case, Outcome, drive, hand_held};
use std::fs;

#[test]
fn an_empty_folder_is_refused() {
    let case = Case::empty();
    let outcome = case.run(&[]);
    outcome.assert_refused(&["recording", "images"]);
    assert!(!case.out().join("map.mcap").exists(), "nothing was mapped, nothing is left behind");
}

#[test]
fn a_missing_source_is_refused() {
    let case = Case::empty();
    Outcome::of(case.command_on(&case.source().join("nowhere"), &[])).assert_refused(&["nowhere"]);
}

/// Runs on a recording whose `camera.yaml` went through `change`.
fn with_calibration(change: impl Fn(&str) -> String) -> Outcome {
    let recording = hand_held(10);
    let case = Case::new(&recording);
    let text = change(&recording.camera_yaml());
    fs::write(case.source().join("camera.yaml"), text).expect("we may write it");
    case.run(&[])
}

#[test]
fn a_calibration_with_nan_is_refused() {
    let outcome = with_calibration(|text| text.replace("fx: 210.0", "fx: .nan"));
    outcome.assert_refused(&["camera.yaml", "fx"]);
    let outcome = with_calibration(|text| text.replace("cy: 119.5", "cy: nan"));
    outcome.assert_refused(&["camera.yaml", "cy"]);
}

#[test]
fn a_calibration_with_a_missing_key_is_refused() {
    for key in ["fx", "cy", "width", "model"] {
        let without = |text: &str| {
            let lines = text.lines().filter(|line| !line.starts_with(key));
            lines.map(|line| format!("{line}\n")).collect()
        };
        with_calibration(without).assert_refused(&["camera.yaml", key]);
    }
}

#[test]
fn a_missing_calibration_is_refused() {
    let case = Case::new(&hand_held(10));
    fs::remove_file(case.source().join("camera.yaml")).expect("we wrote it");
    case.run(&[]).assert_refused(&["--calib"]);
}

/// Lines swapped and stamps repeated, as drivers and clocks do: frames that cannot be in order are left out and
/// that is said; time in the results only grows.
#[test]
fn unordered_and_repeated_time_stamps_cost_those_frames() {
    let case = Case::new(&drive());
    let path = case.source().join("times.txt");
    let text = fs::read_to_string(&path).expect("we wrote it");
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    lines.swap(31, 32);
    let (stamp, _) = lines[50].split_once(' ').expect("two columns");
    let (_, name) = lines[51].split_once(' ').expect("two columns");
    lines[51] = format!("{stamp} {name}");
    fs::write(&path, lines.join("\n") + "\n").expect("we may write it");

    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 5);
    outcome.assert_says(&["time"]);
    let times: Vec<f64> = case.map().trajectory().iter().map(|pose| pose.timestamp).collect();
    assert!(times.windows(2).all(|w| w[0] < w[1]), "time stamps must grow: {times:?}");
}
