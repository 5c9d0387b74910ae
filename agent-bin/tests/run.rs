//! Whole runs on the recording that lies in the repository, and what can go wrong with them.

mod common;
#[path = "common/documented.rs"]
mod documented;

use common::*;
use documented::assert_documented;
use std::path::Path;
use std::process::Stdio;
use tempfile::tempdir;

/// Enough of the recording to start and make keyframes.
const PART: &[&str] = &["--end", "2.5"];

fn run(out: &Path, more: &[&str]) -> std::process::Output {
    let source = demo();
    loopbox(&[&["run", arg(&source), "--out", arg(out)], PART, more].concat())
}

fn lines(path: &Path) -> usize {
    std::fs::read_to_string(path).unwrap().lines().filter(|line| !line.starts_with('#')).count()
}

#[test]
fn a_run_leaves_all_its_results() {
    let out = tempdir().unwrap();
    let folder = out.path().join("new/folder");
    let output = run(&folder, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("frames tracked"), "{}", stdout(&output));
    let numbers = numbers(&folder);
    let tracked = numbers["frames"]["tracked"].as_u64().unwrap();
    assert!(numbers["frames"]["tracked_share"].as_f64().unwrap() > 0.9, "{}", numbers["frames"]);
    assert!(numbers["cost"]["peak_memory_bytes"].as_u64().unwrap() > 1 << 20);
    assert_eq!(lines(&folder.join("trajectory.txt")) as u64, tracked);
    // The first frames have no pose yet when they come.
    let handed_out = lines(&folder.join("trajectory-live.txt")) as u64;
    assert!((tracked - 10..=tracked).contains(&handed_out), "{handed_out} of {tracked}");
    let report = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(report.contains("</html>"));
    assert!(std::fs::read(folder.join("cloud.ply")).unwrap().starts_with(b"ply"));
    let printed = loopbox(&["info", arg(&folder.join("map.mcap"))]);
    assert!(stdout(&printed).contains("keyframes"), "{}", stderr(&printed));
    let as_source = loopbox(&["run", arg(&folder.join("map.mcap")), "--out", arg(out.path())]);
    assert!(stderr(&as_source).contains("is a map"), "{}", stderr(&as_source));
}

#[test]
fn two_runs_are_bit_identical_on_any_number_of_threads() {
    let (one, two) = (tempdir().unwrap(), tempdir().unwrap());
    assert!(run(one.path(), &["--quiet", "--threads", "1"]).status.success());
    assert!(run(two.path(), &["--quiet", "--threads", "3"]).status.success());
    for name in ["trajectory.txt", "map.mcap", "cloud.ply"] {
        let of = |out: &Path| std::fs::read(out.join(name)).unwrap();
        assert!(of(one.path()) == of(two.path()), "{name} differs");
    }
}

