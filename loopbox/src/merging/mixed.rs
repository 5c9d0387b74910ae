//! Maps in which robots with both sensors tied cameras to LiDARs before ([`super::rig`]), merged with others: LiDARs meet LiDARs,
//! cameras meet cameras, and the ties take the one kind along with the other.
//!
//! Every agent's own map is compared with those of its kind. What is accepted goes into one graph of merges with the ties that the
//! maps brought, in which keyframes of LiDARs stay in metres.

mod report;

use super::options::MergeWatcher;
use super::verdicts::CameraVerdicts;
use super::{Input, KnownBefore, Manifest, MergingParams, Names, merge_knowing};
use crate::common_map::groups::write_maps;
use crate::common_map::manifest::{Given, ManifestMap, arrangements, begin, go_on};
use crate::common_map::names::name_of;
use crate::describing::described::describe;
use crate::lidar::merging as lidar;
use crate::lidar::merging::verdicts::LidarVerdicts;
use crate::open::open_map;
use crate::results::Results;
use crate::results::digest::agent_digests;
use crate::verdicts::{MapDigest, Verdicts};
use anyhow::{Context, Result};
use geometry::Sim3;
use map::{AgentId, Map, SensorKind};
use merge::common_map::{Address, Addresses, CommonMap, Fused, Link, TakenBack};
use merge::estimate::Estimate;
use nalgebra::{SMatrix, SVector};
use place_recog::Vocabulary;
use serde::Serialize;
use sources::Stop;
use std::collections::BTreeMap;
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
    any_joined: bool,
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
        self.any_joined
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
    /// Where verdicts on pairs are taken from and kept: a folder, which is made if it is not there, or the URI of a bucket. Where none is
    /// named, that of a manifest among the maps, else the folder `verdicts` in `out`.
    pub verdicts: Option<PathBuf>,
    /// Maps of manifests among the given that are left out, by their names.
    pub without: Vec<String>,
    /// Whether maps, clouds, trajectories and the report are written besides the manifest.
    pub map: bool,
}

