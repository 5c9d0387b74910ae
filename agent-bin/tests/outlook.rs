//! What is said of recordings before they are run, and which calibration is used.

mod common;

use common::{arg, loopbox, stderr, stdout, write};
use loopbox_tests::lidar::{HALL, SIXTEEN, Turning, sweep_turning, walk};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// What the program says on standard output and standard error; its exit code must be this.
#[track_caller]
fn printed(code: i32, words: &[&str]) -> (String, String) {
    let output = loopbox(words);
    let printed = (stdout(&output), stderr(&output));
    assert_eq!(output.status.code(), Some(code), "{words:?}\n{}\n{}", printed.0, printed.1);
    printed
}

#[track_caller]
fn info(path: &Path) -> Value {
    serde_json::from_str(&printed(0, &["info", arg(path), "--json"]).0).unwrap()
}

fn image() -> Vec<u8> {
    let mut bytes = Vec::new();
    let image = image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * 3 + y * 5) as u8]));
    image.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    bytes
}

/// A folder of images with times and this calibration.
fn images(folder: &Path, calibration: &str) {
    fs::create_dir_all(folder.join("images")).unwrap();
    let mut times = String::new();
    for i in 0..6 {
        write(folder.join(format!("images/{i}.png")), image());
        times += &format!("{} images/{i}.png\n", 0.1 * f64::from(i));
    }
    write(folder.join("times.txt"), times);
    write(folder.join("camera.yaml"), calibration);
}

const CAMERA: &str = "model: pinhole\nwidth: 64\nheight: 48\nfx: 60\nfy: 60\ncx: 31\ncy: 23\n";

#[test]
fn info_and_check_say_the_same_calibration() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), CAMERA);
    write(folder.path().join("cloud.ply"), "ply\n");
    let reported = info(folder.path());
    assert!(reported["calibration"].as_str().unwrap().ends_with("camera.yaml"), "{reported}");
    assert_eq!((&reported["camera"]["fx"], &reported["camera"]["model"]), (&60.0.into(), &"pinhole".into()));
    assert_eq!(reported["frames"], 6, "a cloud beside images is no LiDAR's recording: {reported}");
    let (checked, _) = printed(0, &["run", arg(folder.path()), "--check"]);
    assert_eq!(checked, printed(0, &["info", arg(folder.path())]).0);
    let (checked, _) = printed(0, &["run", arg(folder.path()), "--check", "--calib", "none"]);
    assert!(checked.contains("lens         a run finds it from the images"), "{checked}");
    let (checked, _) = printed(0, &["run", arg(folder.path()), "--check", "--fov", "70"]);
    assert!(checked.contains("begun with a view of 70°"), "{checked}");
    let wrong = folder.path().join("wrong.yaml");
    write(wrong.clone(), CAMERA.replace("width: 64", "width: 128"));
    let (checked, refusal) =
        printed(1, &["run", arg(folder.path()), "--check", "--calib", arg(&wrong), "--log", "json"]);
    let checked: Value = serde_json::from_str(&checked).unwrap();
    assert!(checked["refused"].as_str().unwrap().contains("128×48"), "{checked}");
    assert!(refusal.contains("a run is refused: the calibration is for images of 128×48"), "{refusal}");
}

#[test]
fn a_file_of_two_cameras_is_not_guessed_from() {
    let folder = tempfile::tempdir().unwrap();
    let cam = |index: usize, fx: f64| {
        format!(
            "cam{index}:\n  camera_model: pinhole\n  distortion_coeffs: []\n  distortion_model: none\n  \
             intrinsics: [{fx}, 60, 31, 23]\n  resolution: [64, 48]\n  rostopic: /cam{index}/image_raw\n"
        )
    };
    images(folder.path(), &(cam(0, 60.0) + &cam(1, 70.0)));
    let (_, refusal) = printed(1, &["info", arg(folder.path())]);
    assert!(refusal.contains("cam0 of /cam0/image_raw, cam1 of /cam1/image_raw"), "{refusal}");
    let chain = format!("{}:cam1", arg(&folder.path().join("camera.yaml")));
    let (checked, _) = printed(0, &["run", arg(folder.path()), "--check", "--calib", &chain]);
    assert!(checked.contains("fx 70.0"), "{checked}");
    let second = folder.path().join("rig/cam1");
    images(&second, &(cam(0, 60.0) + &cam(1, 70.0)));
    assert_eq!(info(&second)["camera"]["fx"], 70.0);
}

/// What a run would refuse is refused by `info` and `run --check` as well, with the reason, after all that can be said.
#[test]
fn what_a_run_refuses_is_refused_beforehand() {
    for content in
        [&b""[..], b"<html>404</html>", b"version https://git-lfs.github.com/spec/v1\n", &image()[..60]]
    {
        let folder = tempfile::tempdir().unwrap();
        images(folder.path(), CAMERA);
        (0..6).for_each(|i| write(folder.path().join(format!("images/{i}.png")), content));
        let (_, of_run) = printed(1, &["run", arg(folder.path()), "--out", arg(&folder.path().join("out"))]);
        for words in [&["info", arg(folder.path())][..], &["run", arg(folder.path()), "--check"]] {
            let (reported, refusal) = printed(1, words);
            assert!(reported.contains("6 of 6 images cannot be used; the first: "), "{reported}");
            assert!(
                refusal.contains("a run is refused: no image can be read") && refusal.contains("0.png"),
                "{refusal}"
            );
        }
        assert!(of_run.contains("0.png"), "{of_run}");
    }
}

