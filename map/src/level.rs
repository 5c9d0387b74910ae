//! Which way is up in a world that only cameras have seen; and maps brought to another frame and unit.

use crate::Map;
use geometry::Sim3;
use nalgebra::{Matrix3, Vector3};

/// Which way is up, a unit vector, and the mean viewing direction (short when the cameras look all around).
pub fn level<'a>(world_from_cameras: impl Iterator<Item = &'a Sim3>) -> (Vector3<f64>, Vector3<f64>) {
    let cameras: Vec<Matrix3<f64>> = world_from_cameras.map(|pose| pose.rigid().rotation_matrix()).collect();
    (up_direction(&cameras), mean(cameras.iter().map(|r| r.column(2).into_owned())))
}

/// Up, guessed from the cameras' rotations: their mean −y, turned so that their x axes lie level.
///
/// People and cars hold cameras pitched but seldom rolled, so x axes lie in the ground plane while the
/// mean of −y leans with the pitch. `(mean(x xᵀ) + ε I)⁻¹ (−ȳ)` trusts the x axes as far as they span
/// that plane and keeps −ȳ where they do not (Brown and Lowe 2007, §5, with a prior).
fn up_direction(cameras: &[Matrix3<f64>]) -> Vector3<f64> {
    const PRIOR: f64 = 0.02;
    let up = -mean(cameras.iter().map(|r| r.column(1).into_owned()));
    let count = cameras.len().max(1) as f64;
    let spread = cameras.iter().map(|r| r.column(0) * r.column(0).transpose()).sum::<Matrix3<f64>>() / count;
    (spread + Matrix3::identity() * PRIOR)
        .try_inverse()
        .and_then(|inverse| (inverse * up).try_normalize(1e-9))
        .unwrap_or(-Vector3::y())
}

fn mean(vectors: impl ExactSizeIterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let count = vectors.len().max(1) as f64;
    vectors.sum::<Vector3<f64>>() / count
}

impl Map {
    /// Transforms the map to another frame and unit. The agents' own maps stay, and so does all that is measured in a
    /// keyframe: depths, points, frames, edges.
    pub fn transform(&mut self, new_from_world: &Sim3) {
        for keyframe in self.keyframes.values_mut() {
            keyframe.world_from_keyframe = *new_from_world * keyframe.world_from_keyframe;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::united;
    use nalgebra::{Rotation3, SVector};

    /// A level camera turned by `yaw` about the vertical (−y) and then pitched down.
    fn camera(yaw: f64, pitch: f64) -> Matrix3<f64> {
        (Rotation3::from_axis_angle(&Vector3::y_axis(), yaw)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), -pitch))
        .into_inner()
    }

    #[test]
    fn up_is_level_for_pitched_cameras_that_look_around() {
        let cameras: Vec<_> = (0..20).map(|i| camera(i as f64 * 0.06, 0.4)).collect();
        let up = up_direction(&cameras);
        assert!(up.dot(&-Vector3::y()) > 0.99, "{up}");
    }

    #[test]
    fn up_of_one_camera_is_its_minus_y_and_of_none_the_worlds() {
        let one = camera(0.3, 0.2);
        assert!((up_direction(&[one]) + one.column(1)).norm() < 1e-9);
        assert_eq!(up_direction(&[]), -Vector3::y());
    }

    #[test]
    fn a_transformed_map_has_its_cloud_and_its_trajectory_elsewhere_and_splits_as_before() {
        let map = united();
        let motion = Sim3::exp(&SVector::<f64, 7>::from_fn(|i, _| 0.1 * i as f64 - 0.3));
        let mut moved = map.clone();
        moved.transform(&motion);
        for (old, new) in map.cloud(f32::INFINITY).zip(moved.cloud(f32::INFINITY)) {
            assert!((motion * old.position - new.position).norm() < 1e-9);
        }
        for (old, new) in map.trajectory().iter().zip(moved.trajectory()) {
            let expected = (motion * Sim3::from(old.world_from_camera)).rigid();
            assert!((expected.inverse() * new.world_from_camera).log().norm() < 1e-9);
        }
        assert!(moved.split() == map.split());
    }
}
