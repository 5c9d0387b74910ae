//! A robot with a low camera that drives up to a cupboard, turns on the spot and drives on: what comes into view while it turns
//! has no parallax but what a wrong focal length makes of the rotation.

use super::*;
use loopbox_tests::Cuboid;
use nalgebra::{UnitQuaternion, Vector3};

/// Frames of the approach, of the turn and of the drive away from it; 3 cm from one to the next, at 10 a second.
const FRAMES: [usize; 3] = [40, 20, 45];

/// A drive by how far it turns, radians to the right, and what its focal length is taken for, as a share of the right one.
struct Drive {
    seed: u64,
    angle: f64,
    focal: f64,
}

impl Drive {
    /// `world_from_camera` of each frame: 20 cm above the floor, looking up by six degrees.
    fn path(&self) -> Vec<Se3> {
        let pose = |x: f64, z: f64, yaw: f64| {
            let yaw = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
            let up = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.1);
            Se3::new(yaw * up, Vector3::new(x, -0.2, z))
        };
        let [approach, rotation, away] = FRAMES;
        let (x, z) = (-0.3, -3.0);
        let there = z + 0.03 * approach as f64;
        let approach = (0..approach).map(|i| pose(x, z + 0.03 * i as f64, 0.0));
        let rotation = (0..rotation)
            .map(|i| pose(x, there + 0.002 * i as f64, self.angle * (i as f64 + 1.0) / rotation as f64));
        let (sin, cos) = self.angle.sin_cos();
        let away = (0..away).map(|i| 0.03 * i as f64);
        let away = away.map(|d| pose(x + d * sin, there + 0.04 + d * cos, self.angle));
        approach.chain(rotation).chain(away).collect()
    }

    /// A room without texture on its floor, and a cupboard and a chest that the robot drives up to.
    fn world(&self) -> World {
        let mut world = World::yard(self.seed);
        let is_seen = |c: &Cuboid| {
            let is_wall = c.half.x > 3.0 || c.half.z > 3.0;
            c.half.y > 0.0 && (is_wall || c.world_from_cuboid.translation.z > 6.0)
        };
        world.cuboids.retain(is_seen);
        let stood = |(x, z, half): (f64, f64, Vector3<f64>)| Cuboid {
            world_from_cuboid: Se3::new(UnitQuaternion::identity(), Vector3::new(x, -half.y, z)),
            half,
            texture: 0,
            texel: 0.004,
            offset: [100.0 * self.seed as f32, 50.0],
        };
        let near = [(-0.3, -0.9, Vector3::new(0.7, 0.6, 0.2)), (0.9, -0.6, Vector3::new(0.25, 0.2, 0.2))];
        world.cuboids.extend(near.map(stood));
        world
    }

    /// What the tracker makes of it: the reports and the fragments' maps.
    fn track(&self) -> (Vec<FrameReport>, Vec<Map>) {
        let camera = Recording::SMALL_CAMERA;
        let recording = Recording::render(&self.world(), camera, &self.path(), 10.0);
        let assumed = Pinhole { fx: self.focal * camera.fx, fy: self.focal * camera.fy, ..camera };
        let mut atlas =
            Atlas::new(assumed, || Box::new(ThumbnailIndex::default()), Params::default()).expect("a camera");
        let frame = |(i, shot): (usize, &loopbox_tests::Shot)| Frame {
            index: i as u64,
            timestamp: shot.timestamp,
            image: shot.image.as_ref().clone(),
            color: None,
        };
        let shots = recording.shots.iter().enumerate();
        let reports = shots.map(|shot| atlas.process(frame(shot)).expect("it is of the size")).collect();
        atlas.finish_until(&|| false);
        (reports, atlas.into_maps())
    }

    /// Largest ratio of the scales of two stretches of three seconds of a map, each over the truth.
    fn worst_ratio(&self, map: &Map) -> f64 {
        const STRETCH: u64 = 30;
        let truth = self.path();
        let poses: Vec<(u64, Vector3<f64>)> = map
            .frames
            .iter()
            .map(|frame| frame.frame_index)
            .zip(map.trajectory().iter().map(|pose| pose.world_from_camera.translation))
            .collect();
        let scale = |first: u64| {
            let own = poses.iter().filter(|(i, _)| (first..first + STRETCH).contains(i));
            let (found, exact): (Vec<_>, Vec<_>) =
                own.map(|(i, found)| (*found, truth[*i as usize].translation)).unzip();
            // Of a turn on the spot alone nothing is said.
            let is_enough = found.len() as u64 > STRETCH / 2 && spread(&exact) > 0.05;
            is_enough.then(|| spread(&found) / spread(&exact))
        };
        let scales: Vec<f64> = (0..truth.len() as u64 - STRETCH).step_by(5).filter_map(scale).collect();
        let (least, most) = scales.iter().fold((f64::INFINITY, 0.0f64), |(l, m), s| (l.min(*s), m.max(*s)));
        most / least
    }
}

/// Root mean square distance from the mean.
fn spread(points: &[Vector3<f64>]) -> f64 {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    (points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / count).sqrt()
}

/// Nothing of the cupboard is in view after the turn: the map ends there and says why, and another one begins.
#[test]
fn a_scale_that_a_pure_rotation_does_not_carry_is_lost_and_not_made_up() {
    for (seed, angle, focal) in [(5, 1.57, 0.96), (7, 1.4, 1.05), (8, -1.4, 0.95)] {
        let drive = Drive { seed, angle, focal };
        let (reports, maps) = drive.track();
        let lost = reports.iter().position(|report| report.state == TrackingState::Lost).expect("it is lost");
        assert!(
            (50..75).contains(&lost) && reports[lost].loss == Some(LossReason::Scale),
            "{seed}: lost at {lost}"
        );
        assert!(reports[lost].reason.is_some_and(|why| why.contains("scale")));
        assert_eq!(maps.len(), 2, "{seed}");
        for map in &maps {
            let ratio = drive.worst_ratio(map);
            assert!(map.frames.len() >= 30 && ratio < 1.5, "{seed}: {} frames, {ratio}", map.frames.len());
        }
    }
}

/// A part of the cupboard stays in view: its points carry the scale over the turn.
#[test]
fn a_scale_that_points_in_view_carry_is_kept_over_a_pure_rotation() {
    let drive = Drive { seed: 3, angle: 1.1, focal: 1.04 };
    let (reports, maps) = drive.track();
    assert!(reports.iter().all(|report| report.state != TrackingState::Lost && report.loss.is_none()));
    assert_eq!(maps.len(), 1);
    let (frames, ratio) = (maps[0].frames.len(), drive.worst_ratio(&maps[0]));
    assert!(frames == drive.path().len() && ratio < 1.1, "{frames} frames, {ratio}");
}
