//! Recordings in which something moves before the camera: a board that is carried past, a person, a lorry, a lorry that drives off.

use crate::{Cuboid, Recording, Shot, Texture, World, render, trajectory};
use geometry::{Random, Se3};
use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::sync::Arc;

/// Frames a second.
pub const RATE: f64 = 30.0;
/// Frames of a recording.
pub const FRAMES: usize = 240;
/// The frame in the middle of what happens.
const MIDDLE: usize = 140;
/// Standard deviation of the noise, grey levels.
const NOISE: f64 = 2.0;

/// What moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mover {
    /// A board with a picture on it, which is carried across the view, turned and held for a while.
    Board,
    /// A person who walks across, swinging arms and legs.
    Person,
    /// A lorry that drives past at 4 m/s between the camera and what it looks at.
    Lorry,
    /// A lorry that stands there from the beginning and drives off.
    Departing,
    /// A person who stands there from the beginning and walks off.
    Leaving,
}

impl Mover {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Board, Self::Person, Self::Lorry, Self::Departing, Self::Leaving];
}

/// A recording with what moves in it, and the share of each image, 0–1, that shows it.
pub struct Moving {
    /// The frames; the poses are those of the camera in the world that stands still.
    pub recording: Recording,
    /// Share of the pixels that would look otherwise without what moves.
    pub covered: Vec<f64>,
}

/// A recording in which `mover` covers about `coverage` of the image, 0–1, while it is whole in view.
pub fn moving(mover: Mover, coverage: f64, seed: u64) -> Moving {
    let camera = Recording::SMALL_CAMERA;
    let world = World::yard(seed);
    let path = match mover {
        Mover::Board | Mover::Person | Mover::Leaving => trajectory::walk(FRAMES, RATE, seed),
        Mover::Lorry | Mover::Departing => trajectory::sideways(FRAMES, 4.0 + (seed % 3) as f64),
    };
    let part = Part::of(mover, coverage, seed, path[MIDDLE]);
    let frame = |(i, pose): (usize, &Se3)| {
        let still = render(&world, &camera, pose).0;
        let seen = render(&with(&world, &part, i), &camera, pose).0;
        let other = still.data().iter().zip(seen.data()).filter(|(a, b)| a != b).count();
        let shot = Shot { timestamp: i as f64 / RATE, world_from_camera: *pose, image: Arc::new(seen) };
        (shot, other as f64 / still.data().len() as f64)
    };
    let frames: Vec<(Shot, f64)> = path.par_iter().enumerate().map(frame).collect();
    let (shots, covered) = frames.into_iter().unzip();
    Moving { recording: Recording { camera, shots }.with_noise(NOISE, seed), covered }
}

/// What moves: boxes of one texture about a place that moves.
struct Part {
    mover: Mover,
    /// Where it is while it covers most: its axes are x to the right, y down, z away from the camera.
    world_from_middle: Se3,
    /// Of a lorry: its size over that of the largest.
    size: f64,
    /// Along x, negative to come from the other side.
    direction: f64,
    texture: Texture,
}