/// Merges the maps at `paths`, of which at least one has agents of both kinds, and writes the common map: maps, clouds and
/// trajectories as of any merge, `manifest.json`, `report.html` and `merge.json`. A manifest stands for all of its maps, and verdicts that
/// are kept are not found again. Where no two agents met, verdicts alone are written.
///
/// # Errors
/// When a map cannot be read, the common map cannot be made, results cannot be written, or `stop` was wished.
pub fn merge_mixed(
    paths: &[PathBuf],
    options: &MixedOptions,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<MixedMerged> {
    let MixedOptions { out, cameras, map, .. } = options;
    let (given, mut output) = begin(paths, &options.without, (out, options.force))?;
    let mut stage = |text: &str| {
        watcher.stage(text);
        go_on(stop)
    };
    stage("reading the maps")?;
    let mut warnings = Vec::new();
    let (lines, maps) = read(&given, &mut warnings)?;
    let (mut common, addresses) =
        CommonMap::from_maps(&maps.iter().collect::<Vec<_>>()).context("the maps cannot be merged")?;
    let names = Names::new(&common);
    let before = common.merged();
    let (place, verdicts) = given.verdicts(options.verdicts.as_deref(), out)?;
    let digests = digests(&lines, &addresses);
    let agents = Agents { common: &common, names: &names, digests, verdicts };
    let (scanned, mut pair_results) = agents.meetings_of_lidars(&options.lidars, &mut stage)?;
    let (seen, of_cameras) = agents.meetings_of_cameras(cameras, &mut stage, &mut warnings)?;
    pair_results.extend(of_cameras);
    scanned.into_iter().chain(seen).for_each(|link| _ = common.link(link));
    stage("making the common map")?;
    let (fused, taken_back) =
        common.fuse_consistently(&cameras.fusion).context("the common map cannot be made")?;
    let mut record = MixedRecord {
        inputs: lines.iter().map(|line| line.path.display().to_string()).collect(),
        pair_results,
        params: MergingParams { joint: false, ..cameras.clone() },
        ..record(&common, &names, &fused, &taken_back)
    };
    let any_joined = common.merged().difference(&before).next().is_some();
    if any_joined {
        stage("writing the results")?;
        let provenance = provenance(&record);
        let groups = arrangements(&fused, &addresses, &provenance);
        Manifest::new(lines, &place, groups, out).write(&mut output)?;
        if *map {
            write_maps(&mut output, &fused, &names, &provenance)?;
            write(&mut output, &fused, &mut record)?;
        }
        stage("putting the results in place")?;
        output.commit()?;
    }
    Ok(MixedMerged { fused, record, warnings, any_joined })
}

/// Reads the maps with their lines in a manifest, those in metres first: the common world is that of the first. They keep features and words,
/// as common maps of cameras do.
fn read(given: &Given, warnings: &mut Vec<String>) -> Result<(Vec<ManifestMap>, Vec<Map>)> {
    let vocabulary = Vocabulary::shipped();
    let mut read = Vec::new();
    for (path, sha256) in given.maps.iter().zip(given.digests(&given.maps)?) {
        let mut opened = open_map(path)?;
        describe(&mut opened.map, &vocabulary, None);
        warnings.extend(opened.warnings);
        let line = ManifestMap { name: name_of(&opened.map), path: path.clone(), sha256 };
        read.push((line, opened.map));
    }
    read.sort_by_key(|(_, map)| !map.is_metric());
    Ok(read.into_iter().unzip())
}

/// What the agents of maps are called in verdicts.
fn digests(lines: &[ManifestMap], addresses: &[Addresses]) -> BTreeMap<AgentId, MapDigest> {
    let of_map = |(map, addresses): (usize, &Addresses)| {
        addresses.agents().enumerate().map(move |(number, agent)| (agent, (map, number))).collect::<Vec<_>>()
    };
    let (agents, places): (Vec<AgentId>, Vec<(usize, usize)>) =
        addresses.iter().enumerate().flat_map(of_map).unzip();
    let files: Vec<MapDigest> = lines.iter().map(|line| line.sha256.clone()).collect();
    agents.into_iter().zip(agent_digests(&places, &files)).collect()
}

/// The numbers of a common map.
fn record(common: &CommonMap, names: &Names, fused: &[Fused], taken_back: &[TakenBack]) -> MixedRecord {
    let name = |agent: &AgentId| names.of(*agent).to_owned();
    let agent = |(id, own): (&AgentId, &Map)| {
        Some(MixedAgent { name: name(id), sensor: own.sensor()?, keyframes: own.keyframes.len() })
    };
    let taken_back = taken_back
        .iter()
        .map(|TakenBack { agents: (a, b), why }| format!("{} + {}: {why}", name(a), name(b)));
    MixedRecord {
        version: env!("CARGO_PKG_VERSION"),
        commit: crate::program::commit(),
        inputs: Vec::new(),
        agents: common.agents().iter().filter_map(agent).collect(),
        pair_results: Vec::new(),
        groups: fused.iter().map(|fused| fused.agents.iter().map(name).collect()).collect(),
        taken_back: taken_back.collect(),
        params: MergingParams::default(),
        files: Vec::new(),
    }
}

/// How the maps of several agents came to be.
fn provenance(record: &MixedRecord) -> [(String, String); 2] {
    let program = concat!("loopbox ", env!("CARGO_PKG_VERSION")).to_owned();
    [("program".to_owned(), program), ("maps".to_owned(), record.inputs.join("\n"))]
}

/// The agents of all maps, before they meet.
struct Agents<'a> {
    common: &'a CommonMap,
    names: &'a Names,
    /// What each is called in verdicts.
    digests: BTreeMap<AgentId, MapDigest>,
    /// Where these are kept.
    verdicts: Verdicts,
}

