//! Recordings of a camera that is covered while it passes a place, and uncovered there or in a double of the place.

use crate::doubles::{Kind, Version};
use crate::{Recording, Shot, World};
use geometry::{GrayImage, Se3};
use std::sync::Arc;

/// Frames a second.
pub const RATE: f64 = 30.0;
/// Frames before the camera is covered.
pub const BEFORE: usize = 120;
/// Frames while it is.
pub const COVERED: usize = 24;
/// Frames after.
pub const AFTER: usize = 90;
/// Standard deviation of the noise, grey levels.
const NOISE: f64 = 2.0;
/// What a covered camera shows, grey level.
const DARK: u8 = 4;

/// Where the camera is uncovered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Uncovered {
    /// Where it was covered, and goes back; this share of the things has moved meanwhile, 0–1.
    There(f64),
    /// In the same place, on another way past it, with this share moved.
    Passing(f64),
    /// Nowhere near: in another place of the kind, of which this share of the things differs, 0–1, where it was in this one.
    Elsewhere(f64),
    /// The same, on another way past that place.
    PassingElsewhere(f64),
}

impl Uncovered {
    /// Whether it is where it was.
    pub fn is_there(self) -> bool {
        matches!(self, Self::There(_) | Self::Passing(_))
    }
}

/// [`BEFORE`] frames past a place of a kind, [`COVERED`] dark ones, [`AFTER`] frames of what is there when it is uncovered; each surface
/// has a grain of its own with this standard deviation, grey levels.
pub fn covered(kind: Kind, seed: u64, uncovered: Uncovered, grain: f32) -> Recording {
    let here = Version::first(seed, grain);
    let first = kind.path(2 * seed, BEFORE);
    let back: Vec<Se3> = first.iter().rev().take(AFTER).copied().collect();
    let (version, travelled) = match uncovered {
        Uncovered::There(moved) => (Version { time: 1, moved, ..here }, back),
        Uncovered::Passing(moved) => (Version { time: 1, moved, ..here }, kind.path(2 * seed + 1, AFTER)),
        Uncovered::Elsewhere(share) => (Version { place: 1, share, ..here }, back),
        Uncovered::PassingElsewhere(share) => {
            (Version { place: 1, share, ..here }, kind.path(2 * seed + 1, AFTER))
        }
    };
    let camera = Recording::SMALL_CAMERA;
    let mut recording = Recording { camera, shots: noisy(&kind.world(&here), &first, seed) };
    let dark = Arc::new(GrayImage::filled(camera.width, camera.height, DARK));
    let blind = Shot { timestamp: 0.0, world_from_camera: first[BEFORE - 1], image: dark };
    recording.shots.extend(std::iter::repeat_n(blind, COVERED));
    recording.shots.extend(noisy(&kind.world(&version), &travelled, seed ^ 0xc0));
    for (i, shot) in recording.shots.iter_mut().enumerate() {
        shot.timestamp = i as f64 / RATE;
    }
    recording
}

/// Frames on a path, with noise, without time stamps.
fn noisy(world: &World, path: &[Se3], seed: u64) -> Vec<Shot> {
    Recording::render(world, Recording::SMALL_CAMERA, path, RATE).with_noise(NOISE, seed).shots
}
