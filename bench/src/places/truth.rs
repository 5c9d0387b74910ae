//! Which keyframes see the same place, from the true poses.

use anyhow::{Context, Result};
use eval::{AlignMode, DEFAULT_MAX_DIFF, Trajectory, align, associate, read_trajectory};
use geometry::{Pinhole, Se3};
use map::{Keyframe, KeyframeId, Map, load_map};
use nalgebra::Vector3;
use place_recog::features::{SiftParams, sift};
use place_recog::{Vocabulary, WordBag};
use rayon::prelude::*;
use std::path::Path;

/// Points of a keyframe that are looked for in another.
const POINTS: usize = 200;

/// Two keyframes show the same place when at least this share of the points of each lies in the other's image.
pub const SAME: f64 = 0.25;
/// They show different places below this share; between the two nobody can say, and a candidate counts as
/// neither right nor wrong.
pub const DIFFERENT: f64 = 0.05;

/// A keyframe with what is known of it.
pub struct Seen {
    pub id: KeyframeId,
    pub words: WordBag,
    world_from_camera: Se3,
    /// In the world of the true poses, metres.
    points: Vec<Vector3<f64>>,
}

/// The keyframes of one map.
pub struct Sequence {
    pub name: String,
    camera: Pinhole,
    /// In order of time; those without a true pose are left out.
    pub keyframes: Vec<Seen>,
}

impl Sequence {
    /// Reads the map of a run in `run` and the true poses of the sequence in `data`.
    pub fn read(name: &str, data: &Path, run: &Path, vocabulary: &Vocabulary) -> Result<Self> {
        let map = load_map(run.join("map.mcap"))?.map;
        let truth = read_trajectory(&data.join("groundtruth.txt"))?;
        let scale = scale(&map, &truth).with_context(|| format!("{name}: the map has no scale"))?;
        let first =
            map.keyframes.values().next().with_context(|| format!("{name}: the map has no keyframes"))?;
        let camera = *map.camera(first);
        let seen = |keyframe: &Keyframe| {
            let Some(pose) = truth.pose_at(keyframe.timestamp, DEFAULT_MAX_DIFF) else { return Ok(None) };
            let words = vocabulary.words(&sift(&keyframe.image, &SiftParams::default())?);
            Ok(Some(Seen::new(keyframe, &camera, pose.rigid(), scale, words)))
        };
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        let seen: Result<Vec<Option<Seen>>> = keyframes.into_par_iter().map(seen).collect();
        Ok(Self { name: name.to_owned(), camera, keyframes: seen?.into_iter().flatten().collect() })
    }

    /// Whether two sequences were recorded in one world, which the first part of their names tells.
    pub fn shares_world(&self, other: &Self) -> bool {
        let world = |name: &str| name.split('_').next().map(str::to_owned);
        world(&self.name) == world(&other.name)
    }

    /// The share of points, 0–1, that a keyframe of this sequence and one of another have in common.
    pub fn overlap(&self, keyframe: usize, other: &Self, other_keyframe: usize) -> f64 {
        if !self.shares_world(other) {
            return 0.0;
        }
        let (a, b) = (&self.keyframes[keyframe], &other.keyframes[other_keyframe]);
        a.share_in(b, &other.camera).min(b.share_in(a, &self.camera))
    }
}

impl Seen {
    fn new(
        keyframe: &Keyframe,
        camera: &Pinhole,
        world_from_camera: Se3,
        scale: f64,
        words: WordBag,
    ) -> Self {
        let metres = scale * keyframe.world_from_keyframe.scale;
        let step = keyframe.semi_dense.len().div_ceil(POINTS).max(1);
        let point = |(pixel, inverse_depth, _): (u32, f32, f32)| {
            let (x, y) = (pixel as usize % camera.width, pixel as usize / camera.width);
            world_from_camera * (camera.unproject(x as f64, y as f64) * (metres / f64::from(inverse_depth)))
        };
        let points = keyframe.semi_dense.iter().step_by(step).map(point).collect();
        Self { id: keyframe.id, words, world_from_camera, points }
    }

    /// The share of this keyframe's points that lie in the image of another.
    fn share_in(&self, other: &Self, camera: &Pinhole) -> f64 {
        let camera_from_world = other.world_from_camera.inverse();
        let visible = |point: &&Vector3<f64>| {
            let point = camera_from_world * **point;
            let pixel = camera.project(&point);
            let inside = |v: f64, size: usize| v >= 0.0 && v <= (size - 1) as f64;
            point.z > 0.0 && inside(pixel.x, camera.width) && inside(pixel.y, camera.height)
        };
        self.points.iter().filter(visible).count() as f64 / self.points.len().max(1) as f64
    }
}

/// Metres per map unit.
fn scale(map: &Map, truth: &Trajectory) -> Result<f64> {
    let trajectory = map.trajectory();
    let estimate = Trajectory {
        timestamps: Some(trajectory.iter().map(|pose| pose.timestamp).collect()),
        world_from_camera: trajectory.iter().map(|pose| pose.world_from_camera.into()).collect(),
    };
    let pairs = associate(&estimate, truth, DEFAULT_MAX_DIFF)?;
    Ok(align(&pairs, AlignMode::Sim3)?.0.scale)
}
