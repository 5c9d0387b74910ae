//! A scale that is not carried on ends the map. The recording lies in the folder that `LOOPBOX_DATA` names, by default
//! `shared/data` beside the repository; without it the test counts as skipped.

use crate::support::{Case, Outcome, sequence};
use eval::read_trajectory;
use loopbox_tests::scale::{FoundAt, scale_ratio};
use nalgebra::Vector3;
use std::path::Path;

/// Frames a second of the recording.
const RATE: f64 = 10.0;
/// Seconds between true poses beyond which none lies between them.
const GAP: f64 = 0.6;

/// Times and positions.
fn positions(path: &Path) -> Vec<(f64, Vector3<f64>)> {
    let trajectory = read_trajectory(path).expect("a trajectory");
    let times = trajectory.timestamps.expect("with times");
    times.into_iter().zip(trajectory.world_from_camera.iter().map(|pose| pose.translation)).collect()
}

/// The true position at a time, between those around it.
fn position(truth: &[(f64, Vector3<f64>)], time: f64) -> Option<Vector3<f64>> {
    let next = truth.partition_point(|(at, _)| *at < time);
    let ((before, from), (after, to)) = (truth.get(next.checked_sub(1)?)?, truth.get(next)?);
    (after - before < GAP).then(|| from + (to - from) * ((time - before) / (after - before)))
}

/// From half a second on the robot's scale falls to a thirtieth as it turns on the spot; what the matches there tell, they tell by chance.
#[test]
fn a_robot_whose_scale_is_not_carried_on_leaves_maps_that_keep_theirs() {
    let Some(folder) = sequence("robot_office") else { return };
    let case = Case::empty();
    let outcome = Outcome::of(case.command_on(&folder, &["--start", "0.5"]));
    outcome.assert_success();
    outcome.assert_says(&["scale is not carried on at frame"]);
    let record = std::fs::read_to_string(case.out().join("run.json")).expect("the run wrote its record");
    let record: serde_json::Value = serde_json::from_str(&record).expect("it is JSON");
    assert!(record["frames"]["scale_breaks"].as_u64() >= Some(1), "{}", record["frames"]);
    let fragments = record["fragments"].as_array().expect("fragments");
    assert!(fragments.iter().any(|one| one["scale_break"]["points"].is_u64()), "{fragments:?}");
    let truth = positions(&folder.join("groundtruth.txt"));
    for fragment in fragments {
        let path = case.out().join(fragment["trajectory"].as_str().expect("its file"));
        let found = |(time, found)| Some(FoundAt { time, found, truth: position(&truth, time)? });
        let frames: Vec<FoundAt> = positions(&path).into_iter().filter_map(found).collect();
        let ratio = scale_ratio(&frames, RATE);
        assert!(ratio.is_none_or(|ratio| ratio < 2.5), "{ratio:?} of {fragment}");
    }
}
