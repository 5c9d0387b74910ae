//! Runs in a common map: poses told in it, and one more agent that extends it.

use crate::support::{Case, Runs, arg, loopbox};
use eval::{AgentTracks, Options, evaluate_agents, read_trajectory};
use geometry::Se3;
use loopbox_tests::{Encoding, Recording, World, trajectory};
use map::Map;
use nalgebra::Vector3;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// What the error of a third recording may be whose poses are told in the world of the first agent, in parts of its path,
/// after aligning that agent. Reached is 0.0011.
const ERROR_SHARE: f64 = 0.004;

/// `left` and `right` in one map.
fn common(case: &Case) -> PathBuf {
    let runs = Runs::get();
    case.merge(&[&runs.run("left"), &runs.run("right")]).assert_success();
    case.out()
}

/// A third recording, past the middle that `left` and `right` share, not on the line of either.
fn third(case: &Case, camera: geometry::Pinhole) -> PathBuf {
    let aside = Vector3::new(0.0, 0.05, -0.15);
    let path = &trajectory::sideways(180, 8.1)[40..140];
    let path: Vec<Se3> =
        path.iter().step_by(2).map(|pose| Se3::new(pose.rotation, pose.translation + aside)).collect();
    let folder = case.path("third");
    let recording = Recording::render(&World::yard(1), camera, &path, 15.0);
    recording.write(&folder, Encoding::Png).expect("the temporary folder takes the recording");
    folder
}

/// A recording that goes from the middle back and up, where nobody was.
fn departure(case: &Case) -> PathBuf {
    let path = &trajectory::sideways(180, 8.1)[60..130];
    let away = |(i, pose): (usize, &Se3)| {
        let drive_back = Vector3::new(0.0, -0.004, -0.014) * i as f64;
        Se3::new(pose.rotation, pose.translation + drive_back)
    };
    let path: Vec<Se3> = path.iter().enumerate().map(away).collect();
    let folder = case.path("leaving");
    let recording = Recording::render(&World::yard(1), Recording::SMALL_CAMERA, &path, 30.0);
    recording.write(&folder, Encoding::Png).expect("the temporary folder takes the recording");
    folder
}

/// Fails unless the poses of a recording lie right in the world of the first agent of the common map.
fn assert_right(trajectory: &Path, recording: &Path, common: &Path) {
    let track = |estimate: &Path, truth: &Path| AgentTracks {
        estimate: read_trajectory(estimate).expect("it was written"),
        truth: read_trajectory(truth).expect("it was written"),
        frames: None,
    };
    let left = track(&common.join("trajectory-left.txt"), &Runs::get().truth("left"));
    let third = track(trajectory, &recording.join("groundtruth.txt"));
    let found = evaluate_agents(vec![left, third], &Options::default()).expect("the trajectories match");
    let error = found.agents[1].evaluation.ate.rmse;
    eprintln!("error of the third recording {error:.4} m");
    assert!(error <= ERROR_SHARE * 4.5, "{error} m");
}

fn numbers(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("run.json")).expect("it was written")).expect("it is JSON")
}

#[test]
fn poses_are_reported_in_a_common_map_that_stays_as_it_is() {
    let case = Case::new();
    let common = common(&case);
    let third = third(&case, Recording::SMALL_CAMERA);
    let bytes = fs::read(common.join("map.mcap")).expect("it was written");
    let out = case.path("poses");
    let outcome = loopbox(&["run", arg(&third), "--localise", arg(&common), "--out", arg(&out), "--quiet"]);
    outcome.assert_success();
    assert!(bytes == fs::read(common.join("map.mcap")).expect("it is there"), "the map stays as it is");
    assert_right(&out.join("trajectory.txt"), &third, &common);
    let record = numbers(&out);
    assert!(record["frames"]["tracked"].as_u64() >= Some(49), "{}", record["frames"]);
    assert_eq!(record["resumed"]["agents"], serde_json::json!(["left", "right"]));
    assert_eq!(record["resumed"]["localised_only"], true);
}

