//! A robot with a low camera that drives up to a cupboard, turns on the spot and drives on: what comes into view while it turns
//! has no parallax but what a wrong focal length makes of the rotation.

use crate::{Cuboid, Recording, World};
use geometry::{Pinhole, Random, Se3};
use nalgebra::{UnitQuaternion, Vector3};

/// Frames a second.
pub const RATE: f64 = 10.0;
/// Frames of the approach, of the turn and of the drive away from it; 3 cm from one to the next.
const FRAMES: [usize; 3] = [40, 20, 45];

/// A drive by how far it turns, radians to the right, and what its focal length is taken for, as a share of the right one.
#[derive(Clone, Copy, Debug)]
pub struct Drive {
    /// Another seed, another yard behind the cupboard.
    pub seed: u64,
    /// How far it turns, radians to the right.
    pub angle: f64,
    /// What its focal length is taken for, as a share of the right one.
    pub focal: f64,
}

impl Drive {
    /// One of any seed: it turns by 30 to 90° to either side, with a focal length that is wrong by up to 5 %.
    pub fn of(seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x20b0);
        let mut number = |low: f32, high: f32| f64::from(random.uniform(low, high));
        let side = number(-1.0, 1.0).signum();
        Self { seed, angle: side * number(0.5, 1.6), focal: number(0.95, 1.05) }
    }

    /// `world_from_camera` of each frame: 20 cm above the floor, looking up by six degrees.
    pub fn path(&self) -> Vec<Se3> {
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
    pub fn world(&self) -> World {
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

    /// Its frames.
    pub fn recording(&self) -> Recording {
        Recording::render(&self.world(), Recording::SMALL_CAMERA, &self.path(), RATE)
    }

    /// What its camera is taken for.
    pub fn assumed(&self) -> Pinhole {
        let camera = Recording::SMALL_CAMERA;
        Pinhole { fx: self.focal * camera.fx, fy: self.focal * camera.fy, ..camera }
    }
}
