//! Going on in a map of an earlier run, and telling poses in it.

use crate::support::{Case, Outcome, drive, loopbox, restamped, world};
use loopbox_tests::{Encoding, Recording, World, trajectory};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A part of the recording, in a folder beside it, with its own times.
fn part(case: &Case, name: &str, frames: std::ops::Range<usize>) -> PathBuf {
    let recording = drive();
    let part = Recording { shots: recording.shots[frames].to_vec(), ..recording };
    write(case, name, &part)
}

fn write(case: &Case, name: &str, recording: &Recording) -> PathBuf {
    let folder = case.source().with_file_name(name);
    recording.write(&folder, Encoding::Png).expect("the temporary folder takes the recording");
    folder
}

fn run(source: &Path, out: &Path, arguments: &[&str]) -> Outcome {
    Outcome::of(command(source, out, arguments))
}

fn command(source: &Path, out: &Path, arguments: &[&str]) -> Command {
    let mut command = loopbox();
    command.arg("run").arg(source).arg("--out").arg(out).args(arguments);
    command
}

fn text(path: &Path) -> &str {
    path.to_str().expect("the path is text")
}

#[test]
fn a_run_continues_a_map_and_extends_it() {
    let case = Case::new(&drive());
    let (first, second) = (part(&case, "first", 0..50), part(&case, "second", 50..90));
    let kept = case.source().with_file_name("kept");
    run(&first, &kept, &[]).assert_success();
    let before = map::load_map(kept.join("map.mcap")).expect("it was written").map;
    let bytes = fs::read(kept.join("map.mcap")).expect("it is there");
    let outcome = run(&second, &case.out(), &["--continue", text(&kept)]);
    case.assert_mapped(&outcome, 0);

    let map = case.map();
    assert_eq!(bytes, fs::read(kept.join("map.mcap")).expect("it is there"), "the earlier map stays");
    assert!(map.keyframes.len() > before.keyframes.len());
    let info = |map: &map::Map| map.agents[&map::AgentId(0)].clone();
    assert_eq!(info(&map).identity, info(&before).identity, "keyframes keep their names");
    let reported = |key: &str| info(&map).provenance.get(key).cloned().unwrap_or_default();
    assert!(
        reported("source").ends_with("first") && reported("continued 1: source").ends_with("second"),
        "{map:?}"
    );
    assert_eq!(reported("continued 1: first keyframe"), before.keyframes.len().to_string());
    let record = fs::read_to_string(case.out().join("run.json")).expect("it was written");
    let record: serde_json::Value = serde_json::from_str(&record).expect("it is JSON");
    assert_eq!(record["frames"]["tracked"], 40, "of this run");
    assert_eq!(record["frames"]["tracked_share"], 1.0);
    assert_eq!(record["resumed"]["frames"], 50);
    // The same again gives the same, to the last bit.
    let bytes = fs::read(case.out().join("map.mcap")).expect("it is there");
    run(&second, &case.out(), &["--continue", text(&kept.join("map.mcap")), "--threads", "1"])
        .assert_success();
    assert!(bytes == fs::read(case.out().join("map.mcap")).expect("it is there"));
}

#[test]
fn poses_are_reported_in_a_map_that_stays_as_it_is() {
    let case = Case::new(&drive());
    let kept = case.source().with_file_name("kept");
    run(&case.source(), &kept, &[]).assert_success();
    let later = part(&case, "later", 30..90);
    let outcome = run(&later, &case.out(), &["--localise", text(&kept)]);
    outcome.assert_success();
    let names: Vec<_> =
        fs::read_dir(case.out()).expect("it was made").flatten().map(|e| e.file_name()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
    let poses =
        |folder: &Path| eval::read_trajectory(&folder.join("trajectory.txt")).expect("it was written");
    let (found, known) = (poses(&case.out()), poses(&kept));
    assert_eq!((found.len(), known.len()), (60, 90));
    let depth = 5.0;
    for (found, known) in found.world_from_camera.iter().zip(&known.world_from_camera[30..]) {
        let off = (found.translation - known.translation).norm();
        assert!(off < 0.01 * depth, "off by {off} map units");
    }
    // Results beside the map would take its place.
    let outcome = run(&later, &kept, &["--localise", text(&kept), "--force"]);
    outcome.assert_refused(&["which is to stay", "--out"]);
    assert!(kept.join("map.mcap").is_file());
}

#[test]
fn a_recording_of_another_place_is_a_map_of_its_own() {
    let case = Case::new(&drive());
    let kept = case.source().with_file_name("kept");
    run(&case.source(), &kept, &[]).assert_success();
    let path = trajectory::sideways(60, 3.0);
    let elsewhere = Recording::render(&World::yard(2), Recording::SMALL_CAMERA, &path, 30.0);
    let elsewhere = write(&case, "elsewhere", &restamped(elsewhere));
    let outcome = run(&elsewhere, &case.out(), &["--continue", text(&kept)]);
    outcome.assert_refused(&["no frame was found in", "a map of its own"]);
    let map = case.map();
    assert!(map.frames.len() > 30, "{} frames", map.frames.len());
    let identity = |map: &map::Map| map.agents[&map::AgentId(0)].identity;
    let before = map::load_map(kept.join("map.mcap")).expect("it is there").map;
    assert_ne!(identity(&map), identity(&before));
    let out = case.source().with_file_name("localised");
    run(&elsewhere, &out, &["--localise", text(&kept)])
        .assert_refused(&["no frame could be tracked", "none was found in"]);
}

#[test]
fn a_map_of_another_camera_is_refused_before_the_first_frame() {
    let case = Case::new(&drive());
    let kept = case.source().with_file_name("kept");
    run(&case.source(), &kept, &["--end", "1"]).assert_success();
    let mut other = Recording::SMALL_CAMERA;
    other.fx *= 1.1;
    let recording = Recording::render(world(), other, &trajectory::sideways(3, 0.1), 30.0);
    let other = write(&case, "other", &recording);
    let outcome = run(&other, &case.out(), &["--continue", text(&kept)]);
    outcome.assert_refused(&["was made with a camera of 320 × 240", "--calib"]);
    assert!(!case.out().join("run.json").exists());
    run(&other, &case.out(), &["--continue", text(&other)]).assert_refused(&["there is no map"]);
    run(&other, &case.out(), &["--continue", text(&kept), "--localise", text(&kept)])
        .assert_refused(&["cannot be used with"]);
}