#[test]
fn the_log_is_json_and_quiet_is_quiet() {
    let out = tempdir().unwrap();
    let output = run(out.path(), &["--log", "json", "--trajectory", "kitti"]);
    let events: Vec<serde_json::Value> =
        stdout(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(events.last().unwrap()["event"], "end");
    assert!(events.iter().any(|event| event["event"] == "frame" && event["frame"]["state"] == "tracking"));
    let trajectory = std::fs::read_to_string(out.path().join("trajectory.txt")).unwrap();
    assert_eq!(trajectory.lines().next().unwrap().split(' ').count(), 12);
    let output = run(out.path(), &["--quiet"]);
    assert_eq!((stdout(&output), stderr(&output)), (String::new(), String::new()));
}

#[test]
fn the_numbers_are_one_json_object_on_standard_output() {
    let out = tempdir().unwrap();
    let output = run(out.path(), &["--json"]);
    let printed: serde_json::Value = serde_json::from_str(&stdout(&output)).expect("one object");
    let mut expected = numbers(out.path());
    let fields = expected.as_object_mut().unwrap();
    assert!(fields.remove("rows").is_some_and(|rows| !rows.as_array().unwrap().is_empty()));
    fields.insert("out".into(), out.path().display().to_string().into());
    assert_eq!(printed, expected);
    let output = run(out.path(), &["--json", "--quiet"]);
    assert_eq!((stdout(&output).lines().next(), stderr(&output)), (Some("{"), String::new()));
}

#[test]
fn in_real_time_every_frame_is_processed_or_counted_as_dropped() {
    let out = tempdir().unwrap();
    // Far faster than any machine tracks. Too few frames may be left to make a map, and that is no error here.
    run(out.path(), &["--quiet", "--realtime", "--speed", "50"]);
    let frames = &numbers(out.path())["frames"];
    let of = |key: &str| frames[key].as_u64().unwrap();
    assert_eq!(of("processed") + of("dropped_late"), of("offered"));
    assert!(of("dropped_late") > 0, "{frames}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_saves() {
    let out = tempdir().unwrap();
    let source = demo();
    // In real time the whole recording takes seconds; it is stopped once there is a map.
    let mut child = command()
        .args(["run", arg(&source), "--out", arg(out.path()), "--realtime", "--log", "json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut events = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    assert!(events.any(|line| line.unwrap().contains("\"state\":\"tracking\"")), "tracking begins");
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let rest: Vec<String> = events.map(Result::unwrap).collect();
    assert!(child.wait().unwrap().success());
    assert!(rest.last().unwrap().contains("\"interrupted\":true"), "{rest:?}");
    assert!(lines(&out.path().join("trajectory.txt")) > 0);
}

#[cfg(unix)]
#[test]
fn a_killed_run_leaves_a_map_that_loads() {
    let out = tempdir().unwrap();
    let source = demo();
    let mut child = command()
        .args(["run", arg(&source), "--out", arg(out.path()), "--log", "json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut events = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().unwrap()));
    assert!(events.by_ref().filter(|line| line.as_ref().unwrap().contains("\"tracking\"")).nth(3).is_some());
    child.kill().unwrap();
    child.wait().unwrap();
    let printed = loopbox(&["info", arg(&out.path().join("map.mcap")), "--json"]);
    assert!(printed.status.success(), "{}", stderr(&printed));
}

#[test]
fn what_cannot_be_tracked_is_reported() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    timed_folder(folder.path(), 5);
    let black = image::GrayImage::new(WIDTH, HEIGHT);
    (0..5).for_each(|i| black.save(folder.path().join(format!("images/{i:06}.png"))).unwrap());
    let args = ["run", arg(folder.path()), "--out", arg(out.path())];
    assert_refused(&args, &["no frame could be tracked", "black"]);
    (0..5).for_each(|i| picture(0).save(folder.path().join(format!("images/{i:06}.png"))).unwrap());
    assert_refused(&args, &["did not move"]);
    // Without a calibration it is not the lens that is to blame.
    std::fs::remove_file(folder.path().join("camera.yaml")).unwrap();
    assert_refused(&args, &["no calibration came with this recording", "did not move"]);
    assert!(!out.path().join("map.mcap").exists());
}

#[test]
fn bad_folders_and_calibrations_are_reported() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    let args = ["run", arg(folder.path()), "--out", arg(out.path())];
    assert_refused(&args, &["no recording here", "times.txt", "rgb.txt", "mav0"]);
    timed_folder(folder.path(), 2);
    write(folder.path().join("camera.yaml"), CAMERA.replace("fx: 80.0", "fx: nan"));
    assert_refused(&args, &["camera.yaml", "fx"]);
    write(folder.path().join("camera.yaml"), CAMERA.replace("cy: 31.5\n", ""));
    assert_refused(&args, &["camera.yaml", "cy"]);
    write(folder.path().join("camera.yaml"), CAMERA);
    write(folder.path().join("times.txt"), "0.0 images/000000.png\nx images/000001.png\n");
    assert_refused(&args, &["times.txt", "line 2"]);
    write(folder.path().join("times.txt"), "");
    assert_refused(&args, &["times.txt", "no images"]);
    timed_folder(folder.path(), 2);
    let file = out.path().join("file");
    write(file.clone(), "");
    assert_refused(&["run", arg(folder.path()), "--out", arg(&file)], &["file", "--out"]);
}

/// Halving loses the last column and row of such images: the mask is still that of the whole ones.
#[test]
fn a_mask_is_of_the_images_before_they_are_halved() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    let (width, height) = (2 * WIDTH + 1, 2 * HEIGHT + 1);
    timed_folder(folder.path(), 3);
    let camera = CAMERA.replace("width: 96", &format!("width: {width}"));
    write(folder.path().join("camera.yaml"), camera.replace("height: 64", &format!("height: {height}")));
    let large = image::imageops::resize(&picture(0), width, height, image::imageops::FilterType::Triangle);
    (0..3).for_each(|i| large.save(folder.path().join(format!("images/{i:06}.png"))).unwrap());
    let mask = folder.path().join("mask.png");
    image::GrayImage::from_pixel(width, height, image::Luma([255])).save(&mask).unwrap();
    let args =
        ["run", arg(folder.path()), "--out", arg(out.path()), "--max-width", "100", "--mask", arg(&mask)];
    assert_refused(&args, &["did not move"]);
}

