//! Recordings of a hand-held camera to which something happens half-way: 640 × 480 pixels, with noise and motion blur.

use crate::similar_places::Kind;
use crate::{Recording, Shot, World, render, trajectory};
use geometry::Random;
use geometry::{GrayImage, Pinhole, Se3};
use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::sync::Arc;

/// Frames a second.
const RATE: f64 = 30.0;
/// Frames before something happens.
const BEFORE: usize = 200;
/// Frames after it.
const AFTER: usize = 150;
/// How long the shutter is open, share of the time from frame to frame; and of how many images a frame is the mean.
const SHUTTER: (f64, usize) = (0.5, 4);
/// Standard deviation of the noise, grey levels.
const NOISE: f32 = 3.0;
/// What a covered or blind camera shows, grey level.
const DARK: u8 = 4;

/// What happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    None,
    /// The camera is blind for a second while it moves on.
    Black,
    /// The same image comes for a second while it moves on.
    Frozen,
    /// No image comes for a second while it moves on.
    Dropped,
    /// It turns by 90° on the spot, and back.
    Turned,
    /// Its lens is covered for five seconds while it moves on.
    Covered,
    /// It is carried elsewhere with its lens covered, is used there, and is carried back to where it was.
    Carried,
    /// With its lens covered for two seconds it is carried to another place that looks like the one it knows, and is used
    /// there: kinds of places in turn ([`Kind`]).
    SimilarPlace,
    /// With its lens covered for two seconds it is moved aside, nearer or farther, and rolled: it sees the place from there.
    Aside,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::None,
        Self::Black,
        Self::Frozen,
        Self::Dropped,
        Self::Turned,
        Self::Covered,
        Self::Carried,
        Self::SimilarPlace,
        Self::Aside,
    ];

    /// The places that the recording shows, each of which makes a map.
    pub fn places(self) -> usize {
        1 + usize::from(matches!(self, Self::Carried | Self::SimilarPlace))
    }
}

/// What there is to see in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shows {
    /// Where the camera is.
    Place,
    /// Where it was carried to.
    Elsewhere,
    /// Nothing, or not what is before the camera now.
    Nothing,
}

/// A recording, and what there is to see in each of its frames.
pub struct Faulty {
    /// The frames. Poses elsewhere are in that world, which has nothing to do with the other.
    pub recording: Recording,
    /// What each shows.
    pub shows: Vec<Shows>,
}

/// A recording with a fault; another seed gives another world and way.
pub fn faulty(fault: Fault, seed: u64) -> Faulty {
    let camera = Pinhole { width: 640, height: 480, fx: 420.0, fy: 420.0, cx: 319.5, cy: 239.5 };
    let film = |world: &World, path: &[Se3]| Film { camera, seed }.shots(world, path);
    let kind = Kind::ALL[seed as usize % Kind::ALL.len()];
    let world = if fault == Fault::SimilarPlace { kind.place(seed, 0) } else { World::yard(seed) };
    let gap = match fault {
        Fault::None | Fault::Turned | Fault::Carried | Fault::SimilarPlace => 0,
        Fault::Black | Fault::Frozen | Fault::Dropped => 30,
        Fault::Covered => 150,
        Fault::Aside => 60,
    };
    let mut path = trajectory::walk(BEFORE + gap + AFTER, RATE, seed);
    if fault == Fault::Aside {
        let moved = aside(seed);
        path[BEFORE + gap..].iter_mut().for_each(|pose| *pose = *pose * moved);
    }
    if fault == Fault::SimilarPlace {
        path = kind.path(seed, 0, 0, BEFORE);
    }
    let mut made = Faulty { recording: Recording { camera, shots: Vec::new() }, shows: Vec::new() };
    let (before, after) = (film(&world, &path[..BEFORE]), film(&world, &path[BEFORE + gap..]));
    let blind = |pose: &Se3| Shot { timestamp: 0.0, world_from_camera: *pose, image: dark(&camera) };
    let last = before.last().cloned();
    made.add(before, Shows::Place);
    match fault {
        Fault::None | Fault::Dropped => {}
        Fault::Black | Fault::Covered | Fault::Aside => {
            made.add(path[BEFORE..BEFORE + gap].iter().map(blind), Shows::Nothing);
        }
        Fault::Frozen => {
            let still = |pose: &Se3| Some(Shot { world_from_camera: *pose, ..last.clone()? });
            made.add(path[BEFORE..BEFORE + gap].iter().filter_map(still), Shows::Nothing);
        }
        Fault::Turned => {
            let there = trajectory::turning(path[BEFORE - 1], 46, std::f64::consts::FRAC_PI_2);
            let back: Vec<Se3> = there.iter().rev().copied().collect();
            made.add(film(&world, &[&there[1..], &back[1..]].concat()), Shows::Place);
        }
        Fault::Carried => {
            let other = trajectory::walk(AFTER, RATE, seed + 1000);
            made.add((0..15).map(|_| blind(&path[BEFORE])), Shows::Nothing);
            made.add(film(&World::yard(seed + 1000), &other), Shows::Elsewhere);
            made.add((0..15).map(|_| blind(&path[BEFORE])), Shows::Nothing);
        }
        Fault::SimilarPlace => {
            made.add((0..60).map(|_| blind(&path[BEFORE - 1])), Shows::Nothing);
            made.add(film(&kind.place(seed, 1), &kind.path(seed, 1, 0, AFTER)), Shows::Elsewhere);
        }
    }
    made.add(after, Shows::Place);
    let missing = if fault == Fault::Dropped { gap } else { 0 };
    for (i, shot) in made.recording.shots.iter_mut().enumerate() {
        let number = if i < BEFORE { i } else { i + missing };
        shot.timestamp = number as f64 / RATE;
    }
    made
}

