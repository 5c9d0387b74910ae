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
    let (printed, message) = (stdout(&output), stderr(&output));
    assert!(output.status.success(), "{message}");
    for word in ["fx ", " ± ", "rms ", "views ", "as OpenCV counts"] {
        assert!(printed.contains(word), "no {word} in {printed}");
    }
}

#[test]
fn a_calibration_is_checked_without_writing() {
    let folder = tempdir().unwrap();
    Artist::new().folder(folder.path());
    let camera = folder.path().join("camera.yaml");
    let images: Vec<_> = (0..4).map(|i| folder.path().join(format!("{i:02}.png"))).collect();
    let check = |text: String| {
        std::fs::write(&camera, text).unwrap();
        let images = images.iter().map(|image| arg(image));
        let args: Vec<&str> =
            ["calib", "--board", BOARD, "--check", arg(&camera)].into_iter().chain(images).collect();
        loopbox(&args)
    };
    let text = calib::format_camera(&crate::support::camera(), None);
    let output = check(text.clone());
    let printed = stdout(&output);
    assert!(output.status.success(), "{}", stderr(&output));
    let rms: f64 = printed.split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!(rms < 0.2 && printed.contains("216 corners of 4 of 4 images"), "{printed}");
    let output = check(text.replace("width: 400", "width: 401"));
    assert!(!output.status.success());
    let message = stderr(&output);
    assert!(
        message.contains("401×300") && message.contains("400×300") && message.contains("hint"),
        "{message}"
    );
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 13);
}