#[test]
fn what_a_mask_covers_is_left_out_and_reported() {
    let out = tempdir().unwrap();
    let (folder, file) = (out.path().join("masked"), out.path().join("mask.pgm"));
    let draw = |width: usize, height: usize| {
        let row = (0..width).map(|x| if x < width / 4 { 0 } else { 255 });
        let head = format!("P5\n{width} {height}\n255\n").into_bytes();
        std::fs::write(&file, [head, row.collect::<Vec<u8>>().repeat(height)].concat()).unwrap();
    };
    draw(640, 480);
    let output = run(&folder, &["--mask", arg(&file)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("25.0 % of the image is not used, by the mask"), "{}", stdout(&output));
    let numbers = numbers(&folder);
    assert_documented(&numbers);
    assert_eq!((&numbers["left_out"]["share"], &numbers["left_out"]["found"]), (&0.25.into(), &0.0.into()));
    assert!(numbers["frames"]["tracked_share"].as_f64().unwrap() > 0.9, "{}", numbers["frames"]);
    let map = map::load_map(folder.join("map.mcap")).unwrap().map;
    for keyframe in map.keyframes.values() {
        assert!(keyframe.points.iter().all(|point| point.pixel[0] >= 160.0), "{:?}", keyframe.id);
        assert!(keyframe.semi_dense.iter().all(|depth| depth.0 % 640 >= 160), "{:?}", keyframe.id);
    }
    assert!(std::fs::read_to_string(folder.join("report.html")).unwrap().contains("of the image not used"));
    draw(320, 240);
    let refused = run(&folder, &["--mask", arg(&file)]);
    let printed = stderr(&refused);
    assert!(
        ["mask.pgm", "320×240", "640×480", "hint: draw"].iter().all(|part| printed.contains(part)),
        "{printed}"
    );
}

#[test]
fn parameters_are_checked_and_the_printed_ones_work() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    timed_folder(folder.path(), 2);
    let params = folder.path().join("params.toml");
    write(params.clone(), loopbox(&["params"]).stdout);
    read_through(folder.path(), &["--params", arg(&params)]);
    write(params.clone(), "[track]\nno_such_key = 1\n");
    let args = ["run", arg(folder.path()), "--out", arg(out.path()), "--params", arg(&params)];
    assert_refused(&args, &["params.toml", "no_such_key", "loopbox params"]);
}

#[test]
fn wrong_usage_has_its_own_status() {
    assert_eq!(loopbox(&["run"]).status.code(), Some(2));
    assert_eq!(loopbox(&["walk"]).status.code(), Some(2));
    assert_eq!(loopbox(&["--version"]).status.code(), Some(0));
}

/// Before anything is written.
#[cfg(not(feature = "ros2"))]
#[test]
fn a_program_without_zenoh_says_how_to_get_it() {
    let folder = tempdir().unwrap();
    let out = folder.path().join("out");
    assert_misused(
        &["run", arg(&demo()), "--out", arg(&out), "--ros2"],
        &["built without zenoh", "--features ros2", "loopbox export"],
    );
    assert!(!out.exists());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named_in_the_error() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    timed_folder(folder.path(), 2);
    std::os::unix::fs::symlink("/dev/full", out.path().join("run.json.tmp")).unwrap();
    assert_refused(
        &["run", arg(folder.path()), "--out", arg(out.path())],
        &["cannot be written", "No space left"],
    );
}

#[test]
fn a_repeated_run_is_compared_with_the_truth() {
    let out = tempdir().unwrap();
    let output = run(out.path(), &["--repeat", "2", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("ATE rmse"), "{}", stdout(&output));
    assert_eq!(std::fs::read_to_string(out.path().join("runs.csv")).unwrap().lines().count(), 3);
    let first = |run: &str| {
        let text = std::fs::read_to_string(out.path().join(run).join("trajectory.txt")).unwrap();
        text.lines().find(|line| !line.starts_with('#')).unwrap().split(' ').next().unwrap().to_owned()
    };
    assert_ne!(first("1"), first("2"), "they begin with other frames");
    for others in [["--view=0"].as_slice(), &["--continue", "map.mcap"], &["--open"]] {
        let refused = run(out.path(), &[&["--repeat", "2"], others].concat());
        assert_eq!(refused.status.code(), Some(2), "{others:?}: {}", stderr(&refused));
    }
}