impl Part {
    fn of(mover: Mover, coverage: f64, seed: u64, world_from_camera: Se3) -> Self {
        let mut random = Random::new(seed ^ 0x0b0a);
        let camera = Recording::SMALL_CAMERA;
        let view = (camera.width * camera.height) as f64 / (camera.fx * camera.fy);
        // How far away so large a face covers so much; a lorry is longer than the view is wide.
        let away = match mover {
            Mover::Board => (0.36 / (coverage * view)).sqrt(),
            Mover::Person | Mover::Leaving => (0.6 / (coverage * view)).sqrt(),
            Mover::Lorry | Mover::Departing => 3.5,
        };
        let mut position = world_from_camera * Vector3::new(0.0, 0.0, away.clamp(0.5, 3.5));
        // A van covers less than a lorry: the sides that are seen are so many times as high as its.
        let size = (coverage / 0.6).clamp(0.3, 1.0);
        let yaw = match mover {
            Mover::Board => 0.4,
            Mover::Person | Mover::Leaving => -0.3,
            Mover::Lorry | Mover::Departing => 0.0,
        };
        // What stands on the ground does so at y = 0.
        match mover {
            Mover::Board => {}
            Mover::Person | Mover::Leaving => position.y = -0.9,
            Mover::Lorry | Mover::Departing => position.y = -1.3 * size,
        }
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
        Self {
            mover,
            size,
            world_from_middle: Se3::new(rotation, position),
            direction: if random.uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 },
            texture: Texture::varied(seed.wrapping_mul(97).wrapping_add(5)),
        }
    }

    /// Its boxes in a frame: where the middle of each is, how it is turned, and half its extent.
    fn boxes(&self, frame: usize) -> Vec<(Se3, Vector3<f64>)> {
        let time = (frame as f64 - MIDDLE as f64) / RATE;
        let at = |x: f64, y: f64, z: f64| {
            Se3::new(UnitQuaternion::identity(), Vector3::new(x * self.direction, y, z))
        };
        match self.mover {
            // 1 m/s across, but for a second in the middle, in which it is held nearly still.
            Mover::Board => {
                let x = if time.abs() < 0.5 { 0.1 * time } else { time - 0.45 * time.signum() };
                let turned = UnitQuaternion::from_euler_angles(0.05 * time, 0.2 * time, 0.08 * time);
                let pose = at(x, 0.03 * (5.0 * time).sin(), 0.0) * Se3::new(turned, Vector3::zeros());
                vec![(pose, Vector3::new(0.3, 0.3, 0.005))]
            }
            Mover::Person => self.person(time),
            Mover::Leaving => self.person(time.max(0.0)),
            Mover::Lorry => self.lorry(4.0 * time),
            // It stands until the middle, and gathers speed by 1.2 m/s².
            Mover::Departing => self.lorry(0.6 * time.max(0.0).powi(2)),
        }
    }

    /// Someone who walks at 1.1 m/s and is in the middle at time 0.
    fn person(&self, time: f64) -> Vec<(Se3, Vector3<f64>)> {
        let at = |x: f64, y: f64, z: f64| {
            Se3::new(UnitQuaternion::identity(), Vector3::new(x * self.direction, y, z))
        };
        let swing = |x: f64, y: f64, angle: f64, half: Vector3<f64>| {
            let hip = at(x, y, 0.0);
            let turned = Se3::new(
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle * self.direction),
                Vector3::zeros(),
            );
            (hip * turned * Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, half.y, 0.0)), half)
        };
        let (x, step) = (1.1 * time, 0.5 * (5.5 * time).sin());
        let bob = 0.02 * (11.0 * time).sin();
        vec![
            (at(x, -0.2 + bob, 0.0), Vector3::new(0.2, 0.35, 0.12)),
            (at(x, -0.72 + bob, 0.0), Vector3::new(0.09, 0.13, 0.1)),
            swing(x, 0.12, step, Vector3::new(0.08, 0.39, 0.09)),
            swing(x, 0.12, -step, Vector3::new(0.08, 0.39, 0.09)),
            swing(x, -0.5, -0.8 * step, Vector3::new(0.05, 0.3, 0.2)),
        ]
    }

    fn lorry(&self, x: f64) -> Vec<(Se3, Vector3<f64>)> {
        let size = self.size;
        let part = |from_middle: f64, y: f64, half: Vector3<f64>| {
            let at = Vector3::new((x + size * from_middle) * self.direction, size * y, 1.2 * size);
            (Se3::new(UnitQuaternion::identity(), at), half * size)
        };
        vec![
            part(0.0, -0.2, Vector3::new(2.6, 1.2, 1.2)),
            part(3.4, 0.1, Vector3::new(0.7, 0.9, 1.15)),
            part(0.0, 1.2, Vector3::new(2.4, 0.2, 1.0)),
        ]
    }
}

/// The world with what moves where it is in a frame.
fn with(world: &World, part: &Part, frame: usize) -> World {
    let mut textures = world.textures.clone();
    textures.push(part.texture.clone());
    let cuboid = |(i, (pose, half)): (usize, (Se3, Vector3<f64>))| Cuboid {
        world_from_cuboid: part.world_from_middle * pose,
        half,
        texture: world.textures.len(),
        texel: half.max() / 250.0,
        offset: [97.0 * i as f32, 211.0 * i as f32],
    };
    let boxes = part.boxes(frame).into_iter().enumerate().map(cuboid);
    World { cuboids: world.cuboids.iter().copied().chain(boxes).collect(), textures }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_covers_about_as_much_as_asked_and_is_gone_in_the_end() {
        for mover in Mover::ALL {
            let covered = moving(mover, 0.4, 1).covered;
            let most = covered.iter().copied().fold(0.0, f64::max);
            assert!(most > 0.15, "{mover:?}: {most}");
            let stands = matches!(mover, Mover::Departing | Mover::Leaving);
            let (before, expected) = if stands { (MIDDLE - 20, 0.15..0.7) } else { (0, 0.0..0.02) };
            assert!(expected.contains(&covered[before]), "{mover:?}: {covered:?}");
            assert!(covered[FRAMES - 1] < 0.05, "{mover:?}: {covered:?}");
        }
    }
}
