//! Poses for the 3-D view: keyframes, trajectory, edges, and which way is up.

use super::cloud::points_of;
use super::pack::Packed;
use geometry::{Pinhole, Sim3};
use map::{AgentId, EdgeKind, Keyframe, KeyframeId, Map, agent_color};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;

/// Everything of the 3-D view but the cloud, in world coordinates.
#[derive(Serialize)]
pub struct Scene {
    /// Whose keyframes these are, in the order of their ids.
    agents: Vec<Agent>,
    /// Whether a unit of length is a metre.
    metric: bool,
    /// Unit vector against gravity, as guessed from the cameras; of LiDARs, where there are any, which stand upright.
    up: [f64; 3],
    /// Mean viewing direction; short when the cameras look all around.
    forward: [f64; 3],
    keyframes: Keyframes,
    trajectory: Trajectory,
    /// `from, to, kind` per edge, indices into `keyframes`, u32.
    edges: Packed,
}

#[derive(Serialize)]
struct Agent {
    name: String,
    /// Red, green, blue in sRGB, as everywhere that agents are told apart.
    color: [u8; 3],
    /// None of a LiDAR.
    camera: Option<Pinhole>,
}

#[derive(Serialize)]
struct Keyframes {
    count: usize,
    /// Index of the agent, u32; ascending.
    agent: Packed,
    /// Names, u32.
    id: Packed,
    /// Frame indices, f64.
    frame: Packed,
    /// Seconds, f64.
    timestamp: Packed,
    /// The camera's x, y, z axes and its centre, f32 × 12; of a LiDAR those of a camera that looks ahead.
    pose: Packed,
    /// Pixels with a depth, or points of the scan, u32.
    depths: Packed,
}

#[derive(Serialize)]
struct Trajectory {
    count: usize,
    /// Index of the agent, u32; ascending.
    agent: Packed,
    /// Frame indices, f64.
    frame: Packed,
    /// Seconds, f64.
    timestamp: Packed,
    /// Centres of the sensors, f32 × 3.
    position: Packed,
    /// World from sensor as quaternions x, y, z, w, f32 × 4.
    rotation: Packed,
}

/// A tracked frame whose pose can be drawn.
#[derive(Clone, Copy, Debug)]
pub struct PlacedFrame {
    /// Index of the agent in the scene.
    pub agent: usize,
    /// Index of the frame in the recording.
    pub frame_index: u64,
    /// Seconds.
    pub timestamp: f64,
    /// Its pose.
    pub world_from_frame: Sim3,
}

/// The keyframes whose pose can be drawn, by agent and in order of their ids.
pub fn placed_keyframes(map: &Map) -> Vec<&Keyframe> {
    let mut placed: Vec<&Keyframe> =
        map.keyframes.values().filter(|k| k.world_from_keyframe.is_valid()).collect();
    placed.sort_by_key(|keyframe| (keyframe.agent, keyframe.id));
    placed
}

/// The frames whose pose can be drawn, by agent and in order of time.
pub fn placed_frames(map: &Map) -> Vec<PlacedFrame> {
    let agents = agent_indices(map);
    let placed = map.frames.iter().filter_map(|frame| {
        let agent = *agents.get(&map.keyframes.get(&frame.reference)?.agent)?;
        let world_from_frame = map.world_from_frame(frame).filter(Sim3::is_valid)?;
        let (frame_index, timestamp) = (frame.frame_index, frame.timestamp);
        Some(PlacedFrame { agent, frame_index, timestamp, world_from_frame })
    });
    let mut placed: Vec<PlacedFrame> = placed.collect();
    // Stable: of one agent they are in order of time.
    placed.sort_by_key(|frame| frame.agent);
    placed
}

/// The position of each agent among all.
fn agent_indices(map: &Map) -> BTreeMap<AgentId, usize> {
    map.agents.keys().copied().zip(0..).collect()
}

