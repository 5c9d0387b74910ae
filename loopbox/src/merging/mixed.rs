//! Maps in which robots with both sensors tied cameras to LiDARs before ([`super::rig`]), merged with others: LiDARs meet LiDARs,
//! cameras meet cameras, and the ties take the one kind along with the other.
//!
//! Every agent's own map is compared with those of its kind. What is accepted goes into one graph of merges with the ties that the
//! maps brought, in which keyframes of LiDARs stay in metres.

mod report;

use super::options::{MergeWatcher, refuse_one};
use super::output::write_maps;
use super::{Input, MergingParams, Names, keep_from, merge};
use crate::lidar::merging as lidar;
use crate::open::open_map;
use crate::results::{Owner, Results};
use anyhow::{Context, Result, anyhow};
use geometry::Sim3;
use map::{AgentId, Map, SensorKind};
use merge::common_map::{Address, CommonMap, Fused, Link};
use merge::estimate::Estimate;
use nalgebra::{SMatrix, SVector};
use place_recog::Vocabulary;
use serde::Serialize;
use sources::Stop;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const NUMBERS: &str = "merge.json";
const REPORT: &str = "report.html";
/// What a merge of LiDARs says of the scale, a share of it. Both are in metres, and the joint graph moves them in six degrees of
/// freedom, so that nothing depends on it.
const SCALE_DEVIATION: f64 = 1e-3;

/// What came of a merge of maps with both kinds of sensors.
pub struct MixedMerged {
    /// The common maps, that of the first agent first.
    pub fused: Vec<Fused>,
    /// The numbers, as in `merge.json`.
    pub record: MixedRecord,
    /// What else there is to know, for people.
    pub warnings: Vec<String>,
}

/// The numbers of such a merge: what `merge.json` holds.
#[derive(Clone, Debug, Serialize)]
pub struct MixedRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The commit that it was built from, where it is known.
    pub commit: Option<&'static str>,
    /// The maps given, by their paths.
    pub inputs: Vec<String>,
    /// Every agent of them.
    pub agents: Vec<MixedAgent>,
    /// Every two agents of one kind.
    #[serde(rename = "encounters")]
    pub pair_results: Vec<MixedPairResult>,
    /// Names of the agents that hang together.
    pub groups: Vec<Vec<String>>,
    /// Merges that the common map took back, and why.
    pub taken_back: Vec<String>,
    /// The parameters of the cameras' part.
    pub params: MergingParams,
    /// The files of results, by names relative to their folder.
    pub files: Vec<String>,
}

/// An agent of the maps given.
#[derive(Clone, Debug, Serialize)]
pub struct MixedAgent {
    /// What it is called.
    pub name: String,
    /// What it sees with.
    pub sensor: SensorKind,
    /// Its keyframes.
    pub keyframes: usize,
}

/// What came of two agents.
#[derive(Clone, Debug, Serialize)]
pub struct MixedPairResult {
    /// Their names.
    pub agents: [String; 2],
    /// What both see with.
    pub sensor: SensorKind,
    /// `accepted`, `undecided` or `refused`.
    pub decision: &'static str,
    /// The line that decided, or the evidence in a few words.
    pub reason: String,
}

impl MixedMerged {
    /// Whether any two agents met that were not in one map before. Only then results were written.
    pub fn any_joined(&self) -> bool {
        !self.record.files.is_empty()
    }

    /// What was decided of every two agents of one kind, for people.
    pub fn verdict(&self) -> String {
        self.record.pair_results.iter().fold(String::new(), |mut text, line| {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{}: {}: {}", line.agents.join(" + "), line.decision, line.reason);
            text
        })
    }
}

/// How maps of cameras and LiDARs are to be merged.
#[derive(Clone, Debug)]
pub struct MixedOptions {
    /// Folder for the results; made if it is not there.
    pub out: PathBuf,
    /// Replace results of a run in that folder.
    pub force: bool,
    /// How LiDARs' maps are brought together.
    pub lidars: lidar::LidarMergeParams,
    /// All parameters of cameras' merges; its `fusion` is that of the common map of both. Nothing is optimised jointly.
    pub cameras: MergingParams,
}

