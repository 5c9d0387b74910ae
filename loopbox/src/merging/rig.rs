//! The maps of a camera and of a LiDAR that were on one robot, in one map: neither sees what the other does, but both went
//! the same way.
//!
//! Keyframes of the camera are tied to those of the LiDAR by the poses of the one sensor on the other
//! ([`tie`]), and go into the graph of merges as closures do. The LiDAR's keyframes are in metres and stay so; the
//! camera's get place and unit by the ties, wherever its scale went meanwhile.

mod report;

use super::options::MergeWatcher;
use super::{Names, keep_from};
use crate::common_map::groups::write_maps;
use crate::open::open_map;
use crate::placing::rig::{Tied, tie};
use crate::results::{Owner, Results};
use anyhow::{Context, Result, anyhow, bail, ensure};
use geometry::{Se3, Sim3};
use map::{Keyframe, KeyframeId, Map, SensorKind};
use merge::common_map::{Address, Addresses, CommonMap, Fused, FusionParams, Link};
use merge::estimate::Estimate;
use nalgebra::{SMatrix, SVector};
use serde::Serialize;
use sources::Stop;
use std::fs;
use std::path::{Path, PathBuf};

/// Keyframes that are tied at the most, spread over the way: what is between them follows.
const TIES: usize = 64;
/// What a tie errs by, metres, radians and share of the scale: as LiDAR merges, and an extrinsic that was measured by hand.
const DEVIATION: [f64; 3] = [0.02, 0.005, 0.02];
const NUMBERS: &str = "merge.json";
const REPORT: &str = "report.html";

/// What came of a rig's maps.
pub struct RigMerged {
    /// The common map.
    pub fused: Fused,
    /// The numbers, as in `merge.json`.
    pub record: RigRecord,
    /// What else there is to know, for people.
    pub warnings: Vec<String>,
}

/// The numbers of a rig's merge: what `merge.json` holds.
#[derive(Clone, Debug, Serialize)]
pub struct RigRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The commit that it was built from, where it is known.
    pub commit: Option<&'static str>,
    /// The maps given.
    pub inputs: Vec<RigInput>,
    /// Where the camera is on the LiDAR as given, `tx ty tz qx qy qz qw`, metres.
    pub lidar_from_camera: [f64; 7],
    /// Images that were taken while the LiDAR has poses.
    pub images: usize,
    /// How far the camera is from the middle of its way, root mean square, metres.
    pub reach_m: f64,
    /// Between the camera's ways by both maps, median, metres: its drift is in it.
    pub distance_m: f64,
    /// Between its directions by both maps, median, degrees.
    pub angle_deg: f64,
    /// Metres in a unit of the camera's map, over the whole way.
    pub metres_per_unit: f64,
    /// How wrong that may be, a share of it.
    pub scale_doubt: f64,
    /// Keyframes that were tied.
    pub ties: usize,
    /// Of them, those that do not agree with the others.
    pub suppressed: usize,
    /// The files of results, by names relative to their folder.
    pub files: Vec<String>,
}

/// A map of a rig.
#[derive(Clone, Debug, Serialize)]
pub struct RigInput {
    /// Its path as given.
    pub path: String,
    /// What its agent is called.
    pub name: String,
    /// What it sees with.
    pub sensor: SensorKind,
    /// Its keyframes.
    pub keyframes: usize,
}

