//! From recordings and maps in files to folders of results.

use super::merging::{
    Files, Input, LidarMergeParams, LidarMergeRecord, LidarMerging, confirmed_pairs, merge_knowing, summary,
};
use super::notifying::Notifier;
use super::poses::GivenPoses;
use super::record::LidarRecord;
use super::report;
use super::run::{Event, LidarRun, RunOptions, run};
use crate::common_map::groups::{GroupMap, write_groups};
use crate::common_map::manifest::{Manifest, begin, go_on};
use crate::common_map::names::Names;
use crate::lidar::merging::verdicts::LidarVerdicts;
use crate::listeners::Listeners;
use crate::open::{open_map, recording_name};
use crate::results::digest::agent_digests;
use crate::results::file_names::numbered;
use crate::results::{Owner, Results};
use anyhow::{Context, Result, bail};
use map::{AgentId, AgentInfo, CloudSelection, DEFAULT_MAX_RELATIVE_VARIANCE, Map, MapWriter, Sensor};
use scans::ScanSource;
use slam_lidar::mapping::MappingParams;
use sources::Stop;
use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

const MAP: &str = "map.mcap";
const TRAJECTORY: &str = "trajectory.txt";
const CLOUD: &str = "cloud.ply";
const REPORT: &str = "report.html";
const RUN: &str = "run.json";
const MERGE: &str = "merge.json";

/// A run as a user asks for it.
pub struct LidarOptions {
    /// Folder for the results; made if it is not there.
    pub out: PathBuf,
    /// What people are to call the agent; `None` for the recording's name.
    pub name: Option<String>,
    /// Whether results of something else there are replaced.
    pub force: bool,
    /// How the map is made.
    pub params: MappingParams,
    /// Poses to build it on, with the name of their file.
    pub poses: Option<(PathBuf, GivenPoses)>,
    /// Only scans from here, seconds after the first.
    pub start: Option<f64>,
    /// Only scans up to here.
    pub end: Option<f64>,
    /// Trajectory as KITTI's rows of 3×4 numbers in place of TUM's.
    pub kitti: bool,
    /// Whence the times of points are known, for people.
    pub point_times: Option<String>,
    /// Who is told how the map grows.
    pub listeners: Listeners,
}

/// What came of a run.
pub struct Mapped {
    /// The numbers, as in `run.json`.
    pub record: LidarRecord,
    /// Why the run ended early, where it did; what there was then is written.
    pub failure: Option<String>,
}