impl Faulty {
    fn add(&mut self, shots: impl IntoIterator<Item = Shot>, shows: Shows) {
        self.recording.shots.extend(shots);
        self.shows.resize(self.recording.shots.len(), shows);
    }
}

/// How a camera is moved that sees a place again from elsewhere, `before_from_after`: 1 to 1.6 metres to the side, looking
/// back at the boxes 4 metres ahead, 0.3 to 1 metre nearer or farther, and rolled by 20 to 40°.
fn aside(seed: u64) -> Se3 {
    let mut random = Random::new(seed ^ 0x0a51de);
    let mut number = |low: f32, high: f32| f64::from(random.uniform(low, high));
    let mut either = |low: f32, high: f32| number(low, high) * number(-1.0, 1.0).signum();
    let (right, ahead, roll) = (either(1.0, 1.6), either(0.3, 1.0), either(20.0, 40.0).to_radians());
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -(right / 4.0).atan());
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    Se3::new(yaw * roll, Vector3::new(right, 0.0, ahead))
}

/// An image of nothing.
fn dark(camera: &Pinhole) -> Arc<GrayImage> {
    Arc::new(GrayImage::filled(camera.width, camera.height, DARK))
}

struct Film {
    camera: Pinhole,
    seed: u64,
}

impl Film {
    /// Frames of a camera on this path, without time stamps.
    fn shots(&self, world: &World, path: &[Se3]) -> Vec<Shot> {
        let exposed = |(i, pose): (usize, &Se3)| {
            let motion = path.get(i + 1).map_or_else(Se3::identity, |next| pose.inverse() * *next);
            let open: Vec<GrayImage> = (0..SHUTTER.1)
                .map(|part| {
                    let share = SHUTTER.0 * (part as f64 / (SHUTTER.1 - 1) as f64 - 0.5);
                    render(world, &self.camera, &(*pose * Se3::exp(&(motion.log() * share)))).0
                })
                .collect();
            let image = self.noisy(&open, i as u64);
            Shot { timestamp: 0.0, world_from_camera: *pose, image: Arc::new(image) }
        };
        path.par_iter().enumerate().map(exposed).collect()
    }

    /// The mean of images, with noise.
    fn noisy(&self, open: &[GrayImage], frame: u64) -> GrayImage {
        let mut random = Random::new(self.seed.wrapping_mul(0x2545_f491).wrapping_add(frame));
        let mut image = GrayImage::filled(self.camera.width, self.camera.height, 0);
        for (i, pixel) in image.data_mut().iter_mut().enumerate() {
            let sum: u32 = open.iter().map(|image| u32::from(image.data()[i])).sum();
            // Four uniform numbers are nearly normal; their variance is 4/12.
            let normal = (0..4).map(|_| random.uniform(-0.5, 0.5)).sum::<f32>() * 3f32.sqrt();
            *pixel = (sum as f32 / open.len() as f32 + NOISE * normal).round().clamp(0.0, 255.0) as u8;
        }
        image
    }
}
