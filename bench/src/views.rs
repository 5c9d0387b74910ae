//! What the keyframes of maps see, by the true poses of their recordings.

use anyhow::Result;
use eval::{AlignMode, DEFAULT_MAX_DIFF, Trajectory, align, associate};
use geometry::{Pinhole, Se3};
use map::{Keyframe, KeyframeId, Map};
use nalgebra::Vector3;

/// Points of a keyframe that are looked for in another.
const POINTS: usize = 200;

/// Two keyframes show the same place when at least this share of the points of each lies in the other's image.
pub const SAME: f64 = 0.25;
/// They show different places below this share; between the two nobody can say.
pub const DIFFERENT: f64 = 0.05;

/// What a keyframe sees, in the world of the true poses.
#[derive(Clone, Debug)]
pub struct View {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// When it was taken, seconds.
    pub timestamp: f64,
    /// Its true pose, metres.
    pub world_from_camera: Se3,
    camera: Pinhole,
    /// In the world of the true poses, metres.
    points: Vec<Vector3<f64>>,
    /// Median depth of the points, metres.
    pub depth: f64,
}

impl View {
    /// What a keyframe with the true pose `world_from_camera` sees; `metres` is the map's unit.
    pub fn new(keyframe: &Keyframe, camera: &Pinhole, world_from_camera: Se3, metres: f64) -> Self {
        let metres = metres * keyframe.world_from_keyframe.scale;
        let step = keyframe.semi_dense.len().div_ceil(POINTS).max(1);
        let mut depths = Vec::new();
        let point = |(pixel, inverse_depth, _): (u32, f32, f32)| {
            let (x, y) = (pixel as usize % camera.width, pixel as usize / camera.width);
            let depth = metres / f64::from(inverse_depth);
            depths.push(depth);
            world_from_camera * (camera.unproject(x as f64, y as f64) * depth)
        };
        let points = keyframe.semi_dense.iter().step_by(step).map(point).collect();
        depths.sort_by(f64::total_cmp);
        let depth = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
        let (id, timestamp) = (keyframe.id, keyframe.timestamp);
        Self { keyframe: id, timestamp, world_from_camera, camera: *camera, points, depth }
    }

    /// The share of points, 0–1, that each has in the other's image: the smaller of both shares.
    pub fn overlap(&self, other: &Self) -> f64 {
        self.share_in(other).min(other.share_in(self))
    }

    /// The same for points that both see from directions at most so many degrees apart: from farther aside a thing looks
    /// different, and from behind it is another one.
    pub fn overlap_within(&self, other: &Self, degrees: f64) -> f64 {
        let cosine = degrees.to_radians().cos();
        self.share_seen(other, cosine).min(other.share_seen(self, cosine))
    }

    /// The share of this keyframe's points that lie in the image of another.
    fn share_in(&self, other: &Self) -> f64 {
        self.share_seen(other, -1.0)
    }

    /// The same for those whose rays from both cameras have an angle of at least this cosine.
    fn share_seen(&self, other: &Self, min_cosine: f64) -> f64 {
        let centres = [self, other].map(|view| view.world_from_camera.translation);
        let camera_from_world = other.world_from_camera.inverse();
        let visible = |point: &&Vector3<f64>| {
            let [here, there] = centres.map(|centre| (*point - centre).normalize());
            if here.dot(&there) < min_cosine {
                return false;
            }
            let point = camera_from_world * **point;
            let pixel = other.camera.project(&point);
            let inside = |v: f64, size: usize| v >= 0.0 && v <= (size - 1) as f64;
            point.z > 0.0 && inside(pixel.x, other.camera.width) && inside(pixel.y, other.camera.height)
        };
        self.points.iter().filter(visible).count() as f64 / self.points.len().max(1) as f64
    }
}

