//! Folders of images as sources, through the binary.

mod common;

use common::*;
use image::{DynamicImage, ImageFormat};
use tempfile::tempdir;

#[test]
fn own_folder() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 4);
    let said = info(folder.path(), &[]);
    assert_eq!((&said["frames"], &said["size"]), (&4.into(), &serde_json::json!([96, 64])));
    assert!(said["calibration"].as_str().unwrap().ends_with("camera.yaml"));
    assert_eq!(processed_times(&read_through(folder.path(), &[])), [0.0, 0.1, 0.2, 0.3]);
    assert_eq!(
        processed_times(&read_through(folder.path(), &["--start", "0.1", "--end", "0.2"])),
        [0.1, 0.2]
    );
}

#[test]
fn tum_folder() {
    let folder = tempdir().unwrap();
    write(folder.path().join("rgb/a.png"), encoded(0, ImageFormat::Png));
    write(folder.path().join("rgb/b.png"), encoded(1, ImageFormat::Png));
    write(
        folder.path().join("rgb.txt"),
        "# color images\n1305031102.175304 rgb/a.png\n1305031102.211214 rgb/b.png\n",
    );
    let calibration = folder.path().join("fr1.yaml");
    write(calibration.clone(), CAMERA);
    let run = read_through(folder.path(), &["--calib", arg(&calibration)]);
    assert_eq!(processed_times(&run), [1305031102.175304, 1305031102.211214]);
    let out = tempdir().unwrap();
    assert_refused(&["run", arg(folder.path()), "--out", arg(out.path())], &["no calibration", "--calib"]);
}

#[test]
fn euroc_folder() {
    let folder = tempdir().unwrap();
    let camera = folder.path().join("mav0/cam0");
    write(camera.join("data/1403636579763555584.png"), encoded(0, ImageFormat::Png));
    write(camera.join("data/1403636579813555456.png"), encoded(1, ImageFormat::Png));
    let rows = "#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n\
                1403636579813555456,1403636579813555456.png\r\n";
    write(camera.join("data.csv"), rows);
    let sensor = "sensor_type: camera\nresolution: [96, 64]\ncamera_model: pinhole\n\
                  intrinsics: [80.0, 80.0, 47.5, 31.5]\ndistortion_model: radial-tangential\n\
                  distortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n";
    write(camera.join("sensor.yaml"), sensor);
    for path in [folder.path(), &folder.path().join("mav0"), &camera] {
        let times = processed_times(&read_through(path, &[]));
        assert_eq!(times.len(), 2);
        assert!(
            (times[0] - 1_403_636_579.763_555_5).abs() < 1e-6
                && (times[1] - 1_403_636_579.813_555_5).abs() < 1e-6
        );
    }
}

#[test]
fn kitti_folder() {
    let folder = tempdir().unwrap();
    for i in 0..3 {
        write(folder.path().join(format!("image_0/{i:06}.png")), encoded(i, ImageFormat::Png));
    }
    write(folder.path().join("times.txt"), "0.000000e+00\n1.036224e-01\n2.072320e-01\n");
    write(folder.path().join("calib.txt"), "P0: 80.0 0 47.5 0 0 80.0 31.5 0 0 0 1 0\n");
    let run = read_through(folder.path(), &[]);
    assert_eq!(processed_times(&run), [0.0, 0.1036224, 0.207232]);
    assert_eq!(run["camera"]["width"], 96);
}

#[test]
fn numbered_images_of_every_kind() {
    let folder = tempdir().unwrap();
    write(folder.path().join("f2.jpg"), encoded(0, ImageFormat::Jpeg));
    write(folder.path().join("f10.pgm"), encoded(1, ImageFormat::Pnm));
    let mut deep = Vec::new();
    let picture = DynamicImage::ImageLuma8(picture(2));
    picture.to_luma16().write_to(&mut std::io::Cursor::new(&mut deep), ImageFormat::Png).unwrap();
    write(folder.path().join("f1.png"), deep);
    let mut colour = Vec::new();
    picture.to_rgb8().write_to(&mut std::io::Cursor::new(&mut colour), ImageFormat::Png).unwrap();
    write(folder.path().join("f11.png"), colour);
    write(folder.path().join("camera.yaml"), CAMERA);
    let out = tempdir().unwrap();
    assert_refused(&["run", arg(folder.path()), "--out", arg(out.path())], &["4 images", "--fps"]);
    let run = read_through(folder.path(), &["--fps", "20"]);
    assert_eq!(processed_times(&run), [0.0, 0.05, 0.1, 0.15]);
}

#[test]
fn bad_frames_are_skipped_and_counted() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 9);
    let jpeg = encoded(1, ImageFormat::Jpeg);
    write(folder.path().join("images/000001.png"), &jpeg[..jpeg.len() / 2]);
    write(folder.path().join("images/000002.png"), "no image");
    std::fs::remove_file(folder.path().join("images/000003.png")).unwrap();
    let other_size = image::GrayImage::new(32, 32);
    other_size.save(folder.path().join("images/000004.png")).unwrap();
    let times = "0.0 images/000000.png\n0.1 images/000001.png\n0.2 images/000002.png\n0.3 images/000003.png\n\
                 0.4 images/000004.png\n0.5 images/000005.png\n0.5 images/000006.png\n0.45 images/000007.png\n\
                 0.6 images/000008.png\n";
    write(folder.path().join("times.txt"), times);
    let run = read_through(folder.path(), &[]);
    assert_eq!(processed_times(&run), [0.0, 0.5, 0.6]);
    let skipped =
        serde_json::json!({ "unreadable": 3, "wrong_size": 1, "duplicate_time": 1, "out_of_order": 1 });
    assert_eq!(run["frames"]["skipped"], skipped);
    assert_eq!(run["frames"]["offered"], 9);
}

#[test]
fn skipped_frames_are_warned_of() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 3);
    write(folder.path().join("images/000001.png"), "no image");
    let out = tempdir().unwrap();
    let output = loopbox(&["run", arg(folder.path()), "--out", arg(out.path())]);
    assert!(stderr(&output).contains("warning: frame 1 is skipped"), "{}", stderr(&output));
}