/// Maps a recording into a folder of results: `trajectory.txt`, `map.mcap`, `cloud.ply`, `run.json` and `report.html`.
/// The map grows in the folder meanwhile, so that a run that is killed leaves it. `observe` is told of every scan.
///
/// # Errors
/// When no scan could be used or the results cannot be written; earlier results stay then.
pub fn map_recording(
    source: &mut dyn ScanSource,
    options: LidarOptions,
    stop: &Stop,
    observe: &mut dyn FnMut(Event<'_>),
) -> Result<Mapped> {
    let LidarOptions { out, name, force, params, poses, start, end, kitti, point_times, listeners } = options;
    let info = source.info().clone();
    let about = AgentInfo {
        provenance: provenance(&info, &params, poses.as_ref().map(|(path, _)| path.as_path()))?,
        ..AgentInfo::new(name.unwrap_or_else(|| recording_name(&info.path)), Sensor::Lidar)
    };
    let mut results = Results::create(&out, &Owner::Run(info.path), force)?;
    let mut notifier = Notifier::begins(listeners, &about);
    let mut live = LiveMap::default();
    let options = RunOptions { about, params, poses: poses.map(|(_, poses)| poses), start, end };
    let done = run(source, options, &mut |event| {
        observe(event);
        if let Event::Scan { row, fragment, map } = event {
            notifier.changed(map, row.closed);
            if let Err(error) = live.grow(&mut results, fragment, map, row.closed) {
                live.failure = Some(format!("{error:#}"));
            }
        }
        let ended = stop.requested() || live.failure.is_some();
        Ok(if ended { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    });
    let LiveMap { failure, fragment_files, .. } = live;
    let done = done.inspect_err(|_| results.discard_live_map());
    let record = done.and_then(|mut done| {
        done.record.point_times = point_times;
        notifier.ended(&done.maps);
        write(&mut results, done, kitti)
    });
    let files = record.as_ref().map_or(Vec::new(), |record| record.files.clone());
    let is_complete = |path: &PathBuf| files.iter().any(|name| *path == results.folder().join(name));
    for path in fragment_files.into_iter().filter(|path| !is_complete(path)) {
        // Nobody is hurt by what stays.
        let _ = fs::remove_file(&path);
        let _ = path.parent().filter(|home| *home != results.folder()).map(fs::remove_dir);
    }
    Ok(Mapped { record: record?, failure })
}

/// All poses are written anew into a live map once there is a further one for so many keyframes.
const POSED_EVERY: usize = 16;

/// The map as it grows in the folder.
#[derive(Default)]
struct LiveMap {
    fragment: usize,
    writer: Option<MapWriter>,
    keyframes: usize,
    /// Keyframes when all poses and edges were written last.
    posed: usize,
    /// The files of fragments after the first.
    fragment_files: Vec<PathBuf>,
    failure: Option<String>,
}

impl LiveMap {
    /// Writes what is new of the map of a fragment once there is a keyframe more.
    fn grow(&mut self, results: &mut Results, fragment: usize, map: &Map, closed: bool) -> Result<()> {
        if fragment != self.fragment {
            (self.fragment, self.writer, self.keyframes, self.posed) = (fragment, None, 0, 0);
        }
        if map.keyframes.len() == self.keyframes && !closed {
            return Ok(());
        }
        let Some(about) = map.agents.values().next() else { return Ok(()) };
        let writer = match &mut self.writer {
            Some(writer) => writer,
            none => {
                let path = results.live_map()?.with_file_name(numbered(MAP, fragment));
                if fragment > 0 {
                    self.fragment_files.push(path.clone());
                }
                none.insert(MapWriter::create(&path, about)?)
            }
        };
        for keyframe in map.keyframes.values().skip(self.keyframes) {
            writer.append_keyframe(keyframe)?;
        }
        self.keyframes = map.keyframes.len();
        // All poses, edges and frames each time would be a file that grows with the square of the way.
        if self.keyframes > self.posed + self.posed / POSED_EVERY {
            self.posed = self.keyframes;
            writer.append_poses(map)?;
        }
        Ok(writer.flush()?)
    }
}

/// Where a map came from.
fn provenance(
    info: &scans::ScanInfo,
    params: &MappingParams,
    poses: Option<&Path>,
) -> Result<BTreeMap<String, String>> {
    let params = serde_json::to_string(params).context("the parameters cannot be written")?;
    let mut entries = BTreeMap::from([
        ("program".to_owned(), format!("loopbox {}", env!("CARGO_PKG_VERSION"))),
        ("source".to_owned(), info.path.display().to_string()),
        ("kind".to_owned(), info.kind.clone()),
        ("parameters".to_owned(), params),
    ]);
    entries.extend(poses.map(|path| ("poses".to_owned(), path.display().to_string())));
    Ok(entries)
}

/// Writes all results of a run in the place of earlier ones.
fn write(results: &mut Results, done: LidarRun, kitti: bool) -> Result<LidarRecord> {
    let LidarRun { maps, agent, mut record } = done;
    let Some(first) = maps.first() else { bail!("there is no map") };
    for (place, map) in maps.iter().enumerate() {
        map::save_map(results.file(numbered(MAP, place))?, map)?;
        let trajectory = results.file(numbered(TRAJECTORY, place))?;
        let poses = map.trajectory();
        if kitti { map::save_kitti(trajectory, &poses)? } else { map::save_tum(trajectory, &poses)? }
    }
    map::save_ply(results.file(CLOUD)?, first, CloudSelection::of_results(DEFAULT_MAX_RELATIVE_VARIANCE))?;
    record.cost.cpu_s = view::process::cpu_seconds();
    record.cost.peak_memory_bytes = view::process::peak_memory_bytes();
    let page = results.file(REPORT)?;
    let path = results.file(RUN)?;
    record.files = results.names();
    report::of_run(&page, first, &agent, &record)?;
    write_json(&path, &record)?;
    results.commit()?;
    Ok(record)
}

fn write_json(path: &Path, record: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_vec_pretty(record).context("the numbers cannot be written as JSON")?;
    fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
}

/// How LiDAR maps are to be merged.
#[derive(Clone, Debug)]
pub struct LidarMergeOptions {
    /// Folder for the results; made if it is not there.
    pub out: PathBuf,
    /// Replace results of a run in that folder.
    pub force: bool,
    /// How pairs are judged.
    pub params: LidarMergeParams,
    /// Where verdicts on pairs are taken from and kept: a folder, which is made if it is not there, or the URI of a bucket. Where none is
    /// named, that of a manifest among the maps, else the folder `verdicts` in `out`.
    pub verdicts: Option<PathBuf>,
    /// Pairs of agents, each as `A+B`, of which a person says that both maps show one place.
    pub confirm: Vec<String>,
    /// Maps of manifests among the given that are left out, by their names.
    pub without: Vec<String>,
    /// Whether maps, clouds, trajectories and the report are written besides the manifest.
    pub map: bool,
}

impl LidarMergeOptions {
    /// The usual merge, with results in `out`.
    pub fn to(out: impl Into<PathBuf>) -> Self {
        let (params, verdicts, confirm, without) = Default::default();
        Self { out: out.into(), force: false, params, verdicts, confirm, without, map: true }
    }
}

/// What came of a merge.
pub struct LidarMerged {
    /// The maps that were merged.
    pub inputs: Vec<Input>,
    /// What came of them.
    pub merging: LidarMerging,
    /// The numbers, as in `merge.json`.
    pub record: LidarMergeRecord,
    /// What else there is to know, for people.
    pub warnings: Vec<String>,
}

impl LidarMerged {
    /// For each pair what was decided and by what evidence, for people.
    pub fn verdict(&self) -> String {
        self.merging.pairs.iter().map(|pair| summary(&self.inputs, pair)).collect()
    }
}

/// Merges the LiDAR maps at `paths`, each a `map.mcap` or the folder of a run, into a folder of results: for each group
/// of maps that hang together a map, a cloud and trajectories, with `manifest.json`, `merge.json` and `report.html`. A manifest stands for
/// all of its maps, and verdicts that are kept are not found again. Where no two of them met, verdicts alone are written.
///
/// # Errors
/// When a map cannot be read or is not a LiDAR's, results cannot be written, or `stop` was wished.
pub fn merge_maps(
    paths: &[PathBuf],
    options: &LidarMergeOptions,
    stop: &Stop,
    stage: &mut dyn FnMut(&str),
) -> Result<LidarMerged> {
    let LidarMergeOptions { out, params, map, .. } = options;
    let (given, mut results) = begin(paths, &options.without, (out, options.force))?;
    let mut step = |text: &str| {
        stage(text);
        go_on(stop)
    };
    let (inputs, warnings) = read_inputs(&given.maps, &mut step)?;
    let files = Files::of(&inputs);
    let digests = given.digests(&files.paths)?;
    let (place, kept) = given.verdicts(options.verdicts.as_deref(), out)?;
    let verdicts = LidarVerdicts::among(kept, agent_digests(&files.agents, &digests), params);
    let confirm = confirmed_pairs(&inputs, &options.confirm)?;
    let merging = merge_knowing(&inputs, params, (&confirm, Some(&verdicts)), &mut step)?;
    let mut record = LidarMergeRecord::of(&inputs, &merging);
    record.cost.cpu_s = view::process::cpu_seconds();
    record.cost.peak_memory_bytes = view::process::peak_memory_bytes();
    if merging.any_joined() {
        step("writing the results")?;
        let groups = merging.arrangements(&files, &provenance_of(&inputs));
        let manifest = Manifest::new(files.listed(&digests), &place, groups, out);
        match *map {
            true => write_merged(&mut results, &inputs, &merging, Some(&manifest), &mut record)?,
            false => manifest.write(&mut results)?,
        }
        step("putting the results in place")?;
        results.commit()?;
    }
    Ok(LidarMerged { inputs, merging, record, warnings })
}

/// How the maps of several of these inputs came to be.
fn provenance_of(inputs: &[Input]) -> [(String, String); 2] {
    let paths: Vec<String> = inputs.iter().map(|input| input.path.display().to_string()).collect();
    let program = format!("loopbox {}", env!("CARGO_PKG_VERSION"));
    [("program".to_owned(), program), ("inputs".to_owned(), paths.join("\n"))]
}

/// Reads the LiDAR maps at `paths`, of several agents each one's own, with what else there is to know, for people.
///
/// # Errors
/// When `step` fails, or a map cannot be read or is not a LiDAR's.
pub(crate) fn read_inputs(
    paths: &[PathBuf],
    step: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<(Vec<Input>, Vec<String>)> {
    let (mut given, mut warnings) = (Vec::new(), Vec::new());
    for path in paths {
        step(&format!("reading {}", path.display()))?;
        let opened = open_map(path)?;
        warnings.extend(opened.warnings);
        given.push((path.clone(), opened.map));
    }
    Ok((Input::all(given)?, warnings))
}

/// Writes what came of a merge, with the manifest that it is made of; `record` learns the files' names and is written last.
///
/// # Errors
/// Names the file that cannot be written.
pub(crate) fn write_merged(
    results: &mut Results,
    inputs: &[Input],
    merging: &LidarMerging,
    manifest: Option<&Manifest>,
    record: &mut LidarMergeRecord,
) -> Result<()> {
    manifest.map_or(Ok(()), |manifest| manifest.write(results))?;
    let names = Names::of_agents((0..).map(AgentId).zip(inputs.iter().map(|input| &input.map)));
    let name = |input: &usize| u16::try_from(*input).map_or("", |input| names.of(AgentId(input)));
    let groups = merging.groups.iter();
    let groups: Vec<GroupMap> = groups
        .map(|group| GroupMap { map: &group.map, names: group.members.iter().map(name).collect() })
        .collect();
    write_groups(results, &groups, &provenance_of(inputs))?;
    let page = results.file(REPORT)?;
    let path = results.file(MERGE)?;
    record.files = results.names();
    report::of_merge(&page, merging, record)?;
    write_json(&path, record)
}
