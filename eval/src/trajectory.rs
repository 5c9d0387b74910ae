//! Trajectories as files give them.

use crate::associate::nearest;
use geometry::{Se3, Sim3};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// A pose as its file gives it: `world_from_camera`.
///
/// The rotation stays the matrix of the file: KITTI's are rounded to seven digits and only nearly
/// rotations, and making them so would move relative angles by more than the errors of good estimates differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation, orthonormal as far as the digits of the file go.
    pub rotation: Matrix3<f64>,
    /// Position of the camera, in the unit of the file.
    pub translation: Vector3<f64>,
}

impl Pose {
    /// `self⁻¹ · other`, the motion from this pose to another.
    pub fn to(&self, other: &Self) -> Self {
        let inverse = self.rotation.transpose();
        Self {
            rotation: inverse * other.rotation,
            translation: inverse * (other.translation - self.translation),
        }
    }

    /// The pose in the frame and unit that `transform` maps to.
    pub fn transformed(&self, transform: &Sim3) -> Self {
        let rotation = transform.rigid().rotation_matrix() * self.rotation;
        Self { rotation, translation: *transform * self.translation }
    }

    /// The pose as a rigid motion.
    pub fn rigid(&self) -> Se3 {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Se3::new(UnitQuaternion::from_rotation_matrix(&rotation), self.translation).renormalized()
    }

    /// Angle of the rotation nearest to the matrix, degrees, 0–180.
    pub fn angle_deg(&self) -> f64 {
        // Both factors exist: they were asked for.
        let svd = self.rotation.svd(true, true);
        let nearest = svd.u.zip(svd.v_t).map_or(self.rotation, |(u, v_t)| u * v_t);
        let axis =
            Vector3::new(nearest.m32 - nearest.m23, nearest.m13 - nearest.m31, nearest.m21 - nearest.m12);
        axis.norm().atan2(nearest.trace() - 1.0).to_degrees()
    }
}

impl From<Se3> for Pose {
    fn from(motion: Se3) -> Self {
        Self { rotation: motion.rotation_matrix(), translation: motion.translation }
    }
}

impl Trajectory {
    /// The trajectory of a sensor that is fixed to what this one is of: `body_from_sensor` is its place there.
    pub fn seen_from(self, body_from_sensor: &Se3) -> Self {
        let sensor: Pose = (*body_from_sensor).into();
        let of_sensor = |body: &Pose| Pose {
            rotation: body.rotation * sensor.rotation,
            translation: body.rotation * sensor.translation + body.translation,
        };
        Self { world_from_camera: self.world_from_camera.iter().map(of_sensor).collect(), ..self }
    }
}

/// The poses of a trajectory, in the order of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Seconds, strictly growing, one per pose; `None` for KITTI files, whose poses are known by their row.
    pub timestamps: Option<Vec<f64>>,
    /// The camera's pose in the world, in the unit of the file.
    pub world_from_camera: Vec<Pose>,
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

    /// The pose nearest in time to `time`, when it is at most `max_diff` seconds away.
    pub fn pose_at(&self, time: f64, max_diff: f64) -> Option<&Pose> {
        let times = self.timestamps.as_ref()?;
        let found = nearest(times, time).filter(|&i| (times[i] - time).abs() <= max_diff)?;
        self.world_from_camera.get(found)
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