/// Brings the maps of a camera and of a LiDAR on one robot together, in whichever order they are at `paths`, and writes the
/// common map into the folder `out`: `map.mcap`, `cloud.ply`, a trajectory for each, `report.html` and `merge.json`.
/// `lidar_from_camera` is as in [`tie`].
///
/// # Errors
/// When a map cannot be read, they are not of such two agents, their motion does not tell metres, or results cannot be
/// written. Then nothing is written.
pub fn merge_rig(
    paths: &[PathBuf],
    lidar_from_camera: &Se3,
    (out, force): (&Path, bool),
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<RigMerged> {
    let [first, second] = paths else {
        bail!(
            "an extrinsic is of two maps, a camera's and that of the LiDAR beside it, and these are {}",
            paths.len()
        );
    };
    keep_from(out, paths)?;
    let mut output = Results::create(out, &Owner::Merge, force)?;
    let go_on = || if stop.requested() { Err(anyhow!("interrupted: nothing was written")) } else { Ok(()) };
    watcher.stage("reading both maps");
    let (first, second) = (open_map(first)?, open_map(second)?);
    let warnings = first.warnings.into_iter().chain(second.warnings).collect();
    let mut given: Vec<(&PathBuf, Map)> = paths.iter().zip([first.map, second.map]).collect();
    // The world is the LiDAR's, which is in metres.
    given.sort_by_key(|(_, map)| map.sensor() != Some(SensorKind::Lidar));
    let [(_, lidar), (_, camera)] = &given[..] else { bail!("there are two maps") };
    let tied = tie(camera, lidar, lidar_from_camera)?;
    go_on()?;
    watcher.stage("making the common map");
    let (mut common, addresses) =
        CommonMap::from_maps(&[lidar, camera]).context("the maps cannot be merged")?;
    let links = ties(&tied, camera, lidar, &addresses);
    ensure!(
        links.len() >= 2,
        "{} keyframes of the camera were taken while the LiDAR has poses: too few",
        links.len()
    );
    let ties = links.len();
    links.into_iter().for_each(|link| _ = common.link(link));
    let (fused, taken_back) =
        common.fuse_consistently(&FusionParams::default()).context("the common map cannot be made")?;
    let mut fused = fused.into_iter();
    let (Some(fused), None) = (fused.next(), fused.next()) else {
        let why = taken_back.first().map_or("they hang together by nothing", |taken| &*taken.why);
        bail!("camera and LiDAR do not stay together along their way: {why}");
    };
    go_on()?;
    watcher.stage("writing the results");
    let names = Names::new(&common);
    let mut record = record(&given, &tied, ties, fused.suppressed.len(), lidar_from_camera);
    let provenance = provenance(paths, &record);
    write_maps(&mut output, std::slice::from_ref(&fused), &names, &provenance)?;
    let page = output.file(REPORT)?;
    let path = output.file(NUMBERS)?;
    record.files = output.names();
    report::write(&page, &fused.map, &tied, &record)?;
    let text = serde_json::to_vec_pretty(&record).context("the numbers cannot be written as JSON")?;
    fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
    go_on()?;
    output.commit()?;
    Ok(RigMerged { fused, record, warnings })
}

/// What the common map says of how it was made.
fn provenance(paths: &[PathBuf], record: &RigRecord) -> [(String, String); 3] {
    let maps: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    [
        ("program".to_owned(), concat!("loopbox ", env!("CARGO_PKG_VERSION")).to_owned()),
        ("maps".to_owned(), maps.join("\n")),
        ("lidar_from_camera".to_owned(), record.lidar_from_camera.map(|number| number.to_string()).join(" ")),
    ]
}

/// The keyframes of the camera tied to those of the LiDAR, each to the one that is nearest in time.
fn ties(tied: &Tied, camera: &Map, lidar: &Map, addresses: &[Addresses]) -> Vec<Link> {
    let there = |keyframe: &&Keyframe| tied.lidar_world_from_camera(keyframe.timestamp).is_some();
    let keyframes: Vec<&Keyframe> = camera.keyframes.values().filter(there).collect();
    let step = keyframes.len().div_ceil(TIES).max(1);
    let link = |keyframe: &&Keyframe| {
        let away = |other: &&Keyframe| (other.timestamp - keyframe.timestamp).abs();
        let nearest = lidar.keyframes.values().min_by(|a, b| away(a).total_cmp(&away(b)))?;
        let lidar_world_from_camera = tied.lidar_world_from_camera(keyframe.timestamp)?;
        let metres = tied.lidar_world_from_camera_world.scale * keyframe.world_from_keyframe.scale;
        let camera = Sim3 { scale: metres, ..lidar_world_from_camera.into() };
        let a_from_b = nearest.world_from_keyframe.inverse() * camera;
        let [t, r, s] = DEVIATION.map(|deviation| deviation.powi(-2));
        let information = SMatrix::from_diagonal(&SVector::<f64, 7>::from([t, t, t, r, r, r, s]));
        let address = |map: usize, (agent, id): (map::AgentId, KeyframeId)| -> Option<Address> {
            addresses.get(map)?.of(agent, id)
        };
        let (from, to) =
            (address(0, (nearest.agent, nearest.id))?, address(1, (keyframe.agent, keyframe.id))?);
        Some(Link { from, to, from_from_to: Estimate { a_from_b, information } })
    };
    keyframes.iter().step_by(step).filter_map(link).collect()
}

fn record(
    given: &[(&PathBuf, Map)],
    tied: &Tied,
    ties: usize,
    suppressed: usize,
    lidar_from_camera: &Se3,
) -> RigRecord {
    let input = |(path, map): &(&PathBuf, Map)| {
        let info = map.agents.values().next()?;
        let (path, name) = (path.display().to_string(), info.name.clone());
        Some(RigInput { path, name, sensor: info.sensor.kind(), keyframes: map.keyframes.len() })
    };
    RigRecord {
        version: env!("CARGO_PKG_VERSION"),
        commit: crate::program::commit(),
        inputs: given.iter().filter_map(input).collect(),
        lidar_from_camera: lidar_from_camera.to_tum(),
        images: tied.alignment.pairs,
        reach_m: tied.alignment.reach,
        distance_m: tied.alignment.distance,
        angle_deg: tied.alignment.angle.to_degrees(),
        metres_per_unit: tied.lidar_world_from_camera_world.scale,
        scale_doubt: tied.alignment.scale_doubt(),
        ties,
        suppressed,
        files: Vec::new(),
    }
}
