//! Poses of frames.

use crate::KeyframeId;
use geometry::Se3;

/// A tracked frame, relative to the keyframe it was tracked against, so that it moves with it
/// when the map is optimised. It is of the agent that the keyframe is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FramePose {
    /// Time stamp, seconds.
    pub timestamp: f64,
    /// Index of the frame in the recording, from 0.
    pub frame_index: u64,
    /// The reference keyframe.
    pub reference: KeyframeId,
    /// Pose relative to it, translation in the keyframe's unit.
    pub keyframe_from_frame: Se3,
}

/// A pose in the world at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Seconds.
    pub timestamp: f64,
    /// The camera's pose in the world.
    pub world_from_camera: Se3,
}
