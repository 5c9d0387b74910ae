//! Whether a merge is right, by the true poses.

use geometry::Se3;
use nalgebra::Vector3;

/// A merge is wrong from this rotation between the keyframes of its closure on, degrees.
pub const ROTATION: f64 = 3.0;
/// A merge is wrong from this offset between them on, parts of the scene's median depth.
pub const OFFSET: f64 = 0.05;
/// A merge is wrong from this error of the scale on, parts.
pub const SCALE: f64 = 0.03;

/// How far a merge is from the truth where the agents met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Of the rotation between the keyframes of the closure, degrees.
    pub rotation: f64,
    /// Of the position of one seen from the other, parts of the scene's depth.
    pub offset: f64,
    /// Of the scale of one map beside the other, parts; below 0 the source is too small.
    pub scale: f64,
}

/// One of two maps in a merge.
#[derive(Clone, Debug)]
pub struct Side {
    /// The keyframe of the closure in the common map, lengths in its unit.
    pub common_from_camera: Se3,
    /// The true pose of the same keyframe, metres.
    pub world_from_camera: Se3,
    /// How much larger the map became in the common one: common units per unit of its own.
    pub growth: f64,
    /// Metres per unit of its own.
    pub metres: f64,
}

impl Side {
    /// Metres per unit of the common map, as this side has it.
    fn metres_per_common(&self) -> f64 {
        self.metres / self.growth
    }
}

impl Deviation {
    /// How far the source is from where it belongs beside the target; `depth` is that of the scene, metres.
    pub fn new(target: &Side, source: &Side, depth: f64) -> Self {
        let found = target.common_from_camera.inverse() * source.common_from_camera;
        let truth = target.world_from_camera.inverse() * source.world_from_camera;
        let offset = found.translation * target.metres_per_common() - truth.translation;
        Self {
            rotation: found.rotation.angle_to(&truth.rotation).to_degrees(),
            offset: offset.norm() / depth,
            scale: target.metres_per_common() / source.metres_per_common() - 1.0,
        }
    }

    /// Whether the merge is right.
    pub fn is_right(&self) -> bool {
        // So put, a deviation that is not a number is not right.
        self.rotation <= ROTATION && self.offset <= OFFSET && self.scale.abs() <= SCALE
    }
}

/// How much larger a path became: the ratio of the two paths' spreads about their means, a number of positions that
/// belong together.
pub fn growth(before: &[Vector3<f64>], after: &[Vector3<f64>]) -> f64 {
    spread(after) / spread(before)
}

/// Root mean square distance from the mean.
fn spread(path: &[Vector3<f64>]) -> f64 {
    let count = path.len().max(1) as f64;
    let mean = path.iter().sum::<Vector3<f64>>() / count;
    (path.iter().map(|position| (position - mean).norm_squared()).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Sim3;
    use nalgebra::{SVector, UnitQuaternion};

    fn pose(x: f64, yaw: f64) -> Se3 {
        Se3::new(UnitQuaternion::from_euler_angles(0.0, yaw, 0.1), Vector3::new(x, 0.2, 1.0))
    }

    /// Two sides of a merge whose common world is the true one under a similarity, but for a mistake of the source.
    fn sides(mistake: &Sim3) -> (Side, Side) {
        let common_from_world = Sim3::exp(&SVector::from([1.0, 2.0, -1.0, 0.3, 0.2, -0.4, 0.8]));
        let side = |pose: Se3, mistake: &Sim3, metres: f64| Side {
            common_from_camera: (common_from_world * *mistake * Sim3::from(pose)).rigid(),
            world_from_camera: pose,
            growth: metres * common_from_world.scale * mistake.scale,
            metres,
        };
        (side(pose(0.0, 0.0), &Sim3::identity(), 3.0), side(pose(1.0, 0.5), mistake, 0.4))
    }

    #[test]
    fn a_true_merge_is_right_in_any_unit() {
        let (target, source) = sides(&Sim3::identity());
        let found = Deviation::new(&target, &source, 5.0);
        assert!(found.rotation < 1e-5 && found.offset < 1e-9 && found.scale.abs() < 1e-9, "{found:?}");
        assert!(found.is_right());
    }

    #[test]
    fn each_mistake_shows_where_it_was_made() {
        let (target, source) =
            sides(&Sim3::new(UnitQuaternion::identity(), Vector3::new(0.3, 0.0, 0.0), 1.0));
        let shifted = Deviation::new(&target, &source, 5.0);
        assert!((shifted.offset - 0.06).abs() < 1e-9 && shifted.rotation < 1e-5 && !shifted.is_right());
        // Deeper in the scene the same shift does not matter.
        assert!(Deviation::new(&target, &source, 10.0).is_right());
        let (target, source) = sides(&Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), 1.04));
        let grown = Deviation::new(&target, &source, 5.0);
        assert!((grown.scale - 0.04).abs() < 1e-9 && !grown.is_right());
        let yaw = UnitQuaternion::from_euler_angles(0.0, 0.0, 4.0_f64.to_radians());
        let (target, source) = sides(&Sim3::new(yaw, Vector3::zeros(), 1.0));
        let turned = Deviation::new(&target, &source, 5.0);
        assert!((turned.rotation - 4.0).abs() < 1e-6 && !turned.is_right());
    }

    #[test]
    fn what_is_no_number_is_not_right() {
        let nothing = Deviation { rotation: 0.0, offset: f64::NAN, scale: 0.0 };
        assert!(!nothing.is_right());
    }

    #[test]
    fn growth_is_that_of_the_spread() {
        let before: Vec<Vector3<f64>> = (0..5).map(|i| Vector3::new(f64::from(i), 0.0, 1.0)).collect();
        let motion = Sim3::exp(&SVector::from([1.0, 2.0, 3.0, 0.3, 0.2, 0.1, 0.7]));
        let after: Vec<Vector3<f64>> = before.iter().map(|position| motion * *position).collect();
        assert!((growth(&before, &after) - motion.scale).abs() < 1e-9);
    }
}
