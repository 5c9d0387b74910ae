//! What becomes of earlier results.

mod common;

use common::*;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use tempfile::tempdir;

/// What a run leaves: map, cloud, report, numbers, and the trajectory as it is in the end and as it was handed out.
const FILES: usize = 6;
const PART: &[&str] = &["--end", "2.5", "--quiet"];

/// All files of a folder and those within it, with what they hold.
fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(content(&path));
        } else {
            found.insert(path.clone(), std::fs::read(&path).unwrap());
        }
    }
    found
}

fn run_demo(out: &Path, more: &[&str]) {
    let source = demo();
    let output = loopbox(&[&["run", arg(&source), "--out", arg(out)], more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
}

/// A run that is under way and has made keyframes.
fn started(out: &Path) -> Child {
    let source = demo();
    let mut child = command()
        .args(["run", arg(&source), "--out", arg(out), "--realtime", "--log", "json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.as_mut().unwrap()).lines();
    let tracked = lines.filter(|line| line.as_ref().unwrap().contains("\"tracking\"")).nth(2);
    assert!(tracked.is_some(), "it tracks");
    child
}

#[test]
fn a_run_that_fails_keeps_the_earlier_results() {
    let (room, other) = (tempdir().unwrap(), tempdir().unwrap());
    let out = room.path().join("out");
    run_demo(&out, PART);
    let before = content(&out);
    assert_eq!(before.len(), FILES, "{:?}", before.keys());
    let source = demo();
    let fails = |more: &[&str], words: &[&str]| {
        assert_refused(&[&["run", arg(&source), "--out", arg(&out)], more].concat(), words);
        assert!(content(&out) == before, "{:?}", content(&out).keys());
    };
    fails(&["--start", "100"], &["it ends at", "--start 100"]);
    let calibration = other.path().join("camera.yaml");
    write(calibration.clone(), CAMERA);
    fails(&["--calib", arg(&calibration)], &["no frame could be tracked: the image is", "96×64"]);
    timed_folder(other.path(), 3);
    let another = ["run", arg(other.path()), "--out", arg(&out)];
    assert_refused(&another, &["holds the results of a run over", "--force"]);
    assert_refused(&[&another[..], &["--force"]].concat(), &["no frame could be tracked"]);
    assert!(content(&out) == before);
}

#[test]
fn a_killed_run_keeps_the_earlier_results_and_leaves_its_own_next_to_them() {
    let room = tempdir().unwrap();
    let out = room.path().join("out");
    run_demo(&out, PART);
    let before = content(&out);
    let mut child = started(&out);
    assert_refused(
        &["run", arg(&demo()), "--out", arg(&out)],
        &["another loopbox is writing its results there"],
    );
    child.kill().unwrap();
    child.wait().unwrap();
    let after = content(&out);
    assert!(before.iter().all(|(path, bytes)| after.get(path) == Some(bytes)), "{:?}", after.keys());
    let left = out.join("unfinished/map.mcap");
    assert!(after.contains_key(&left), "{:?}", after.keys());
    let printed = loopbox(&["info", arg(&out)]);
    assert!(stdout(&printed).contains("keyframes") && stderr(&printed).contains("unfinished/map.mcap"));
    assert!(loopbox(&["info", arg(&left)]).status.success());
    run_demo(&out, PART);
    assert_eq!(content(&out).len(), FILES, "{:?}", content(&out).keys());
}

#[test]
fn nobody_who_listens_can_end_a_run() {
    let out = tempdir().unwrap();
    let source = demo();
    let mut child = command()
        .args(["run", arg(&source), "--out", arg(out.path()), "--end", "2.5"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // As `| head -0` does.
    drop((child.stdout.take(), child.stderr.take()));
    assert!(child.wait().unwrap().success());
    assert_eq!(content(out.path()).len(), FILES);
}

#[test]
fn too_little_tracked_has_its_own_status() {
    let (out, source) = (tempdir().unwrap(), tempdir().unwrap());
    let source = source.path();
    for (path, bytes) in content(&demo()) {
        let copy = source.join(path.strip_prefix(demo()).unwrap());
        std::fs::create_dir_all(copy.parent().unwrap()).unwrap();
        write(copy, bytes);
    }
    write(source.join("images/000020.jpg"), "no image");
    let status = |share: &str| {
        let args = ["run", arg(source), "--out", arg(out.path()), "--min-tracked", share];
        let output = loopbox(&[&args[..], PART].concat());
        (output.status.code(), stderr(&output))
    };
    assert_eq!(status("0.5").0, Some(0));
    let (code, message) = status("1");
    assert!(code == Some(4) && message.contains("--min-tracked"), "{code:?} {message}");
    assert!(out.path().join("map.mcap").is_file());
    assert_eq!(status("2").0, Some(2));
}

#[test]
fn warnings_come_three_times_and_are_counted() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    timed_folder(folder.path(), 9);
    (1..8).for_each(|i| write(folder.path().join(format!("images/{i:06}.png")), "no image"));
    let output = loopbox(&["run", arg(folder.path()), "--out", arg(out.path())]);
    assert_eq!(stderr(&output).matches("is skipped: ").count(), 3, "{}", stderr(&output));
    assert_eq!(numbers(out.path())["frames"]["skipped"]["unreadable"], 7);
}

#[test]
fn a_calibration_for_another_size_ends_the_run_or_is_scaled() {
    let (folder, out) = (tempdir().unwrap(), tempdir().unwrap());
    timed_folder(folder.path(), 9);
    let larger = CAMERA.replace("96", "192").replace("64", "128").replace("80.0", "160.0");
    write(folder.path().join("camera.yaml"), larger.replace("47.5", "95.5").replace("31.5", "63.5"));
    let args = ["run", arg(folder.path()), "--out", arg(out.path())];
    let output = loopbox(&args);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1));
    assert!(message.contains("96×64") && message.contains("192×128"), "{message}");
    assert!(message.contains("--scale-calib") && !message.contains("is skipped"), "{message}");
    let scaled = read_through(folder.path(), &["--scale-calib"]);
    let camera = &scaled["camera"];
    assert_eq!((&camera["fx"], &camera["cx"], &camera["width"]), (&80.0.into(), &47.5.into(), &96.into()));
}

#[test]
fn text_is_no_video_and_what_will_fail_is_reported() {
    let folder = tempdir().unwrap();
    let text = folder.path().join("groundtruth.txt");
    write(text.clone(), "# a trajectory\n0.0 0 0 0 0 0 0 1\n");
    assert_refused(&["info", arg(&text)], &["this is text", "loopbox eval"]);
    timed_folder(folder.path(), 4);
    let stamps = ["1700000000066667000", "1700000000133333000", "1700000000200000000", "1700000000266667000"];
    let rows = stamps.iter().enumerate().map(|(i, t)| format!("{t} images/{i:06}.png\n"));
    write(folder.path().join("times.txt"), rows.collect::<String>());
    let printed = info(folder.path(), &[]);
    assert!(
        printed["facts"].to_string().contains("in nanoseconds, by their steps: 15.0000 a second"),
        "{printed}"
    );
    assert!((printed["duration_s"].as_f64().unwrap() - 0.2).abs() < 1e-5, "{printed}");
    write(folder.path().join("camera.yaml"), CAMERA.replace("80.0", "8.0"));
    let out = tempdir().unwrap();
    let output = loopbox(&["run", arg(folder.path()), "--out", arg(out.path())]);
    let message = stderr(&output);
    assert!(message.contains("161° wide"), "{message}");
}
