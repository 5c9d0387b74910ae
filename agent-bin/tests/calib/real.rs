//! The shared images of real boards against known calibrations.

use crate::common::{arg, assert_refused};
use crate::support::{calibrated, parameter, shared};
use std::path::Path;
use tempfile::{TempDir, tempdir};

const GRID: &str = "aprilgrid:6x6:0.088:0.3";

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

/// The published result rests on corners sought 11 pixels around, which is as far as the next corner in some images:
/// with the same corners it is met. With corners sought where no other is, the residuals are less than half.
#[test]
fn chessboard() {
    let Some(images) = shared("calib_chessboard") else { return };
    let folder = copied(&images, |image| image, 99);
    let solved = |more: &[&str]| {
        let all = [&["--model", "radtan5"], more].concat();
        calibrated(folder.path(), "chessboard:9x6:0.025", &all).1
    };
    let wide = solved(&["--window", "11"]);
    assert!(wide["rms"].as_f64().unwrap() <= 0.41, "{}", wide["rms"]);
    for (name, truth) in [("fx", 536.07), ("fy", 536.02)] {
        let (value, _) = parameter(&wide, name);
        assert!((value / truth - 1.0).abs() < 0.005, "{name} {value}");
    }
    let fitting = solved(&[]);
    assert!(fitting["rms"].as_f64().unwrap() <= 0.18, "{}", fitting["rms"]);
}

#[test]
fn april_grid() {
    let Some(images) = shared("calib_aprilgrid") else { return };
    let folder = copied(&images, |image| image, 99);
    let (_, numbers) = calibrated(folder.path(), GRID, &[]);
    assert!(numbers["rms"].as_f64().unwrap() <= 0.3, "{}", numbers["rms"]);
    for (name, truth) in [("fx", 458.654), ("fy", 457.296), ("cx", 367.215), ("cy", 248.375)] {
        let (value, _) = parameter(&numbers, name);
        assert!((value / truth - 1.0).abs() < 0.01, "{name} {value}");
    }
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