/// Merges the maps at `paths`, of which at least one has agents of both kinds, and writes the common map: maps, clouds and
/// trajectories as of any merge, `report.html` and `merge.json`. Where no two agents met, nothing is written.
///
/// # Errors
/// When a map cannot be read, the common map cannot be made, results cannot be written, or `stop` was wished.
pub fn merge_mixed(
    paths: &[PathBuf],
    options: &MixedOptions,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<MixedMerged> {
    refuse_one(paths)?;
    keep_from(&options.out, paths)?;
    let mut output = Results::create(&options.out, &Owner::Merge, options.force)?;
    let mut stage = |text: &str| {
        watcher.stage(text);
        if stop.requested() { Err(anyhow!("interrupted: nothing was written")) } else { Ok(()) }
    };
    stage("reading the maps")?;
    let (mut maps, mut warnings) = (Vec::new(), Vec::new());
    for path in paths {
        let opened = open_map(path)?;
        warnings.extend(opened.warnings);
        maps.push(opened.map);
    }
    // The common world is that of the first: metres, where one knows them.
    maps.sort_by_key(|map| !map.is_metric());
    let (mut common, _) =
        CommonMap::from_maps(&maps.iter().collect::<Vec<_>>()).context("the maps cannot be merged")?;
    let names = Names::new(&common);
    let before = common.merged();
    let (scanned, mut pair_results) = meetings_of_lidars(&common, &names, &options.lidars, &mut stage)?;
    let (seen, of_cameras) =
        meetings_of_cameras(&common, &names, &options.cameras, &mut stage, &mut warnings)?;
    pair_results.extend(of_cameras);
    scanned.into_iter().chain(seen).for_each(|link| _ = common.link(link));
    stage("making the common map")?;
    let (fused, taken_back) =
        common.fuse_consistently(&options.cameras.fusion).context("the common map cannot be made")?;
    let name = |agent: AgentId| names.of(agent).to_owned();
    let mut record = MixedRecord {
        version: env!("CARGO_PKG_VERSION"),
        commit: crate::program::commit(),
        inputs: paths.iter().map(|path| path.display().to_string()).collect(),
        agents: common.agents().iter().filter_map(|(id, own)| agent(name(*id), own)).collect(),
        pair_results,
        groups: fused.iter().map(|fused| fused.agents.iter().map(|agent| name(*agent)).collect()).collect(),
        taken_back: taken_back
            .iter()
            .map(|taken| format!("{} + {}: {}", name(taken.agents.0), name(taken.agents.1), taken.why))
            .collect(),
        params: MergingParams { joint: false, ..options.cameras.clone() },
        files: Vec::new(),
    };
    if common.merged().difference(&before).next().is_some() {
        stage("writing the results")?;
        write(&mut output, &fused, &names, &mut record)?;
        stage("putting the results in place")?;
        output.commit()?;
    }
    Ok(MixedMerged { fused, record, warnings })
}

fn agent(name: String, own: &Map) -> Option<MixedAgent> {
    Some(MixedAgent { name, sensor: own.sensor()?, keyframes: own.keyframes.len() })
}

/// The own maps of the agents of a kind.
fn of_kind(common: &CommonMap, kind: SensorKind) -> impl Iterator<Item = (AgentId, &Map)> {
    common.agents().iter().filter(move |(_, own)| own.sensor() == Some(kind)).map(|(id, own)| (*id, own))
}

/// What LiDARs make of each other.
fn meetings_of_lidars(
    common: &CommonMap,
    names: &Names,
    params: &lidar::LidarMergeParams,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<(Vec<Link>, Vec<MixedPairResult>)> {
    let (mut agents, mut inputs) = (Vec::new(), Vec::new());
    for (id, own) in of_kind(common, SensorKind::Lidar) {
        agents.push(id);
        inputs.push(lidar::Input::of(PathBuf::from(names.of(id)), own.clone())?);
    }
    if inputs.len() < 2 {
        return Ok(Default::default());
    }
    let merging = lidar::merge(&inputs, params, stage)?;
    let link = |pair: &lidar::Pair| {
        let map_link = lidar::map_link(&inputs, pair)?;
        let address = |input: usize, keyframe| Address { agent: agents[input], keyframe };
        let (metres, radians) = map_link.deviation;
        let [t, r, s] = [metres, radians, SCALE_DEVIATION].map(|deviation| deviation.powi(-2));
        let information = SMatrix::from_diagonal(&SVector::<f64, 7>::from([t, t, t, r, r, r, s]));
        let a_from_b = Sim3::from(map_link.from_from_to);
        let (from, to) = (address(pair.a, map_link.from), address(pair.b, map_link.to));
        Some(Link { from, to, from_from_to: Estimate { a_from_b, information } })
    };
    let links = merging.pairs.iter().filter(|pair| pair.is_kept()).filter_map(link).collect();
    let pair_result = |pair: &lidar::Pair| MixedPairResult {
        agents: [pair.a, pair.b].map(|input| names.of(agents[input]).to_owned()),
        sensor: SensorKind::Lidar,
        decision: lidar::decision(pair),
        reason: pair.reason(),
    };
    Ok((links, merging.pairs.iter().map(pair_result).collect()))
}

/// What cameras make of each other.
fn meetings_of_cameras(
    common: &CommonMap,
    names: &Names,
    params: &MergingParams,
    stage: &mut dyn FnMut(&str) -> Result<()>,
    warnings: &mut Vec<String>,
) -> Result<(Vec<Link>, Vec<MixedPairResult>)> {
    if of_kind(common, SensorKind::Camera).count() < 2 {
        return Ok(Default::default());
    }
    let vocabulary = Vocabulary::shipped();
    let (mut agents, mut inputs) = (Vec::new(), Vec::new());
    for (id, own) in of_kind(common, SensorKind::Camera) {
        match Input::of(own.clone(), Path::new(names.of(id)), &vocabulary) {
            Ok(input) => {
                agents.push(id);
                inputs.push(input);
            }
            Err(refused) => warnings.push(format!("{:#}", refused.why)),
        }
    }
    let merging = merge(&inputs, &vocabulary, params, stage)?;
    // There every input is one agent, whose keyframes are called as they are here.
    let owners: Vec<Option<AgentId>> = merging.addresses.iter().map(|of| of.agents().next()).collect();
    let here = |address: Address| {
        let input = owners.iter().position(|owner| *owner == Some(address.agent))?;
        Some(Address { agent: agents[input], ..address })
    };
    let links = merging.common.links().iter();
    let links = links.filter_map(|link| Some(Link { from: here(link.from)?, to: here(link.to)?, ..*link }));
    let pair_result = |met: &super::PairResult| MixedPairResult {
        agents: met.as_given().map(|input| names.of(agents[input]).to_owned()),
        sensor: SensorKind::Camera,
        decision: met.verdict(),
        reason: met.refusal().unwrap_or_else(|| {
            format!("{} closures join them", met.joined.as_ref().map_or(0, |joined| joined.edges.len()))
        }),
    };
    Ok((links.collect(), merging.pair_results.iter().map(pair_result).collect()))
}

fn write(output: &mut Results, fused: &[Fused], names: &Names, record: &mut MixedRecord) -> Result<()> {
    let provenance = [
        ("program".to_owned(), concat!("loopbox ", env!("CARGO_PKG_VERSION")).to_owned()),
        ("maps".to_owned(), record.inputs.join("\n")),
    ];
    write_maps(output, fused, names, &provenance)?;
    let page = output.file(REPORT)?;
    let path = output.file(NUMBERS)?;
    record.files = output.names();
    if let Some(first) = fused.first() {
        report::write(&page, &first.map, record)?;
    }
    let text = serde_json::to_vec_pretty(record).context("the numbers cannot be written as JSON")?;
    fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))
}