#[test]
fn a_common_map_is_extended_by_one_more_agent() {
    let case = Case::new();
    let (common, departure) = (common(&case), departure(&case));
    let (kept, out) = (fs::read(common.join("map.mcap")).expect("it was written"), case.path("extended"));
    let go_on = |map: &Path, options: &[&str]| {
        let args = ["run", arg(&departure), "--continue", arg(map), "--out", arg(&out), "--quiet"];
        loopbox(&[&args, options].concat())
    };
    go_on(&common, &[]).assert_success();
    assert!(kept == fs::read(common.join("map.mcap")).expect("it is there"), "the map before stays");
    assert_right(&out.join("trajectory.txt"), &departure, &common);
    let record = numbers(&out);
    assert_eq!((&record["frames"]["tracked"], &record["frames"]["tracked_share"]), (&70.into(), &1.0.into()));
    let load = |folder: &Path| map::load_map(folder.join("map.mcap")).expect("it loads").map;
    let (before, map) = (load(&common), load(&out));
    let names: Vec<&str> = map.agents.values().map(|info| &*info.name).collect();
    assert_eq!(names, ["left", "right", "leaving"]);
    let [.., own] = &map.split()[..] else { panic!("there are agents") };
    assert!(map.split()[..2] == before.split(), "of the others nothing but poses changes");
    assert_eq!((own.frames.len(), own.frames[0].frame_index), (70, 0));
    assert_eq!(map.merge_provenance.get("joined 1: agent").map(String::as_str), Some("leaving"));
    let first = map.find(map::KeyframeName {
        agent: own.agents[&map::AgentId(0)].identity.expect("it has one"),
        number: 0,
    });
    assert_eq!(first.map(|id| map.keyframes[&id].agent), Some(map::AgentId(2)), "its keyframes have names");
    // The same again gives the same, to the last bit.
    let bytes = fs::read(out.join("map.mcap")).expect("it is there");
    go_on(&common, &["--threads", "1"]).assert_success();
    assert!(bytes == fs::read(out.join("map.mcap")).expect("it is there"));
    // Whose map is in it already cannot come again, and the results so far stay.
    let extended = case.path("extended before");
    fs::rename(&out, &extended).expect("it can be moved");
    go_on(&extended, &[]).assert_refused(&["this very recording", "--localise"]);
    assert!(!out.join("map.mcap").exists());
    // What joins the new agent to the others is like what a merge finds: without left it hangs on right.
    let apart = case.path("apart");
    let unmerge =
        |options: &[&str]| loopbox(&[&["unmerge", arg(&extended), "--out", arg(&apart)], options].concat());
    unmerge(&["--between", "left", "leaving"]).assert_success();
    assert_eq!(load(&apart).agents.len(), 3);
    unmerge(&["--force"]).assert_success();
    assert!(load(&apart.join("left")) == Runs::get().map("left"));
    assert!(load(&apart.join("leaving")) == *own);
}

#[test]
fn a_common_map_that_is_not_of_the_camera_of_the_images_is_refused() {
    let case = Case::new();
    let runs = Runs::get();
    let mut wide = Recording::SMALL_CAMERA;
    wide.fx *= 0.9;
    let third = third(&case, wide);
    let localise = |map: &Path| {
        loopbox(&["run", arg(&third), "--localise", arg(map), "--out", arg(&case.path("poses")), "--quiet"])
    };
    let (left, mut right) = (runs.map("left"), runs.map("right"));
    right.agents.values_mut().for_each(|about| about.sensor = wide.into());
    let map = case.map("two cameras.mcap", &Map::unite(vec![left.clone(), right]).expect("two agents"));
    localise(&map).assert_refused(&["the part of left in it was made with a camera of 320 × 240", "--calib"]);
    let rover = Map::of(map::AgentInfo::new("rover", map::Sensor::Lidar));
    let map = case.map("both.mcap", &Map::unite(vec![left, rover]).expect("two agents"));
    localise(&map).assert_refused(&["agent \"rover\" has a LiDAR", "unmerge"]);
}