impl<'a> Agents<'a> {
    /// The own maps of the agents of a kind.
    fn of_kind(&self, kind: SensorKind) -> impl Iterator<Item = (AgentId, &'a Map)> {
        let agents = self.common.agents().iter().map(|(id, own)| (*id, own));
        agents.filter(move |(_, own)| own.sensor() == Some(kind))
    }

    /// What some of them are called in verdicts.
    fn digests(&self, agents: &[AgentId]) -> Vec<MapDigest> {
        agents.iter().filter_map(|agent| self.digests.get(agent).cloned()).collect()
    }

    /// What LiDARs make of each other.
    fn meetings_of_lidars(
        &self,
        params: &lidar::LidarMergeParams,
        stage: &mut dyn FnMut(&str) -> Result<()>,
    ) -> Result<(Vec<Link>, Vec<MixedPairResult>)> {
        let names = self.names;
        let (mut agents, mut inputs) = (Vec::new(), Vec::new());
        for (id, own) in self.of_kind(SensorKind::Lidar) {
            agents.push(id);
            inputs.push(lidar::Input::of(PathBuf::from(names.of(id)), own.clone())?);
        }
        if inputs.len() < 2 {
            return Ok(Default::default());
        }
        let verdicts = LidarVerdicts::among(self.verdicts.clone(), self.digests(&agents), params);
        let merging = lidar::merge_knowing(&inputs, params, (&[], Some(&verdicts)), stage)?;
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
        &self,
        params: &MergingParams,
        stage: &mut dyn FnMut(&str) -> Result<()>,
        warnings: &mut Vec<String>,
    ) -> Result<(Vec<Link>, Vec<MixedPairResult>)> {
        let names = self.names;
        if self.of_kind(SensorKind::Camera).count() < 2 {
            return Ok(Default::default());
        }
        let vocabulary = Vocabulary::shipped();
        let (mut agents, mut inputs) = (Vec::new(), Vec::new());
        for (id, own) in self.of_kind(SensorKind::Camera) {
            match Input::of(own.clone(), Path::new(names.of(id)), &vocabulary) {
                Ok(input) => {
                    agents.push(id);
                    inputs.push(input);
                }
                Err(refused) => warnings.push(format!("{:#}", refused.why)),
            }
        }
        let verdicts = CameraVerdicts::among(self.verdicts.clone(), self.digests(&agents), params);
        let known = KnownBefore { verdicts: Some(&verdicts), ..KnownBefore::default() };
        let merging = merge_knowing(&inputs, &vocabulary, params, known, stage)?;
        // There every input is one agent, whose keyframes are called as they are here.
        let owners: Vec<Option<AgentId>> = merging.addresses.iter().map(|of| of.agents().next()).collect();
        let here = |address: Address| {
            let input = owners.iter().position(|owner| *owner == Some(address.agent))?;
            Some(Address { agent: agents[input], ..address })
        };
        let links = merging.common.links().iter();
        let links =
            links.filter_map(|link| Some(Link { from: here(link.from)?, to: here(link.to)?, ..*link }));
        let pair_result = |met: &super::PairResult| MixedPairResult {
            agents: met.as_given().map(|input| names.of(agents[input]).to_owned()),
            sensor: SensorKind::Camera,
            decision: met.verdict(),
            reason: met.refusal().unwrap_or_else(|| {
                format!("{} closures join them", met.joined.as_ref().map_or(0, |joined| joined.edges.len()))
            }),
        };
        Ok((links.collect(), merging.pair_results.iter().map(|met| pair_result(&met)).collect()))
    }
}

fn write(output: &mut Results, fused: &[Fused], record: &mut MixedRecord) -> Result<()> {
    let page = output.file(REPORT)?;
    let path = output.file(NUMBERS)?;
    record.files = output.names();
    if let Some(first) = fused.first() {
        report::write(&page, &first.map, record)?;
    }
    let text = serde_json::to_vec_pretty(record).context("the numbers cannot be written as JSON")?;
    fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))
}
