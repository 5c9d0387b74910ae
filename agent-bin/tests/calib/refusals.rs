//! What is refused, and with which words; nothing is written then.

use crate::common::{arg, assert_misused, assert_refused};
use crate::support::{Artist, BOARD};
use std::path::Path;
use tempfile::tempdir;

/// Refused, with these words and without a file.
fn refused(folder: &Path, board: &str, words: &[&str]) {
    let out = tempdir().unwrap();
    let (file, page) = (out.path().join("camera.yaml"), out.path().join("report.html"));
    let args = ["calib", "--board", board, arg(folder), "--out", arg(&file), "--report", arg(&page)];
    assert_refused(&args, words);
    assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 0, "something was left behind");
}

#[test]
fn too_few_views() {
    let folder = tempdir().unwrap();
    let artist = Artist::new();
    for (i, tilt) in [[0.4, 0.0, 0.0], [0.0, 0.4, 0.0]].into_iter().enumerate() {
        artist.draw([0.0, 0.0, 0.4], tilt).save(folder.path().join(format!("{i}.png"))).unwrap();
    }
    refused(folder.path(), BOARD, &["2 of 2 images", "3 are needed", "hint"]);
}

#[test]
fn one_direction_only() {
    let folder = tempdir().unwrap();
    let artist = Artist::new();
    for i in 0..4 {
        let image = artist.draw([0.02 * i as f64 - 0.03, 0.0, 0.42], [0.0; 3]);
        image.save(folder.path().join(format!("{i}.png"))).unwrap();
    }
    refused(folder.path(), BOARD, &["tilt", "hint: add images"]);
}

#[test]
fn another_board() {
    let folder = tempdir().unwrap();
    Artist::new().draw([0.0, 0.0, 0.4], [0.2, 0.3, 0.0]).save(folder.path().join("a.png")).unwrap();
    refused(folder.path(), "chessboard:10x7:0.03", &["shows the board", "9×6 inner corners", "not squares"]);
    refused(folder.path(), "aprilgrid:6x6:0.088:0.3", &["no tag 36h11", "hint"]);
    refused(folder.path(), "charuco:7x5:0.04:0.03", &["no markers", "hint"]);
}

#[test]
fn blurred_images() {
    let folder = tempdir().unwrap();
    let artist = Artist::new();
    for i in 0..4 {
        let sharp = artist.draw([0.0, 0.0, 0.36], [0.3 - 0.2 * i as f64, 0.2, 0.0]);
        image::imageops::blur(&sharp, 3.0).save(folder.path().join(format!("{i}.png"))).unwrap();
    }
    refused(folder.path(), BOARD, &["blurred", "0 of 4 images", "hint"]);
}

#[test]
fn sizes_and_files_that_do_not_fit() {
    let folder = tempdir().unwrap();
    Artist::new().draw([0.0, 0.0, 0.4], [0.2, 0.3, 0.0]).save(folder.path().join("a.png")).unwrap();
    image::GrayImage::new(64, 48).save(folder.path().join("b.png")).unwrap();
    refused(folder.path(), BOARD, &["b.png: has 64×48 pixels", "400×300"]);
    std::fs::write(folder.path().join("b.png"), "no image").unwrap();
    refused(folder.path(), BOARD, &["b.png", "not a PNG", "hint"]);
    refused(&folder.path().join("c.png"), BOARD, &["c.png", "there is no such file"]);
}

#[test]
fn what_is_asked_for_wrongly() {
    let out = tempdir().unwrap();
    let file = out.path().join("camera.yaml");
    assert_misused(&["calib", "x", "--out", arg(&file)], &["--board is missing", "chessboard:9x6"]);
    assert_refused(&["calib", "--board", BOARD, "--out", arg(&file)], &["no images", "hint"]);
    let nowhere = out.path().join("no/camera.yaml");
    assert_refused(&["calib", "--board", BOARD, arg(out.path()), "--out", arg(&nowhere)], &["camera.yaml"]);
}