/// What the keyframes of a map see, in their order; those without a true pose are left out.
pub fn views(map: &Map, truth: &Trajectory, metres: f64) -> Vec<View> {
    let view = |keyframe: &Keyframe| {
        let pose = truth.pose_at(keyframe.timestamp, DEFAULT_MAX_DIFF)?;
        Some(View::new(keyframe, map.camera(keyframe), pose.rigid(), metres))
    };
    map.keyframes.values().filter_map(view).collect()
}

/// The largest overlap of a keyframe of one map with one of another, 0–1.
pub fn largest_overlap(a: &[View], b: &[View]) -> f64 {
    a.iter().flat_map(|a| b.iter().map(|b| a.overlap(b))).fold(0.0, f64::max)
}

/// Metres per unit of a map's world, from the alignment of its whole trajectory.
///
/// # Errors
/// When the trajectory cannot be aligned.
pub fn metres_per_unit(map: &Map, truth: &Trajectory) -> Result<f64> {
    let trajectory = map.trajectory();
    let estimate = Trajectory {
        timestamps: Some(trajectory.iter().map(|pose| pose.timestamp).collect()),
        world_from_camera: trajectory.iter().map(|pose| pose.world_from_camera.into()).collect(),
    };
    let pairs = associate(&estimate, truth, DEFAULT_MAX_DIFF)?;
    Ok(align(&pairs, AlignMode::Sim3)?.0.scale)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Sim3};
    use nalgebra::UnitQuaternion;
    use std::sync::Arc;

    const CAMERA: Pinhole = Pinhole { width: 40, height: 30, fx: 20.0, fy: 20.0, cx: 19.5, cy: 14.5 };

    /// A view of a wall 2 m ahead from `x` on the right, in a map whose unit is 4 m.
    fn wall(x: f64) -> View {
        let pixel: Vec<u32> = (0..1200).collect();
        let keyframe = Keyframe {
            id: KeyframeId(0),
            agent: map::AgentId::default(),
            timestamp: 0.0,
            frame_index: 0,
            world_from_keyframe: Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), 0.5),
            image: Arc::new(GrayImage::filled(40, 30, 0)),
            color: None,
            scan: None,
            semi_dense: map::SemiDense {
                inverse_depth: vec![1.0; 1200].into(),
                variance: vec![0.01; 1200].into(),
                pixel: pixel.into(),
            }
            .into(),
            points: Vec::new(),
            features: None,
            words: None,
        };
        View::new(&keyframe, &CAMERA, Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0)), 4.0)
    }

    #[test]
    fn a_wall_passes_out_of_sight_as_the_camera_moves_aside() {
        assert!((wall(0.0).depth - 2.0).abs() < 1e-9);
        assert!(wall(0.0).overlap(&wall(0.0)) > 0.99);
        // The image shows 4 m of the wall.
        let half = wall(0.0).overlap(&wall(2.0));
        assert!((half - 0.5).abs() < 0.06, "{half}");
        assert_eq!(wall(0.0).overlap(&wall(4.5)), 0.0);
    }

    /// From 2 m aside of a wall 2 m ahead its points are seen from 38 to 53° apart.
    #[test]
    fn what_is_seen_from_far_aside_does_not_count() {
        assert_eq!(wall(0.0).overlap_within(&wall(2.0), 90.0), wall(0.0).overlap(&wall(2.0)));
        assert!(wall(0.0).overlap_within(&wall(0.0), 1.0) > 0.99);
        let within = |degrees| wall(0.0).overlap_within(&wall(2.0), degrees);
        assert!(within(50.0) > within(45.0) && within(45.0) > 0.0 && within(35.0) == 0.0);
    }

    #[test]
    fn the_best_pair_counts() {
        let (a, b) = ([wall(0.0), wall(3.0)], [wall(5.0), wall(50.0)]);
        assert_eq!(largest_overlap(&a, &b), a[1].overlap(&b[0]));
        assert_eq!(largest_overlap(&a, &[]), 0.0);
    }
}
