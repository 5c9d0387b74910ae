//! Response and vignette through the binary, read back by what runs use.

use crate::common::{arg, assert_refused, loopbox, stderr};
use calib::read_photometric;
use image::{GrayImage, Luma};
use tempfile::tempdir;

#[test]
fn response_and_vignette_are_written_and_read_back() {
    let (sweep, flat, out) = (tempdir().unwrap(), tempdir().unwrap(), tempdir().unwrap());
    let mut table = String::new();
    for i in 0..30 {
        let exposure = 0.06 * 1.15f64.powi(i);
        let image = GrayImage::from_fn(96, 64, |x, y| {
            let light = (0.01 + ((x * 37 + y * 91) % 97) as f64 / 97.0) * exposure;
            Luma([(255.0 * light.min(1.0).sqrt()).round() as u8])
        });
        image.save(sweep.path().join(format!("{i:02}.png"))).unwrap();
        table += &format!("{i:02}.png {exposure}\n");
    }
    std::fs::write(sweep.path().join("exposures.txt"), table).unwrap();
    let fall_off = |x: u32, y: u32| {
        let (dx, dy) = ((f64::from(x) - 47.5) / 60.0, (f64::from(y) - 31.5) / 60.0);
        1.0 - 0.4 * (dx * dx + dy * dy)
    };
    let image =
        GrayImage::from_fn(96, 64, |x, y| Luma([(255.0 * (0.8 * fall_off(x, y)).sqrt()).round() as u8]));
    image.save(flat.path().join("0.png")).unwrap();

    let (response, vignette) = (out.path().join("pcalib.txt"), out.path().join("vignette.png"));
    let done = loopbox(&["calib", "--response", arg(sweep.path()), "--out", arg(&response)]);
    assert!(done.status.success(), "{}", stderr(&done));
    let done = loopbox(&[
        "calib",
        "--vignette",
        arg(flat.path()),
        "--with-response",
        arg(&response),
        "--out",
        arg(&vignette),
    ]);
    assert!(done.status.success(), "{}", stderr(&done));
    let found = read_photometric(Some(&response), Some(&vignette)).unwrap();
    for level in [20usize, 100, 200, 250] {
        let truth = (level * level) as f64 / 255.0;
        let error = (f64::from(found.inverse_response()[level]) - truth).abs();
        assert!(error < 4.0, "level {level}: {error}");
    }
    // The flat surface is flat again.
    let plain = geometry::GrayImage::from_vec(96, 64, image.into_raw()).unwrap();
    let corrected = found.apply(&plain).unwrap();
    let (low, high) = (corrected.data().iter().min().unwrap(), corrected.data().iter().max().unwrap());
    assert!(high - low <= 8, "{low} to {high}");
}

#[test]
fn a_folder_without_exposures_is_refused() {
    let folder = tempdir().unwrap();
    let out = folder.path().join("pcalib.txt");
    assert_refused(
        &["calib", "--response", arg(folder.path()), "--out", arg(&out)],
        &["exposures.txt", "hint"],
    );
    assert_refused(&["calib", "--vignette", arg(folder.path()), "--out", arg(&out)], &["no images", "hint"]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