impl Scene {
    /// The scene of a map with its placed keyframes and frames.
    pub fn new(map: &Map, keyframes: &[&Keyframe], frames: &[PlacedFrame]) -> Self {
        let agents = agent_indices(map);
        let poses: Vec<Sim3> = keyframes.iter().map(|keyframe| looking_ahead(keyframe)).collect();
        let of_lidars =
            || keyframes.iter().zip(&poses).filter(|(k, _)| k.scan.is_some()).map(|(_, pose)| pose);
        let (up, forward) =
            if of_lidars().next().is_some() { map::level(of_lidars()) } else { map::level(poses.iter()) };
        Self {
            agents: map.agents.iter().map(agent).collect(),
            metric: map.is_metric(),
            up: up.into(),
            forward: forward.into(),
            keyframes: Keyframes {
                count: keyframes.len(),
                agent: Packed::u32(
                    keyframes.iter().map(|k| agents.get(&k.agent).map_or(0, |index| *index as u32)),
                ),
                id: Packed::u32(keyframes.iter().map(|k| k.id.0)),
                frame: Packed::f64(keyframes.iter().map(|k| k.frame_index as f64)),
                timestamp: Packed::f64(keyframes.iter().map(|k| k.timestamp)),
                pose: Packed::f32(poses.iter().flat_map(pose_numbers)),
                depths: Packed::u32(keyframes.iter().map(|k| points_of(k) as u32)),
            },
            trajectory: Trajectory {
                count: frames.len(),
                agent: Packed::u32(frames.iter().map(|frame| frame.agent as u32)),
                frame: Packed::f64(frames.iter().map(|frame| frame.frame_index as f64)),
                timestamp: Packed::f64(frames.iter().map(|frame| frame.timestamp)),
                position: Packed::f32(
                    frames.iter().flat_map(|frame| single(frame.world_from_frame.translation)),
                ),
                rotation: Packed::f32(
                    frames
                        .iter()
                        .flat_map(|f| <[f32; 4]>::from(f.world_from_frame.rotation.coords.cast::<f32>())),
                ),
            },
            edges: edges(map, keyframes),
        }
    }
}

/// An agent as the page shows it.
fn agent((id, info): (&AgentId, &map::AgentInfo)) -> Agent {
    Agent { name: info.name.clone(), color: agent_color(*id), camera: info.camera().copied() }
}

/// The pose of a keyframe's camera; of a LiDAR (x forward, y left, z up) that of a camera in it that looks ahead.
fn looking_ahead(keyframe: &Keyframe) -> Sim3 {
    let pose = keyframe.world_from_keyframe;
    if keyframe.scan.is_none() {
        return pose;
    }
    let lidar_from_camera = Rotation3::from_basis_unchecked(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
    Sim3 { rotation: pose.rotation * UnitQuaternion::from_rotation_matrix(&lidar_from_camera), ..pose }
}

/// The axes and the centre of a camera.
pub fn pose_numbers(pose: &Sim3) -> [f32; 12] {
    let r = pose.rigid().rotation_matrix();
    let mut numbers = [0.0; 12];
    for column in 0..3 {
        numbers[column * 3..][..3].copy_from_slice(&single(r.column(column).into_owned()));
    }
    numbers[9..].copy_from_slice(&single(pose.translation));
    numbers
}

fn single(v: Vector3<f64>) -> [f32; 3] {
    v.cast::<f32>().into()
}

/// The edges between placed keyframes.
fn edges(map: &Map, keyframes: &[&Keyframe]) -> Packed {
    let index: BTreeMap<KeyframeId, u32> = keyframes.iter().zip(0..).map(|(k, i)| (k.id, i)).collect();
    let numbers = map
        .edges
        .iter()
        .filter_map(|edge| Some([*index.get(&edge.from)?, *index.get(&edge.to)?, kind_number(edge.kind)]));
    Packed::u32(numbers.flatten())
}

/// What pages call a kind of edge.
pub fn kind_number(kind: EdgeKind) -> u32 {
    match kind {
        EdgeKind::Odometry => 0,
        EdgeKind::Covisibility => 1,
        EdgeKind::Loop => 2,
        EdgeKind::Merge => 3,
    }
}
