//! Trajectories as files give them.

use geometry::Se3;

/// The poses of a trajectory, in the order of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Seconds, strictly growing, one per pose; `None` for KITTI files, whose poses are known by their row.
    pub timestamps: Option<Vec<f64>>,
    /// The camera's pose in the world, in the unit of the file.
    pub world_from_camera: Vec<Se3>,
}

impl Trajectory {
    /// The same poses with time stamps; those it has stay. `None` when there is not one per pose.
    pub fn with_timestamps(self, timestamps: &[f64]) -> Option<Self> {
        if self.timestamps.is_some() {
            return Some(self);
        }
        (timestamps.len() == self.world_from_camera.len())
            .then(|| Self { timestamps: Some(timestamps.to_vec()), ..self })
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.world_from_camera.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.world_from_camera.is_empty()
    }
}
