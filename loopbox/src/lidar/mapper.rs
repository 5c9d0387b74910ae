//! A LiDAR agent and its map, a scan at a time.

use super::convert::{edge, frame, id, to_keyframe};
use super::poses::GivenPoses;
use geometry::Sim3;
use map::{AgentId, AgentInfo, EdgeKind, Identity, Map};
use scans::Scan;
use slam_lidar::floam::NoRings;
use slam_lidar::mapping::{Agent, Loop, MappingParams};
use slam_lidar::motion::Sweep;
use slam_lidar::odometry::TrackedSweep;

/// An agent whose map is kept as [`map::Map`] all along.
pub struct Mapper {
    params: MappingParams,
    poses: Option<GivenPoses>,
    agent: Agent,
    map: Map,
    last: Option<f64>,
}

/// What became of a scan.
#[derive(Clone, Copy, Debug)]
pub struct Taken {
    /// Its pose.
    pub sweep: TrackedSweep,
    /// Whether the map has a keyframe more.
    pub is_keyframe: bool,
    /// The loop that was closed: all keyframes may have moved.
    pub closed: Option<Loop>,
}

/// Why a scan has no place in the map.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotTaken {
    /// The method needs rings.
    #[error(transparent)]
    NoRings(#[from] NoRings),
    /// It is older than the scan before, or as old.
    #[error("its time {0} does not come after that of the scan before, {1}")]
    OutOfOrder(f64, f64),
    /// There is no pose for it among those given.
    #[error("the poses that are given do not span its time {0}")]
    NoPose(f64),
}

impl Mapper {
    /// An agent with an empty map; with `poses` it does not track, but takes these.
    pub fn new(about: AgentInfo, params: MappingParams, poses: Option<GivenPoses>) -> Self {
        Self { params, poses, agent: Agent::new(params), map: Map::of(about), last: None }
    }

    /// Takes the scan number `index` of the recording.
    ///
    /// # Errors
    /// Says why it was not taken; nothing has changed then.
    pub fn take(&mut self, index: u64, scan: &Scan) -> Result<Taken, NotTaken> {
        if let Some(last) = self.last.filter(|last| scan.stamp <= *last) {
            return Err(NotTaken::OutOfOrder(scan.stamp, last));
        }
        let before = self.agent.keyframes().len();
        let (sweep, closed) = match &self.poses {
            None => self.agent.take(scan)?,
            Some(poses) => {
                let instants = Sweep::of(scan, self.params.odometry.range).instants;
                let motion = poses.motion(instants, scan.stamp).ok_or(NotTaken::NoPose(scan.stamp))?;
                (self.agent.place(scan, motion), None)
            }
        };
        self.last = Some(scan.stamp);
        // Who made the map follows from the recording, as of a camera's: run again it is the same agent.
        if let Some(about) = self.map.agents.get_mut(&AgentId::default()) {
            about.identity.get_or_insert_with(|| Identity::of_scans(scan.stamp, &scan.points));
        }
        let is_keyframe = self.agent.keyframes().len() > before;
        if is_keyframe {
            self.add_keyframe(index);
        }
        if let Some(found) = &closed {
            self.add_loop(found);
        }
        self.map.frames.extend(self.agent.sweeps().last().map(|tracked| frame(index, tracked)));
        Ok(Taken { sweep, is_keyframe, closed })
    }

    /// The map.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// The agent behind it.
    pub fn agent(&self) -> &Agent {
        &self.agent
    }

    /// Map and agent, for the end.
    pub fn into_parts(self) -> (Map, Agent) {
        (self.map, self.agent)
    }

    fn add_keyframe(&mut self, frame_index: u64) {
        let Some((last, keyframe)) = self.agent.keyframes().iter().enumerate().next_back() else { return };
        self.map.keyframes.insert(id(last), to_keyframe(last, frame_index, keyframe));
        if let (Some(before), Some(step)) = (last.checked_sub(1), self.agent.steps().last()) {
            let deviation = self.params.odometry_deviation;
            self.map.edges.push(edge([id(before), id(last)], step, deviation, EdgeKind::Odometry));
        }
    }

    fn add_loop(&mut self, found: &Loop) {
        let ends = [id(found.from), id(found.to)];
        let measured = &found.alignment.target_from_source;
        self.map.edges.push(edge(ends, measured, self.params.loop_deviation, EdgeKind::Loop));
        for (keyframe, smoothed) in self.map.keyframes.values_mut().zip(self.agent.keyframes()) {
            keyframe.world_from_keyframe = Sim3::from(smoothed.world_from_sensor);
        }
    }
}
