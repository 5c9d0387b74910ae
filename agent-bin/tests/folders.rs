//! Folders of images as sources, through the binary.

mod common;

use common::*;
use image::{DynamicImage, GrayImage, ImageFormat};
use std::path::Path;
use tempfile::tempdir;

#[test]
fn own_folder() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 4);
    let printed = info(folder.path(), &[]);
    assert_eq!((&printed["frames"], &printed["size"]), (&4.into(), &serde_json::json!([96, 64])));
    assert!(printed["calibration"].as_str().unwrap().ends_with("camera.yaml"));
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

/// The folder of a public data set with one image of this size, which shows nothing.
fn data_set(folder: &Path, image: &str, size: (u32, u32), table: &str, rows: &str) {
    std::fs::create_dir_all(folder.join(image).parent().unwrap()).unwrap();
    GrayImage::new(size.0, size.1).save(folder.join(image)).unwrap();
    write(folder.join(table), rows);
}

#[test]
fn public_data_sets_have_their_cameras() {
    let room = tempdir().unwrap();
    let vga = (640, 480);
    let rows = "# color images\n# file: 'rgbd_dataset_freiburg3_walking.bag'\n1.5 rgb/a.png\n";
    data_set(&room.path().join("walking"), "rgb/a.png", vga, "rgb.txt", rows);
    for (name, size) in
        [("rgbd_dataset_freiburg1_xyz", vga), ("fr2_desk", vga), ("fr1_small", (320, 240)), ("desk", vga)]
    {
        data_set(&room.path().join(name), "rgb/a.png", size, "rgb.txt", "1.5 rgb/a.png\n");
    }
    data_set(&room.path().join("07"), "image_0/0.png", (1226, 370), "times.txt", "0.0\n");
    data_set(&room.path().join("other"), "image_0/0.png", (1226, 300), "times.txt", "0.0\n");
    for (name, expected) in [
        ("walking", Some("TUM RGB-D, freiburg3")),
        ("rgbd_dataset_freiburg1_xyz", Some("TUM RGB-D, freiburg1")),
        ("fr2_desk", Some("TUM RGB-D, freiburg2")),
        ("fr1_small", None),
        ("desk", None),
        ("07", Some("KITTI odometry, sequences 04 to 12")),
        ("other", None),
    ] {
        let printed = info(&room.path().join(name), &[]);
        let found = printed["calibration"].as_str();
        assert_eq!(found, expected.map(|of| format!("preset for {of}")).as_deref(), "{name}");
    }

    let (folder, out) = (room.path().join("fr2_desk"), room.path().join("out"));
    let output = loopbox(&["run", arg(&folder), "--out", arg(&out)]);
    assert!(stdout(&output).contains("preset for TUM RGB-D, freiburg2; --calib"), "{}", stdout(&output));
    let own = room.path().join("camera.yaml");
    write(own.clone(), CAMERA.replace("width: 96\nheight: 64", "width: 640\nheight: 480"));
    let output = loopbox(&["run", arg(&folder), "--out", arg(&out), "--calib", arg(&own)]);
    assert!(!stdout(&output).contains("preset"), "{}", stdout(&output));
    write(folder.join("camera.yaml"), CAMERA);
    // One beside the images comes before that of the data set, and this one is not theirs.
    let printed = loopbox(&["info", arg(&folder)]);
    assert_eq!(printed.status.code(), Some(1));
    let used = stdout(&printed);
    assert!(
        used.lines().any(|line| line.starts_with("calibration") && line.ends_with("camera.yaml")),
        "{used}"
    );
}

#[test]
fn tum_mono_folder() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write(path("times.txt"), "00000 1464081111.5 0.25\n00001 1464081111.55 0.3\n00002 1464081111.6 0.3\n");
    write(path("images.zip"), "packed");
    assert_refused(&["info", arg(folder.path())], &["still packed", "unzip"]);
    for i in [0, 2] {
        write(path(&format!("images/{i:05}.jpg")), encoded(i, ImageFormat::Jpeg));
    }
    write(path("camera.txt"), "0.8 1.25 0.5 0.5 0.0\n96 64\ncrop\n96 64\n");
    let response: Vec<String> = (0..256).map(|i| i.to_string()).collect();
    write(path("pcalib.txt"), response.join(" "));
    let printed = info(folder.path(), &[]);
    assert_eq!((&printed["frames"], printed["kind"].as_str()), (&3.into(), Some("TUM monoVO folder")));
    assert!(printed["calibration"].as_str().unwrap().ends_with("camera.txt"));
    let run = read_through(folder.path(), &[]);
    assert_eq!(processed_times(&run), [1464081111.5, 1464081111.6]);
    assert_eq!(run["frames"]["skipped"]["unreadable"], 1);
    write(path("pcalib.txt"), "1 2 3");
    let out = tempdir().unwrap();
    assert_refused(&["run", arg(folder.path()), "--out", arg(out.path())], &["pcalib.txt"]);
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
    // The colour images alone.
    std::fs::rename(folder.path().join("image_0"), folder.path().join("image_2")).unwrap();
    write(
        folder.path().join("calib.txt"),
        "P0: 80 0 47.5 0 0 80 31.5 0 0 0 1 0\nP2: 70 0 40 9 0 70 31 9 0 0 1 9\n",
    );
    assert_eq!(read_through(folder.path(), &[])["camera"]["fx"], 70.0);
}

