//! A LiDAR agent and its map, a scan at a time.

use super::convert::{edge, frame, id, odometry_edge, to_keyframe};
use super::poses::GivenPoses;
use geometry::Sim3;
use map::{AgentId, AgentInfo, EdgeKind, Identity, Map};
use scans::Scan;
use slam_lidar::floam::NoRings;
use slam_lidar::mapping::{Agent, Loop, MappingParams};
use slam_lidar::motion::Sweep;
use slam_lidar::odometry::TrackedSweep;

/// An agent whose map is kept as [`map::Map`] all along. Where its sensor was carried away it begins another one, a fragment with a world
/// of its own.
pub struct Mapper {
    params: MappingParams,
    about: AgentInfo,
    poses: Option<GivenPoses>,
    /// Those that a loss ended.
    ended: Vec<Fragment>,
    fragment: Fragment,
    last: Option<f64>,
    /// Scans in a row that were lost.
    lost: usize,
}

/// A map between two losses, and the agent that made it.
pub struct Fragment {
    /// The map.
    pub map: Map,
    /// The agent behind it.
    pub agent: Agent,
}

/// Scans in a row that are lost before another fragment begins: one alone may be bad itself.
const GIVE_UP: usize = 3;

/// What became of a scan.
#[derive(Clone, Copy, Debug)]
pub struct MappedScan {
    /// Its pose.
    pub sweep: TrackedSweep,
    /// Whether the map has a keyframe more.
    pub is_keyframe: bool,
    /// The loop that was closed: all keyframes may have moved.
    pub closed: Option<Loop>,
}

/// Why a scan has no place in the map.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotMapped {
    /// The method needs rings.
    #[error(transparent)]
    NoRings(#[from] NoRings),
    /// It is older than the scan before, or as old.
    #[error("its time {0} does not come after that of the scan before, {1}")]
    OutOfOrder(f64, f64),
    /// The sensor is not where it should be.
    #[error(
        "hardly anything of the map is where it should be: the sensor was carried away, or scans are missing"
    )]
    Lost,
    /// There is no pose for it among those given.
    #[error("the poses that are given do not span its time {0}")]
    NoPose(f64),
}

impl Mapper {
    /// An agent with an empty map; with `poses` it does not track, but takes these.
    pub fn new(about: AgentInfo, params: MappingParams, poses: Option<GivenPoses>) -> Self {
        let fragment = Fragment::new(about.clone(), params);
        Self { params, about, poses, ended: Vec::new(), fragment, last: None, lost: 0 }
    }

    /// Begins a map: of the same agent, in its next epoch.
    fn begin(&mut self) {
        let before = self.fragment.map.agents.get(&AgentId::default()).and_then(|about| about.identity);
        let identity = before.map(|before| Identity { epoch: before.epoch + 1, ..before });
        let fresh = Fragment::new(AgentInfo { identity, ..self.about.clone() }, self.params);
        let mut ended = std::mem::replace(&mut self.fragment, fresh);
        ended.agent.end_tracking();
        self.ended.push(ended);
    }

    /// Adds the scan number `index` of the recording to the map.
    ///
    /// # Errors
    /// Says why it was not added; nothing has changed then.
    pub fn add_scan(&mut self, index: u64, scan: &Scan) -> Result<MappedScan, NotMapped> {
        if let Some(last) = self.last.filter(|last| scan.stamp <= *last) {
            return Err(NotMapped::OutOfOrder(scan.stamp, last));
        }
        let mut tracked = self.track(scan)?;
        if tracked.0.lost {
            self.lost += 1;
            if self.lost < GIVE_UP {
                self.last = Some(scan.stamp);
                return Err(NotMapped::Lost);
            }
            self.begin();
            tracked = self.track(scan)?;
        }
        let (sweep, closed) = tracked;
        (self.last, self.lost) = (Some(scan.stamp), 0);
        let fragment = &mut self.fragment;
        // Who made the map follows from the recording, as of a camera's: run again it is the same agent.
        if let Some(about) = fragment.map.agents.get_mut(&AgentId::default()) {
            about.identity.get_or_insert_with(|| Identity::of_scans(scan.stamp, &scan.points));
        }
        let is_keyframe = fragment.agent.keyframes().len() > fragment.map.keyframes.len();
        if is_keyframe {
            fragment.add_keyframe(index);
        }
        if let Some(found) = &closed {
            fragment.add_loop(found, &self.params);
        }
        fragment.map.frames.extend(fragment.agent.sweeps().last().map(|tracked| frame(index, tracked)));
        Ok(MappedScan { sweep, is_keyframe, closed })
    }

    /// Tracks a scan with the agent of the newest fragment.
    fn track(&mut self, scan: &Scan) -> Result<(TrackedSweep, Option<Loop>), NotMapped> {
        let agent = &mut self.fragment.agent;
        Ok(match &self.poses {
            None => agent.take(scan)?,
            Some(poses) => {
                let instants = Sweep::of(scan, self.params.odometry.range).instants;
                let motion = poses.motion(instants, scan.stamp).ok_or(NotMapped::NoPose(scan.stamp))?;
                (agent.place(scan, motion), None)
            }
        })
    }

    /// The fragment that grows: which one it is, from 0, and its map.
    pub fn active_map(&self) -> (usize, &Map) {
        (self.ended.len(), &self.fragment.map)
    }

    /// All fragments in order, for the end.
    pub fn into_fragments(mut self) -> Vec<Fragment> {
        self.ended.push(self.fragment);
        self.ended
    }
}

impl Fragment {
    fn new(about: AgentInfo, params: MappingParams) -> Self {
        Self { map: Map::of(about), agent: Agent::new(params) }
    }

    fn add_keyframe(&mut self, frame_index: u64) {
        let Some((last, keyframe)) = self.agent.keyframes().iter().enumerate().next_back() else { return };
        self.map.keyframes.insert(id(last), to_keyframe(last, frame_index, keyframe));
        if let (Some(before), Some(step)) = (last.checked_sub(1), self.agent.steps().last()) {
            let covariance = self.agent.step_covariance(before);
            self.map.edges.push(odometry_edge([id(before), id(last)], step, &covariance));
        }
    }

    fn add_loop(&mut self, found: &Loop, params: &MappingParams) {
        let ends = [id(found.from), id(found.to)];
        let measured = &found.alignment.target_from_source;
        self.map.edges.push(edge(ends, measured, params.loop_deviation, EdgeKind::Loop));
        for (keyframe, smoothed) in self.map.keyframes.values_mut().zip(self.agent.keyframes()) {
            keyframe.world_from_keyframe = Sim3::from(smoothed.world_from_sensor);
        }
    }
}
