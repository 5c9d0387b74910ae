//! The maps: places rendered, and mapped by the program.

use crate::merging::Program;
use crate::merging::truth::Side;
use crate::side_by_side::side_by_side;
use anyhow::{Context, Result};
use eval::{DEFAULT_MAX_DIFF, Trajectory, read_trajectory};
use geometry::Sim3;
use loopbox_tests::similar_places::Kind;
use loopbox_tests::{Encoding, Recording};
use map::load_map;
use measuring::views::{View, metres_per_unit, views};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Frames of a recording.
const FRAMES: usize = 72;
/// Frames a second.
const RATE: f64 = 15.0;

/// The map of one way past a place.
pub struct PlaceMap {
    /// Number of the place.
    pub place: u64,
    /// Number of the way past it.
    pub pass: u64,
    /// The map.
    pub file: PathBuf,
    /// What its keyframes see, metres.
    pub views: Vec<View>,
    /// Metres per unit.
    metres: f64,
    trajectory: Trajectory,
    truth: Trajectory,
}

/// A kind's name in files and tables.
pub fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Houses => "houses",
        Kind::Pavement => "pavement",
        Kind::Corridor => "corridor",
        Kind::CarPark => "car-park",
    }
}

/// Maps of ways past places, those that are there already not made again. Left out are recordings that gave no map.
///
/// # Errors
/// When files cannot be written or read.
pub fn make(
    kind: Kind,
    seed: u64,
    wanted: &[(u64, u64)],
    program: &Program,
    folder: &Path,
) -> Result<Vec<PlaceMap>> {
    let made = side_by_side(wanted, |&(place, pass)| {
        let home = folder.join(format!("{}-{place:02}-{pass}", name(kind)));
        make_one(kind, seed, (place, pass), program, &home)
    })?;
    Ok(made.into_iter().flatten().collect())
}

/// One map; nothing where the recording gives none.
fn make_one(
    kind: Kind,
    seed: u64,
    (place, pass): (u64, u64),
    program: &Program,
    home: &Path,
) -> Result<Option<PlaceMap>> {
    let file = home.join("map.mcap");
    let truth = home.with_extension("truth.txt");
    if !truth.is_file() {
        let recording = home.with_extension("recording");
        let travelled = kind.path(seed, place, pass, FRAMES);
        let rendered = Recording::render(&kind.place(seed, place), Recording::SMALL_CAMERA, &travelled, RATE);
        let written = rendered.write(&recording, Encoding::Jpeg);
        written.with_context(|| format!("{}: cannot be written", recording.display()))?;
        let mut command = Command::new(&program.loopbox);
        command.arg("run").arg(&recording).arg("--out").arg(home).arg("--quiet");
        // A recording that gives no map is one pair less.
        let _ = crate::measure::finish(&mut command);
        let context = || format!("{}: cannot be kept", truth.display());
        std::fs::rename(recording.join("groundtruth.txt"), &truth).with_context(context)?;
        std::fs::remove_dir_all(&recording).with_context(context)?;
    }
    if !file.is_file() {
        return Ok(None);
    }
    let map = load_map(&file)?.map;
    let truth = read_trajectory(&truth)?;
    let Ok(metres) = metres_per_unit(&map, &truth) else { return Ok(None) };
    let trajectory = read_trajectory(&home.join("trajectory.txt"))?;
    let views = views(&map, &truth, metres);
    Ok(Some(PlaceMap { place, pass, file, views, metres, trajectory, truth }))
}

impl PlaceMap {
    /// Its side of a merge that moves its world by a similarity, met at a time, seconds.
    pub fn side(&self, common_from_world: &Sim3, time: f64) -> Option<Side> {
        let own = Sim3::from(self.trajectory.pose_at(time, DEFAULT_MAX_DIFF)?.rigid());
        Some(Side {
            common_from_camera: (*common_from_world * own).rigid(),
            world_from_camera: self.truth.pose_at(time, DEFAULT_MAX_DIFF)?.rigid(),
            growth: common_from_world.scale,
            metres: self.metres,
        })
    }

    /// Median depth of what the keyframe of a time sees, metres.
    pub fn depth(&self, time: f64) -> Option<f64> {
        let at = |view: &&View| (view.timestamp - time).abs() <= DEFAULT_MAX_DIFF;
        self.views.iter().find(at).map(|view| view.depth)
    }
}