#[test]
fn times_alone_are_those_of_the_images_in_order() {
    for images in ["images", "."] {
        let folder = tempdir().unwrap();
        for i in 0..3 {
            write(folder.path().join(format!("{images}/{}.png", 8 + i)), encoded(i, ImageFormat::Png));
        }
        write(folder.path().join("camera.yaml"), CAMERA);
        write(folder.path().join("times.txt"), "# seconds\n0.5\n0.6\n0.75\n");
        assert_eq!(processed_times(&read_through(folder.path(), &[])), [0.5, 0.6, 0.75]);
        write(folder.path().join("times.txt"), "0.5\n0.6\n0.75\n0.9\n");
        let out = tempdir().unwrap();
        assert_refused(
            &["run", arg(folder.path()), "--out", arg(out.path())],
            &["4 times for 3 images", "times.txt", "seconds image"],
        );
    }
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

#[test]
fn the_first_reason_is_reported_where_no_image_can_be_read() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    write(folder.path().join("times.txt"), "0.0 a.png\n0.1 b.png\n");
    let run = |words: &[&str]| assert_refused(&["run", arg(folder.path()), "--out", arg(out.path())], words);
    run(&["no image can be read", "a.png", "No such file"]);
    write(folder.path().join("a.png"), "no image");
    run(&["no image can be read", "a.png", "not a PNG"]);
}

#[test]
fn ros2_folders_are_their_mcap_file() {
    let room = tempdir().unwrap();
    timed_folder(&room.path().join("frames"), 4);
    let (bag, frames) = (room.path().join("bag"), room.path().join("frames"));
    write(bag.join("metadata.yaml"), "rosbag2_bagfile_information:\n  version: 5\n");
    write(bag.join("bag_0.db3.zstd"), "packed");
    for path in [bag.clone(), bag.join("bag_0.db3.zstd")] {
        assert_refused(&["info", arg(&path)], &["compressed as a whole", "zstd -d"]);
    }
    std::fs::remove_file(bag.join("bag_0.db3.zstd")).unwrap();
    let output = loopbox(&["convert", arg(&frames), arg(&bag.join("bag_0.mcap"))]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(info(&bag, &[])["frames"], 4);
    assert_eq!(read_through(&bag, &[])["frames"]["offered"], 4);
    // A part of which nothing can be read is told, and the others are read.
    write(bag.join("bag_1.mcap"), "more");
    let printed = info(&bag, &[]);
    assert_eq!(printed["frames"], 4);
    assert!(printed["problems"].to_string().contains("bag_1.mcap"), "{printed}");
}

#[test]
fn a_part_is_selected_by_a_monotone_time() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 12);
    let table = |stamp: &dyn Fn(u32) -> f64| {
        let rows = (0..12).map(|i| format!("{:.1} images/{i:06}.png\n", stamp(i)));
        write(folder.path().join("times.txt"), rows.collect::<String>());
    };
    let part = |from: &'static str, to: &'static str| {
        processed_times(&read_through(folder.path(), &["--start", from, "--end", to]))
    };
    table(&|i| if i == 2 { 9e5 } else { 0.1 * f64::from(i) });
    assert_eq!(part("0.1", "0.4"), [0.1, 0.3, 0.4]);
    table(&|i| if i == 0 { 0.0 } else { 500.0 + 0.1 * f64::from(i) });
    assert_eq!(part("0.05", "0.35"), [500.2, 500.3, 500.4]);
    table(&|i| 0.1 * f64::from(i) - if i > 5 { 0.5 } else { 0.0 });
    assert_eq!(part("0.4", "0.85").len(), 5);
}

#[test]
fn what_is_asked_for_must_be_in_the_recording() {
    let folder = tempdir().unwrap();
    timed_folder(folder.path(), 4);
    let out = folder.path().join("out");
    let run = |more: &[&'static str], words: &[&str]| {
        assert_refused(&[&["run", arg(folder.path()), "--out", arg(&out)], more].concat(), words);
    };
    run(&["--start", "100"], &["ends at 0.30 s", "--start 100"]);
    run(&["--topic", "/cam0"], &["has no topics", "/cam0"]);
    assert_misused(
        &["run", arg(folder.path()), "--out", arg(&out), "--name", &"n".repeat(400)],
        &["a name of 400 bytes", "200 at most"],
    );
    assert_refused(&["record", arg(folder.path()), "--out", "walk.bag"], &["walk.bag", "loopbox convert"]);
    assert_refused(&["export", "no.mcap", "--ply", "o.pcd"], &["--ply does not write .pcd", "--pcd does"]);
    assert_refused(
        &["export", "no.mcap", "--glb", "o.html"],
        &["--glb does not write .html", "--report does"],
    );
    assert!(!out.exists());
}
