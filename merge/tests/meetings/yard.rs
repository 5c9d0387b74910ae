//! Recordings of one yard and the maps that agents make of them, each tracked once for all tests.

use geometry::{Se3, umeyama};
use loopbox_tests::{Recording, World, trajectory};
use map::{AgentId, Map};
use nalgebra::{UnitQuaternion, Vector3};
use place_recog::ThumbnailIndex;
use slam_direct::{Agent, Frame, Params};
use std::sync::LazyLock;

/// What an agent saw, and its map on the way and at the end.
pub struct Drive {
    pub recording: Recording,
    /// The map as it stood when three quarters of the frames were in; the agent then went on.
    pub early: Map,
    pub end: Map,
}

/// The yard of all drives.
pub fn yard() -> &'static World {
    static YARD: LazyLock<World> = LazyLock::new(|| World::yard(7));
    &YARD
}

/// To the right past the boxes, x from −2 to 2 m, 5 cm a frame.
pub fn first() -> &'static Drive {
    static DRIVE: LazyLock<Drive> = LazyLock::new(|| track(past(-2.0, 2.0, 0.05, &offset_by(0.0, 0.0))));
    &DRIVE
}

/// The same way, x from −1 to 3.5 m, faster and from farther away.
pub fn second() -> &'static Drive {
    static DRIVE: LazyLock<Drive> = LazyLock::new(|| track(past(-1.0, 3.5, 0.07, &offset_by(-0.4, 0.05))));
    &DRIVE
}

/// The opposite way, x from 0.5 to −3 m, closer and turned away by 10°.
pub fn opposite() -> &'static Drive {
    static DRIVE: LazyLock<Drive> = LazyLock::new(|| track(past(0.5, -3.0, -0.06, &offset_by(0.3, -0.17))));
    &DRIVE
}

/// How a camera differs from that of the first drive: `ahead` metres closer to the boxes, turned right by `yaw`.
fn offset_by(ahead: f64, yaw: f64) -> Se3 {
    Se3::new(UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw), Vector3::new(0.0, -0.05, ahead))
}

/// Poses past the boxes, `step` metres apart.
pub fn past(from: f64, to: f64, step: f64, first_from_camera: &Se3) -> Vec<Se3> {
    let count = ((to - from) / step).round() as usize + 1;
    // The last pose of a symmetric drive of 2 x is the one at x.
    let at = |x: f64| trajectory::sideways(2, 2.0 * x)[1];
    (0..count).map(|i| at(from + step * i as f64) * *first_from_camera).collect()
}

fn track(path: Vec<Se3>) -> Drive {
    let recording = Recording::render(yard(), Recording::SMALL_CAMERA, &path, 20.0);
    let mut params = Params::default();
    // So that the first part of so short a drive has depth.
    params.mapping.depth_delay = 2;
    let mut agent = Agent::new(recording.camera, Box::new(ThumbnailIndex::default()), params).unwrap();
    let mut early = None;
    for (index, shot) in recording.shots.iter().enumerate() {
        if index == recording.shots.len() * 3 / 4 {
            early = Some(agent.snapshot());
        }
        let image = shot.image.as_ref().clone();
        agent.process(Frame { index: index as u64, timestamp: shot.timestamp, image, color: None }).unwrap();
    }
    agent.finish();
    let early = early.expect("a recording has a first part");
    let end = agent.into_map();
    assert!(early.keyframes.len() >= 3 && end.keyframes.len() >= early.keyframes.len() + 2);
    let settled = early.keyframes.values().filter(|keyframe| !keyframe.semi_dense.is_empty()).count();
    println!(
        "{settled} of {} keyframes have depth early, {} at the end",
        early.keyframes.len(),
        end.keyframes.len()
    );
    Drive { recording, early, end }
}

/// Root mean square distance of each agent's frames from the truth, metres, where the first agent *alone* was
/// aligned by a similarity: the others are off by what the merge and their own maps are.
pub fn errors(map: &Map, drives: &[&Drive]) -> Vec<f64> {
    let of_agent = |number: usize| {
        let agent = AgentId(number as u16);
        let own = |reference| map.keyframes.get(reference).is_some_and(|keyframe| keyframe.agent == agent);
        let frames = map.frames.iter().filter(|frame| own(&frame.reference));
        let pair = |frame: &map::FramePose| {
            let truth = drives[number].recording.shots[frame.frame_index as usize].world_from_camera;
            let found = map.world_from_frame(frame).expect("frames have their keyframes");
            (found.translation, truth.translation)
        };
        frames.map(pair).unzip::<_, _, Vec<_>, Vec<_>>()
    };
    let (found, truth) = of_agent(0);
    let truth_from_map = umeyama::sim3(&found, &truth).expect("the first agent moved");
    let error = |number: usize| {
        let (found, truth) = of_agent(number);
        assert!(!found.is_empty(), "agent {number} has frames");
        let square: f64 =
            found.iter().zip(&truth).map(|(f, t)| (truth_from_map * *f - t).norm_squared()).sum();
        (square / found.len() as f64).sqrt()
    };
    (0..drives.len()).map(error).collect()
}

/// Fails unless every agent is within `share` of its path from the truth.
pub fn assert_near_truth(map: &Map, drives: &[&Drive], share: f64) {
    assert_eq!(map.agents.len(), drives.len());
    for (number, (error, drive)) in errors(map, drives).into_iter().zip(drives).enumerate() {
        let path = drive.recording.path_length();
        println!("agent {number}: off by {error:.4} m on a path of {path:.2} m");
        assert!(error <= share * path, "agent {number} is off by {error:.4} m on a path of {path:.2} m");
    }
}
