//! The one idea of a map that all of loopbox shares: keyframes with inverse depth, the edges between
//! them, every frame's pose, and where it came from.

mod atomic;
mod check;
mod error;
mod export;
mod io;
mod keyframe;
mod place;
mod summary;
#[cfg(test)]
mod test_support;
mod trajectory;

pub use error::MapError;
pub use export::{
    CloudPoint, DEFAULT_MAX_RELATIVE_VARIANCE, save_kitti, save_pcd, save_ply, save_tum, write_kitti,
    write_pcd, write_ply, write_tum,
};
pub use io::{FORMAT_VERSION, LoadedMap, MapWriter, is_map_file, load_map, save_map};
pub use keyframe::{Edge, EdgeKind, Keyframe, KeyframeId, Observation, Point, SemiDense};
pub use place::{PlaceCandidate, PlaceIndex};
pub use summary::Summary;
pub use trajectory::{FramePose, StampedPose};

use geometry::{Pinhole, Sim3};
use std::collections::BTreeMap;

/// A map built by one agent, or by several after a merge.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// The pinhole camera all keyframe images were undistorted to.
    pub camera: Pinhole,
    /// Keyframes by id. Ids grow with time and are never reused.
    pub keyframes: BTreeMap<KeyframeId, Keyframe>,
    /// Relative-pose constraints between keyframes.
    pub edges: Vec<Edge>,
    /// Every frame that was tracked, in order of time, relative to its reference keyframe.
    pub frames: Vec<FramePose>,
    /// Where the map came from: free `key → value` text (source, program version, parameters, …).
    pub provenance: BTreeMap<String, String>,
}

impl Map {
    /// An empty map for images of `camera`.
    pub fn new(camera: Pinhole) -> Self {
        Self {
            camera,
            keyframes: BTreeMap::new(),
            edges: Vec::new(),
            frames: Vec::new(),
            provenance: BTreeMap::new(),
        }
    }

    /// World pose of a tracked frame through its reference keyframe; `None` when that keyframe is gone.
    pub fn world_from_frame(&self, frame: &FramePose) -> Option<Sim3> {
        let keyframe = self.keyframes.get(&frame.reference)?;
        Some(keyframe.world_from_keyframe * Sim3::from(frame.keyframe_from_frame))
    }

    /// The trajectory: the world pose of every tracked frame in order of time.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.frames
            .iter()
            .filter_map(|frame| {
                let world_from_camera = self.world_from_frame(frame)?.rigid();
                Some(StampedPose { timestamp: frame.timestamp, world_from_camera })
            })
            .collect()
    }
}
