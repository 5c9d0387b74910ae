//! Calibrating from drawn images.

use crate::common::{arg, loopbox, stderr, stdout};
use crate::support::{Artist, BOARD, calibrated, camera, parameter};
use tempfile::tempdir;

#[test]
fn a_drawn_board_gives_its_camera() {
    let folder = tempdir().unwrap();
    Artist::new().folder(folder.path());
    let report = tempdir().unwrap();
    let page = report.path().join("report.html");
    let (file, numbers) = calibrated(folder.path(), BOARD, &["--report", arg(&page)]);
    let (truth, found) = (*camera().intrinsics(), *file.camera.intrinsics());
    assert!(
        (found.fx / truth.fx - 1.0).abs() < 0.005 && (found.fy / truth.fy - 1.0).abs() < 0.005,
        "{found:?}"
    );
    assert!((found.cx - truth.cx).abs() < 1.0 && (found.cy - truth.cy).abs() < 1.0, "{found:?}");
    assert!(numbers["rms"].as_f64().unwrap() < 0.2, "{}", numbers["rms"]);
    assert!((parameter(&numbers, "k1").0 + 0.2).abs() < 0.02);
    assert_eq!(numbers["views"].as_array().unwrap().len(), 12);
    let text = std::fs::read_to_string(folder.path().join("camera.yaml")).unwrap();
    assert!(text.contains("# fx ±") && text.contains("# rms 0."), "{text}");
    let html = std::fs::read_to_string(page).unwrap();
    for word in ["Content-Security-Policy", "id=\"vectors\"", "id=\"tilt\"", "00.png"] {
        assert!(html.contains(word), "no {word} in the report");
    }
    assert!(!html.contains("http://") && !html.contains("https://"));
}

#[test]
fn the_summary_names_parameters_and_what_would_help() {
    let folder = tempdir().unwrap();
    Artist::new().folder(folder.path());
    let out = folder.path().join("k.yaml");
    let output = loopbox(&[
        "calib",
        arg(folder.path()),
        "--board",
        BOARD,
        "--model",
        "pinhole-radtan",
        "--out",
        arg(&out),
    ]);
    let (said, message) = (stdout(&output), stderr(&output));
    assert!(output.status.success(), "{message}");
    for word in ["fx ", " ± ", "rms ", "views ", "as OpenCV counts"] {
        assert!(said.contains(word), "no {word} in {said}");
    }
}
