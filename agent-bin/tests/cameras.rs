//! Cameras, as far as they can be tried where there is none.
#![cfg(all(feature = "camera", target_os = "linux"))]

use std::path::Path;
use std::process::{Command, Output};

const CALIBRATION: &str = "model: pinhole\nwidth: 640\nheight: 480\nfx: 500\nfy: 500\ncx: 320\ncy: 240\n";

fn loopbox(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_loopbox")).args(arguments).output().expect("loopbox can be started")
}

/// Fails unless `loopbox run` refuses these arguments with each of `words`, and leaves no folder behind.
fn refused(arguments: &[&str], words: &[&str]) {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let (calibration, out) = (folder.path().join("camera.yaml"), folder.path().join("out"));
    std::fs::write(&calibration, CALIBRATION).expect("the folder takes a file");
    let text = |path: &Path| path.display().to_string();
    let (calibration, place) = (text(&calibration), text(&out));
    let given = arguments.iter().map(|&argument| if argument == "CALIB" { &calibration } else { argument });
    let all: Vec<&str> = ["run", "--out", &place].into_iter().chain(given).collect();
    let output = loopbox(&all);
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code().is_some_and(|code| code != 0), "{arguments:?} is taken");
    assert!(!printed.contains("panicked"), "{printed}");
    for word in words {
        assert!(printed.contains(word), "{arguments:?}: nothing is said of '{word}':\n{printed}");
    }
    assert!(!out.exists(), "{arguments:?} leaves a folder behind");
}

#[test]
fn what_is_no_camera_is_refused() {
    let none = "/dev/video-that-is-not-there";
    refused(&["--camera", none, "--calib", "CALIB"], &[none, "no such device", "hint:"]);
    refused(&["--camera", "/dev/null", "--calib", "CALIB"], &["/dev/null", "not a camera", "hint:"]);
    refused(&["--camera", "CALIB", "--calib", "CALIB"], &["not a camera"]);
    refused(&["--camera", "/dev", "--calib", "CALIB"], &["/dev", "not a camera"]);
}

#[test]
fn options_that_do_not_fit_are_refused() {
    // Without a calibration the lens is found: what is refused is the camera.
    refused(&["--camera", "/dev/video77"], &["/dev/video77", "no such device"]);
    refused(&["--camera", "/dev/video0", "recording"], &["cannot be used with"]);
    refused(&["--camera", "/dev/video0", "--realtime"], &["cannot be used with"]);
    refused(&[], &["--camera"]);
    let camera = ["--camera", "/dev/video0", "--calib", "CALIB"];
    let with = |more: &[&'static str]| [&camera[..], more].concat();
    refused(&with(&["--size", "640"]), &["640x480"]);
    refused(&with(&["--size", "320x240"]), &["320x240", "640x480", "calibrate"]);
    refused(&with(&["--format", "H264"]), &["MJPG"]);
    refused(&with(&["--format", "kitti"]), &["--trajectory kitti"]);
    refused(&with(&["--fps", "0"]), &["--fps"]);
    refused(&with(&["--duration", "-1"]), &["--duration"]);
    refused(&with(&["--lock", "zoom"]), &["white-balance"]);
    refused(&["recording", "--reconnect"], &["--camera"]);
}

#[test]
fn cameras_are_listed() {
    let output = loopbox(&["cameras", "--json"]);
    assert!(output.status.success());
    let list: serde_json::Value = serde_json::from_slice(&output.stdout).expect("it prints JSON");
    let text = loopbox(&["cameras"]);
    assert!(text.status.success());
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    match list.as_array().expect("a list").first() {
        None => assert!(text.contains("no cameras") && text.contains("hint:"), "{text}"),
        Some(camera) => assert!(text.contains(camera["path"].as_str().expect("a path")), "{text}"),
    }
}
