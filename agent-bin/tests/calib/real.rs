//! The shared images of real boards against known calibrations.

use crate::common::{arg, assert_refused, loopbox, stderr};
use crate::support::{calibrated, parameter, shared};
use std::path::Path;
use tempfile::{TempDir, tempdir};

const CHESSBOARD: &str = "chessboard:9x6:0.025";
const GRID: &str = "aprilgrid:6x6:0.088:0.3";
/// What the EuRoC data set publishes of the camera that saw the grid.
const KNOWN: [(&str, f64); 8] = [
    ("fx", 458.654),
    ("fy", 457.296),
    ("cx", 367.215),
    ("cy", 248.375),
    ("k1", -0.28340811),
    ("k2", 0.07395907),
    ("p1", 0.00019359),
    ("p2", 1.76e-5),
];

/// Copies of the images, so that nothing is written beside the originals.
fn copied(from: &Path, how: impl Fn(image::GrayImage) -> image::GrayImage, count: usize) -> TempDir {
    let folder = tempdir().unwrap();
    let files = std::fs::read_dir(from).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = files.filter(|path| path.extension().is_some_and(|e| e == "jpg")).collect();
    files.sort();
    for path in files.iter().take(count) {
        let name = folder.path().join(path.file_name().unwrap()).with_extension("png");
        how(image::open(path).unwrap().into_luma8()).save(name).unwrap();
    }
    folder
}

/// The known result (fx 536.07, fy 536.02) rests on corners sought 11 pixels around, which in one image is as far as the
/// next corners and leaves 1.2 px there. With windows that hold no other corner the residuals are less than half, and
/// OpenCV's own calibration of those corners gives fx 533.1, fy 533.2.
#[test]
fn chessboard() {
    let Some(images) = shared("calib_chessboard") else { return };
    let folder = copied(&images, |image| image, 99);
    let solved = |more: &[&str]| {
        let all = [&["--model", "radtan5"], more].concat();
        calibrated(folder.path(), CHESSBOARD, &all).1
    };
    let wide = solved(&["--window", "11"]);
    assert!(wide["rms"].as_f64().unwrap() <= 0.41, "{}", wide["rms"]);
    let fitting = solved(&[]);
    assert!(fitting["rms"].as_f64().unwrap() <= 0.18, "{}", fitting["rms"]);
    for (name, known, refined) in [("fx", 536.07, 533.1), ("fy", 536.02, 533.2)] {
        let (value, _) = parameter(&wide, name);
        assert!((value / known - 1.0).abs() < 0.005, "{name} {value}");
        let (value, _) = parameter(&fitting, name);
        assert!((value / known - 1.0).abs() < 0.006, "{name} {value}");
        assert!((value / refined - 1.0).abs() < 0.001, "{name} {value}");
    }
}

/// Four terms do not quite fit this lens, so each of them depends on how far out corners were seen. The known tangential
/// terms are nearly nothing, so that no share can be asked of them: 0.0005 moves no ray by more than about a pixel.
#[test]
fn april_grid() {
    let Some(images) = shared("calib_aprilgrid") else { return };
    let folder = copied(&images, |image| image, 99);
    let (_, numbers) = calibrated(folder.path(), GRID, &[]);
    assert!(numbers["rms"].as_f64().unwrap() <= 0.3, "{}", numbers["rms"]);
    for (i, (name, known)) in KNOWN.into_iter().enumerate() {
        let (value, sigma) = parameter(&numbers, name);
        assert!((value - known).abs() < 4.0 * sigma, "{name} {value} ± {sigma}");
        assert!(i > 5 || (value / known - 1.0).abs() < 0.01, "{name} {value}");
        assert!(i < 6 || (value - known).abs() < 5e-4, "{name} {value}");
    }
    let advice = numbers["coverage"]["advice"].to_string();
    assert!(advice.contains("radtan does not quite fit this lens"), "{advice}");
}

/// Of images that it was not made from, our calibration sees the corners as well as the known one does; a model that
/// fits the lens sees them better.
#[test]
fn april_grid_held_out() {
    let Some(images) = shared("calib_aprilgrid") else { return };
    let folder = copied(&images, |image| image, 99);
    let mut files: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let half =
        |which: usize| -> Vec<&str> { files.iter().skip(which).step_by(2).map(|file| arg(file)).collect() };
    let known = folder.path().join("known.yaml");
    let values = KNOWN.map(|(_, value)| value);
    let [fx, fy, cx, cy, k1, k2, p1, p2] = values;
    let text = format!(
        "model: radtan\nwidth: 752\nheight: 480\nfx: {fx}\nfy: {fy}\ncx: {cx}\ncy: {cy}\ndistortion: [{k1}, {k2}, {p1}, {p2}]\n"
    );
    std::fs::write(&known, text).unwrap();
    let of = |model: &str| {
        let out = folder.path().join(format!("{model}.yaml"));
        let output = loopbox(
            &[&["calib", "--board", GRID, "--model", model, "--out", arg(&out)], &half(0)[..]].concat(),
        );
        assert!(output.status.success(), "{}", stderr(&output));
        out
    };
    let error = |camera: &Path| -> f64 {
        let more = half(1);
        let output =
            loopbox(&[&["calib", "--board", GRID, "--json", "--check", arg(camera)], &more[..]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let numbers: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(numbers["used"], numbers["images"]);
        numbers["rms"].as_f64().unwrap()
    };
    let (known, ours, fisheye) = (error(&known), error(&of("radtan")), error(&of("kb4")));
    assert!(ours < 1.05 * known, "{ours} px, the known one {known} px");
    assert!(fisheye < 0.75 * known && fisheye < 0.25, "{fisheye} px, the known one {known} px");
}

#[test]
fn a_mirrored_grid_is_called_mirrored() {
    let Some(images) = shared("calib_aprilgrid") else { return };
    let folder = copied(&images, |image| image::imageops::flip_horizontal(&image), 4);
    let out = folder.path().join("camera.yaml");
    assert_refused(
        &["calib", "--board", GRID, arg(folder.path()), "--out", arg(&out)],
        &["mirrored image", "hint"],
    );
    assert!(!out.exists());
}
