//! The maps of many agents that drive through one rendered town, each in a world and a unit of its own.

use crate::measure::{finish, make_empty};
use crate::merging::Program;
use crate::merging::moved;
use anyhow::{Context, Result};
use eval::{DEFAULT_MAX_DIFF, read_trajectory};
use geometry::Random;
use geometry::{GrayImage, Image, Se3, Sim3};
use image::{ImageBuffer, Luma};
use loopbox_tests::{Encoding, RING, Recording, Shot, World, render, trajectory};
use map::{AgentInfo, Edge, KeyframeId, Map, Shared};
use measuring::views::{View, views};
use nalgebra::{SVector, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Metres between keyframes.
const STEP: f64 = 0.25;
/// How much farther along the way each agent begins, in parts of its own length: four agents see each place.
const APART: f64 = 0.25;
/// Values of the depth images at a metre.
const DEPTH_SCALE: f64 = 1000.0;
/// Standard deviation of an image's noise, grey levels.
const NOISE: f64 = 2.0;
/// Standard deviations of the drift from keyframe to keyframe: translation in parts of the step, rotation in radians, scale
/// in parts; what maps of rendered images have.
const DRIFT: [f64; 3] = [0.003, 4e-4, 5e-4];
/// Deviations of the edges between keyframes, as `loopbox import` has them: translation in parts of the depth, rotation in
/// radians, scale in parts.
const EDGE: [f64; 3] = [0.01, 0.005, 0.01];

/// The map of an agent.
pub struct CrowdMap {
    /// What its agent is called.
    pub name: String,
    /// The map's file.
    pub file: PathBuf,

    /// Poses of its keyframes in its own world, by their times.
    pub own: Vec<(f64, Sim3)>,
    /// What its keyframes see, metres.
    pub views: Vec<View>,
    /// Metres per unit of its keyframes.
    pub metres: f64,
}

/// The files of a map: the map and the true poses, and metres per unit of its keyframes.
struct Files {
    map: PathBuf,
    truth: PathBuf,
    metres: f64,
}

/// The map of agent `number` with so many keyframes, made unless it is there.
///
/// # Errors
/// When files cannot be written or read, or the program fails.
pub fn make(
    number: usize,
    agents: usize,
    keyframes: usize,
    program: &Program,
    folder: &Path,
) -> Result<CrowdMap> {
    let Files { map: file, truth, metres } = files(number, agents, keyframes, program, folder)?;
    let (map, truth) = (map::load_map(&file)?.map, read_trajectory(&truth)?);
    let own = map.keyframes.values().map(|keyframe| (keyframe.timestamp, keyframe.world_from_keyframe));
    let own = own.collect();
    // Views take the unit of the map's world, which drifts here; that of the keyframes does not.
    let mut upright = map.clone();
    upright.keyframes.values_mut().for_each(|keyframe| keyframe.world_from_keyframe.scale = 1.0);
    let views = views(&upright, &truth, metres);
    Ok(CrowdMap { name: name_of(number), file, own, views, metres })
}

/// The file of the map of agent `number` with so many keyframes, made unless it is there.
///
/// # Errors
/// When files cannot be written or read, or the program fails.
pub fn file(
    number: usize,
    agents: usize,
    keyframes: usize,
    program: &Program,
    folder: &Path,
) -> Result<PathBuf> {
    Ok(files(number, agents, keyframes, program, folder)?.map)
}

fn files(number: usize, agents: usize, keyframes: usize, program: &Program, folder: &Path) -> Result<Files> {
    let home = folder.join(name_of(number));
    let (file, truth) = (home.join("map.mcap"), home.join("truth.txt"));
    let mut random = Random::new(0xc0de + number as u64);
    let metres = 0.5 + 1.5 * random.unit();
    if !truth.is_file() {
        let recording = folder.join(format!("recording-{number:03}"));
        make_empty(&home)?;
        render_path(number, agents, keyframes, &mut random, &recording)?;
        let mut command = Command::new(&program.loopbox);
        command.arg("import").arg(&recording).arg("--out").arg(&file).arg("--force");
        finish(command.args(["--layout", "tum", "--depth-scale", &DEPTH_SCALE.to_string()]))?;
        let mut map = map::load_map(&file)?.map;
        drift(&mut map, &mut random);
        map.agents.values_mut().for_each(|info| *info = unmeasured(info, number));
        let rotation = UnitQuaternion::from_euler_angles(random.unit(), random.unit(), random.unit());
        let shift = Vector3::from_fn(|_, _| 40.0 * (random.unit() - 0.5));
        // The whole map in other units, and its keyframes in theirs.
        let elsewhere = Sim3::new(rotation, shift, 0.4 + random.unit());
        map::save_map(&file, &moved(&map, &elsewhere, metres))?;
        let context = || format!("{}: cannot be kept", truth.display());
        std::fs::copy(recording.join("groundtruth.txt"), &truth).with_context(context)?;
        std::fs::remove_dir_all(&recording).with_context(context)?;
    }
    Ok(Files { map: file, truth, metres })
}

/// What an agent is called.
pub fn name_of(number: usize) -> String {
    format!("agent-{number:03}")
}

/// The way of an agent: a stretch of the town's, a little beside it.
fn agent_path(number: usize, keyframes: usize, random: &mut Random) -> Vec<Se3> {
    let first = (number as f64 * APART * keyframes as f64) as usize;
    let all = trajectory::town(first + keyframes, STEP);
    let mut jitter = |reach: f64| reach * (2.0 * random.unit() - 1.0);
    let offset = Vector3::new(jitter(0.3), jitter(0.15), jitter(0.3));
    let rotation = UnitQuaternion::from_euler_angles(jitter(0.03), jitter(0.12), jitter(0.03));
    all[first..].iter().map(|pose| *pose * Se3::new(rotation, offset)).collect()
}

/// Renders the recording of an agent with depth images, in TUM's layout.
fn render_path(
    number: usize,
    agents: usize,
    keyframes: usize,
    random: &mut Random,
    folder: &Path,
) -> Result<()> {
    let metres = STEP * keyframes as f64 * (1.0 + APART * agents as f64);
    let world = World::town(3, (metres / (3.0 * std::f64::consts::PI * RING)).ceil() as usize + 1);
    let path = agent_path(number, keyframes, random);
    let (gain, seed) = (0.8 + 0.3 * random.unit(), random.bits());
    make_empty(folder)?;
    let camera = Recording::SMALL_CAMERA;
    let time = |i: usize| (number * 100_000 + i) as f64 * 0.1;
    let name = |kind: &str, i: usize| format!("{kind}-{i:06}.png");
    path.par_iter().enumerate().try_for_each(|(i, pose)| -> Result<()> {
        let (image, inverse_depth) = render(&world, &camera, pose);
        let image = exposed(&image, gain, &mut Random::new(seed ^ ((i as u64) << 20)));
        let context = || format!("{}: cannot be written to", folder.display());
        std::fs::write(folder.join(name("image", i)), Encoding::Png.encode(&image)?).with_context(context)?;
        depth_image(&inverse_depth).save(folder.join(name("depth", i))).with_context(context)
    })?;
    let list = |kind: &str| {
        let mut text = String::new();
        (0..path.len()).for_each(|i| {
            let _ = writeln!(text, "{:.6} {}", time(i), name(kind, i));
        });
        text
    };
    let shot = |(i, pose): (usize, &Se3)| Shot {
        timestamp: time(i),
        world_from_camera: *pose,
        image: GrayImage::filled(1, 1, 0).into(),
    };
    let recording = Recording { camera, shots: path.iter().enumerate().map(shot).collect() };
    for (name, text) in [
        ("rgb.txt", list("image")),
        ("depth.txt", list("depth")),
        ("groundtruth.txt", recording.ground_truth()),
        ("camera.yaml", recording.camera_yaml()),
    ] {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(())
}

/// An image at another exposure, with noise.
fn exposed(image: &GrayImage, gain: f64, random: &mut Random) -> GrayImage {
    let mut image = image.clone();
    for value in image.data_mut() {
        *value = (gain * f64::from(*value) + NOISE * normal(random)).round().clamp(0.0, 255.0) as u8;
    }
    image
}

fn depth_image(inverse_depth: &Image<f32>) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    let (width, height) = (inverse_depth.width(), inverse_depth.height());
    ImageBuffer::from_fn(width as u32, height as u32, |x, y| {
        let inverse = f64::from(inverse_depth.get(x as usize, y as usize));
        let depth = if inverse > 0.0 { DEPTH_SCALE / inverse } else { 0.0 };
        // What is farther has none.
        Luma([if depth < 65_000.0 { depth.round() as u16 } else { 0 }])
    })
}

/// Sum of twelve uniform numbers: of deviation 1, nearly normal.
fn normal(random: &mut Random) -> f64 {
    (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
}

/// An agent whose unit nobody knows.
fn unmeasured(info: &AgentInfo, number: usize) -> AgentInfo {
    let mut other = AgentInfo::new(name_of(number), *info.camera().unwrap_or(&Recording::SMALL_CAMERA));
    other.identity = info.identity;
    other
}

/// Makes the true poses of a map those of one that drifted, and its depths those of noisy ones.
fn drift(map: &mut Map, random: &mut Random) {
    let truth: Vec<(KeyframeId, Sim3)> =
        map.keyframes.values().map(|keyframe| (keyframe.id, keyframe.world_from_keyframe)).collect();
    let mut pose = truth.first().map_or(Sim3::identity(), |first| first.1);
    for pair in truth.windows(2) {
        let step = pair[0].1.inverse() * pair[1].1;
        let [t, r, s] = [DRIFT[0] * step.translation.norm(), DRIFT[1], DRIFT[2]];
        let noise = SVector::from([t, t, t, r, r, r, s]).map(|deviation: f64| deviation * normal(random));
        pose = pose * step * Sim3::exp(&noise);
        if let Some(keyframe) = map.keyframes.get_mut(&pair[1].0) {
            keyframe.world_from_keyframe = pose;
        }
    }
    for keyframe in map.keyframes.values_mut() {
        let mut depths = (*keyframe.semi_dense).clone();
        for (depth, variance) in depths.inverse_depth.iter_mut().zip(&depths.variance) {
            let noisy = f64::from(*depth) + f64::from(variance.sqrt()) * normal(random);
            *depth = (noisy as f32).max(0.2 * *depth);
        }
        keyframe.semi_dense = Shared::from(depths);
    }
    let keyframes: Vec<_> = map.keyframes.values().collect();
    let edge = |pair: &[&map::Keyframe]| {
        let median = pair[0].semi_dense.median_depth().unwrap_or(1.0);
        Edge::odometry(pair[0], pair[1], [EDGE[0] * median, EDGE[1], EDGE[2]])
    };
    let edges = keyframes.windows(2).map(edge).collect();
    map.edges = edges;
}

impl CrowdMap {
    /// Its pose at a time, in its own world.
    pub fn own_at(&self, time: f64) -> Option<Sim3> {
        self.own.iter().find(|(at, _)| (at - time).abs() <= DEFAULT_MAX_DIFF).map(|(_, pose)| *pose)
    }

    /// Its true pose at a time, and the median depth of what it sees there, metres.
    pub fn truth_at(&self, time: f64) -> Option<(Se3, f64)> {
        let view = self.views.iter().find(|view| (view.timestamp - time).abs() <= DEFAULT_MAX_DIFF)?;
        Some((view.world_from_camera, view.depth))
    }
}
