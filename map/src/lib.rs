//! The one idea of a map that all of loopbox shares: keyframes with inverse depth, the edges between
//! them, every frame's pose, and where it came from.

mod agent;
mod atomic;
mod check;
mod color;
#[cfg(test)]
mod color_tests;
mod cut;
mod delta;
mod error;
mod export;
mod identity;
mod io;
mod keyframe;
mod level;

mod place;
mod rectified;
mod scan;
mod sensor;
mod shared;
mod summary;
#[cfg(test)]
mod test_support;
mod trajectory;
mod unite;

pub use agent::{AgentId, AgentInfo, OwnMap};
pub use atomic::write_atomically;
pub use color::{Color, Colors, Luma};
pub use delta::{Described, MapDelta, Moved, Settled};
pub use error::MapError;
pub use export::{
    CloudPoint, CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE, agent_color, save_colmap, save_glb,
    save_kitti, save_las, save_nerfstudio, save_pcd, save_ply, save_tum, write_kitti, write_pcd, write_ply,
    write_tum,
};
pub use identity::{Identity, KeyframeName};
pub use io::{
    FORMAT_VERSION, LoadedMap, MapWriter, is_map_file, load_map, load_map_swapped, parts, save_map,
    sensors_of,
};
pub use keyframe::{Edge, EdgeKind, Keyframe, KeyframeId, Observation, Point, SemiDense};
pub use level::level;
pub use place::{PlaceCandidate, PlaceIndex};
pub use rectified::{Rectified, rectified, rectified_depths, sensor_entries};
pub use scan::Scan;
pub use sensor::{Sensor, SensorKind};
pub use shared::{Shared, SharedBytes};
pub use summary::{AgentSummary, Summary};
pub use trajectory::{FramePose, StampedPose};
pub use uuid::Uuid;

use geometry::{Pinhole, Sim3, Swap};
use std::collections::BTreeMap;

/// A map built by one agent, or the maps of several in one.
///
/// Agents' maps come together by [`unite`](Map::unite) and apart by [`split`](Map::split).
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Whose keyframes are in the map; one agent at least.
    pub agents: BTreeMap<AgentId, AgentInfo>,
    /// Keyframes by id. Ids of one agent grow with time and are never reused.
    pub keyframes: BTreeMap<KeyframeId, Keyframe>,
    /// Relative-pose constraints between keyframes. Those between agents are of kind [`EdgeKind::Merge`].
    pub edges: Vec<Edge>,
    /// Every frame that was tracked, relative to its reference keyframe; each agent's in order of time.
    pub frames: Vec<FramePose>,
    /// How the maps of several agents came together: free `key → value` text (program version,
    /// parameters, …). Empty in an agent's own map.
    pub merge_provenance: BTreeMap<String, String>,
}

impl Map {
    /// An empty map of one agent with images of `camera`; [`of`](Self::of) gives the agent a name.
    pub fn new(camera: Pinhole) -> Self {
        Self::of(AgentInfo::unnamed(camera))
    }

    /// An empty map of one agent.
    pub fn of(agent: AgentInfo) -> Self {
        Self { agents: [(AgentId::default(), agent)].into(), ..Self::without_agents() }
    }

    /// Keeps images, depths, features and words of all keyframes, of which others have no copies yet, where `swap` has room
    /// for them; they are in memory again when they are looked at.
    pub fn swap_out(&mut self, swap: &dyn Swap) {
        self.keyframes.values_mut().for_each(|keyframe| keyframe.swap_out(swap));
        self.rest();
    }

    /// Gives back the memory of what is swapped out of the keyframes, until it is looked at again.
    pub fn rest(&self) {
        self.keyframes.values().for_each(Keyframe::rest);
    }

    /// A map to which agents are yet to come.
    fn without_agents() -> Self {
        Self {
            agents: BTreeMap::new(),
            keyframes: BTreeMap::new(),
            edges: Vec::new(),
            frames: Vec::new(),
            merge_provenance: BTreeMap::new(),
        }
    }

    /// The camera that took a keyframe of this map.
    ///
    /// # Panics
    /// When the keyframe's agent is not in the map, or has no camera. Every agent of a loaded or united map is in it.
    /// Functions that work on images call [`of_cameras`](Self::of_cameras) first.
    pub fn camera(&self, keyframe: &Keyframe) -> &Pinhole {
        match &self.agents[&keyframe.agent].sensor {
            Sensor::Camera(camera) => camera,
            Sensor::Lidar => panic!("keyframe {} is a LiDAR's: it has no camera", keyframe.id.0),
        }
    }

    /// The camera of the agent that took a keyframe; `None` for a LiDAR.
    pub fn camera_of(&self, keyframe: &Keyframe) -> Option<&Pinhole> {
        self.agents.get(&keyframe.agent).and_then(AgentInfo::camera)
    }

    /// Whether the map is in metres: a common map is in the world of its first agent.
    pub fn is_metric(&self) -> bool {
        self.agents.values().next().is_some_and(AgentInfo::is_metric)
    }

    /// The agents' names made safe for files and topics: letters, digits, `.`, `-` and `_`, still unique.
    pub fn agent_labels(&self) -> BTreeMap<AgentId, String> {
        agent::labels(&self.agents)
    }

    /// The permanent name of a keyframe; `None` if no agent has this id, or the agent has no identity.
    pub fn name_of(&self, id: KeyframeId) -> Option<KeyframeName> {
        let info = &self.agents[&agent::owner(&self.agents, id)?];
        let first = info.own.as_ref().map_or(0, |own| own.first_keyframe);
        Some(KeyframeName { agent: info.identity?, number: id.0 - first })
    }

    /// The id in this map of the keyframe with this name, if the map has it.
    pub fn find(&self, name: KeyframeName) -> Option<KeyframeId> {
        let info = self.agents.values().find(|info| info.identity == Some(name.agent))?;
        let first = info.own.as_ref().map_or(0, |own| own.first_keyframe);
        let id = KeyframeId(first.checked_add(name.number)?);
        (self.keyframes.contains_key(&id) && self.name_of(id) == Some(name)).then_some(id)
    }

    /// World pose of a tracked frame through its reference keyframe; `None` when that keyframe is gone.
    pub fn world_from_frame(&self, frame: &FramePose) -> Option<Sim3> {
        let keyframe = self.keyframes.get(&frame.reference)?;
        Some(keyframe.world_from_keyframe * Sim3::from(frame.keyframe_from_frame))
    }

    /// The world pose of every tracked frame, each agent's in order of time.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.trajectory_by(|_| true)
    }

    /// The trajectory of one agent: the world pose of its every tracked frame in order of time.
    pub fn trajectory_of(&self, agent: AgentId) -> Vec<StampedPose> {
        self.trajectory_by(|keyframe| keyframe.agent == agent)
    }

    /// World poses of the frames whose reference keyframe is `wanted`, in their order.
    pub fn trajectory_by(&self, wanted: impl Fn(&Keyframe) -> bool) -> Vec<StampedPose> {
        let pose = |frame: &FramePose| {
            let keyframe = self.keyframes.get(&frame.reference).filter(|keyframe| wanted(keyframe))?;
            let world_from_frame = keyframe.world_from_keyframe * Sim3::from(frame.keyframe_from_frame);
            Some(StampedPose { timestamp: frame.timestamp, world_from_camera: world_from_frame.rigid() })
        };
        self.frames.iter().filter_map(pose).collect()
    }
}