/// Images that are missing or cut off cost themselves, and are told beforehand.
#[test]
fn images_that_cannot_be_used_are_counted_beforehand() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), CAMERA);
    let path = |i: u32| folder.path().join(format!("images/{i}.png"));
    write(path(2), &image()[..image().len() / 2]);
    fs::remove_file(path(4)).unwrap();
    let reported = info(folder.path())["problems"].to_string();
    assert!(
        reported.contains("2 of 6 images cannot be used; the first: ")
            && reported.contains("2.png: the file is cut off"),
        "{reported}"
    );
    write(path(2), image());
    write(path(4), image());
    assert_eq!(info(folder.path())["problems"], serde_json::json!([]));
    let times: String = [0.0, 0.1, 0.2, 7.2, 7.3, 7.4]
        .iter()
        .enumerate()
        .map(|(i, t)| format!("{t} images/{i}.png\r"))
        .collect();
    write(folder.path().join("times.txt"), times);
    let reported = info(folder.path());
    assert_eq!(reported["frames"], 6);
    assert!(reported["facts"].to_string().contains("one of 7.00 s after 0.20 s"), "{reported}");
}

/// A run that finds the lens by itself names the calibrations that it leaves aside.
#[test]
fn a_run_names_the_sidecar_calibration() {
    let folder = tempfile::tempdir().unwrap();
    images(folder.path(), CAMERA);
    fs::rename(folder.path().join("camera.yaml"), folder.path().join("webcam.yaml")).unwrap();
    let named = "webcam.yaml: a calibration that nothing says is this camera's";
    let out = folder.path().join("out");
    let (_, warned) = printed(1, &["run", arg(folder.path()), "--out", arg(&out)]);
    assert!(warned.contains(named) && warned.contains("hint: --calib "), "{warned}");
    for words in [&["info", arg(folder.path())][..], &["run", arg(folder.path()), "--check"]] {
        assert!(printed(0, words).0.contains(named));
    }
    let (_, quiet) = printed(1, &["run", arg(folder.path()), "--out", arg(&out), "--calib", "none"]);
    assert!(!quiet.contains(named), "{quiet}");
}

#[test]
fn a_folder_that_is_no_recording_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("left")).unwrap();
    write(folder.path().join("left/0.png"), image());
    write(folder.path().join("front/0.png"), image());
    write(folder.path().join("0.webp"), "");
    let (_, refusal) = printed(1, &["info", arg(folder.path())]);
    assert!(refusal.contains("it holds front/ (1 images), left/ (1 images), 1 .webp"), "{refusal}");
    assert!(refusal.contains("give that folder or file itself, of front/, left/"), "{refusal}");
}

/// A recording of scans in files of `floats` numbers a point, without times; lengths are `scale` metres.
fn scans(folder: &Path, floats: usize, scale: f32, turning: Turning) -> usize {
    let (pose, _) = walk(&[[-2.0, -6.0], [4.0, -6.0], [4.0, 4.0]]);
    let count = 70;
    for index in 0..count {
        let returns = sweep_turning(&SIXTEEN, &HALL, &pose, f64::from(index) * 0.1, turning);
        let numbers = returns.iter().flat_map(|r| {
            let [x, y, z] = r.point.map(|v| v / scale);
            let more = [(r.ring as f32 * 7.0) % 5.0, f32::from(r.ring), 0.0];
            [x, y, z].into_iter().chain(more).take(floats)
        });
        let bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
        write(folder.join(format!("{index:06}.bin")), bytes);
    }
    count as usize
}

#[test]
fn scans_are_recognised_by_their_numbers() {
    let turning = Turning { counter_clockwise: true, start: 1.6 };
    let (five, three, millimetres) =
        (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    scans(five.path(), 5, 1.0, turning);
    let reported = info(five.path());
    assert!(reported["kind"].as_str().unwrap().contains("ring)"), "{reported}");
    assert_eq!(
        (&reported["points"], &reported["rings"], &reported["point_times"]),
        (&14_400.into(), &16.into(), &true.into())
    );
    assert!(reported["point_times_from"].as_str().unwrap().contains("counter-clockwise"), "{reported}");
    let out = five.path().join("out");
    let (_, warned) = printed(0, &["run", arg(five.path()), "--out", arg(&out)]);
    assert!(
        warned.contains("point times: told from directions by what fits the scans: counter-clockwise"),
        "{warned}"
    );
    let record: Value = serde_json::from_slice(&fs::read(out.join("run.json")).unwrap()).unwrap();
    assert_eq!(record["scans"]["timed"], record["scans"]["tracked"], "{}", record["scans"]);

    scans(three.path(), 3, 1.0, turning);
    let (checked, _) = printed(0, &["run", arg(three.path()), "--check", "--scan-timing", "rigid"]);
    assert!(checked.contains("(x y z)") && checked.contains("undistorted (as given)"), "{checked}");

    scans(millimetres.path(), 4, 0.001, turning);
    // Beyond what is used there is nothing to map, and no success to tell of.
    let (reported, refusal) = printed(1, &["info", arg(millimetres.path())]);
    assert!(
        reported.contains("--scan-unit mm") && refusal.contains("no scan can be used"),
        "{reported}{refusal}"
    );
    let out = millimetres.path().join("out");
    let (_, refusal) = printed(1, &["run", arg(millimetres.path()), "--out", arg(&out)]);
    assert!(refusal.contains("points lie within 100 m") && refusal.contains("--scan-unit mm"), "{refusal}");
    let (checked, _) = printed(0, &["run", arg(millimetres.path()), "--check", "--scan-unit", "mm"]);
    assert!(!checked.contains("problem") && checked.contains("counter-clockwise"), "{checked}");
}
