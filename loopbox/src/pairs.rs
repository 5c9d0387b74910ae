//! The verdict on two maps in files, and which pairs of many are worth asking.

use crate::blobs;
use crate::common_map::manifest::refuse_one;
use crate::lidar;
use crate::lidar::merging::{LidarMergeParams, verdicts::LidarVerdicts};
use crate::merging::verdicts::{CameraVerdicts, camera_key};
use crate::merging::{self, KnownBefore, MergeWatcher, MergingParams, proposed};
use crate::open::{Sensors, sensors_at};
use crate::swapping::SwapFiles;
use crate::verdicts::{MapDigest, Verdicts};
use anyhow::{Result, anyhow, bail};
use place_recog::Vocabulary;
use serde::Serialize;
use sources::Stop;
use std::fmt::Write;
use std::path::PathBuf;

/// How a verdict is found.
#[derive(Clone, Debug, Default)]
pub struct VerdictOptions {
    /// Of maps of cameras.
    pub cameras: MergingParams,
    /// Of maps of LiDARs.
    pub lidars: LidarMergeParams,
    /// Where verdicts are taken from and kept: a folder, which is made if it is not there, or the URI of a bucket.
    pub verdicts: Option<PathBuf>,
    /// Pairs of agents, each as `A+B`, of which a person says that both maps show one place.
    pub confirm: Vec<String>,
}

/// A verdict, for people and programs.
#[derive(Clone, Debug)]
pub struct VerdictReport {
    /// Whether the maps are joined.
    pub joins: bool,
    /// What was decided and by what evidence, for people.
    pub text: String,
    /// The same as JSON, as among the `encounters` of `merge.json`; of maps with several LiDARs one for each two agents.
    pub pair_results: serde_json::Value,
}

/// Finds the verdict on two maps, or takes it from where verdicts are kept, and keeps it there.
///
/// # Errors
/// When a map cannot be read, they cannot be merged (a camera's and a LiDAR's), a verdict cannot be read or kept, or `stop`
/// was wished.
pub fn find_verdict(
    maps: &[PathBuf; 2],
    options: &VerdictOptions,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<VerdictReport> {
    match sensors_at(maps) {
        Sensors::Cameras => of_cameras(maps, options, stop, watcher),
        Sensors::Lidars => of_lidars(maps, options, stop, watcher),
        Sensors::Mixed => bail!(
            "{} and {}: one holds agents of both kinds; `loopbox unmerge` gives each agent's own map",
            maps[0].display(),
            maps[1].display()
        ),
    }
}

/// Whether the verdict on two maps of cameras is kept already, for which their files are hashed and not read as maps. Of other sensors nothing is
/// said before their maps are read.
///
/// # Errors
/// When a file cannot be read, or where verdicts are kept cannot be looked at.
pub fn is_verdict_kept(maps: &[PathBuf; 2], options: &VerdictOptions) -> Result<bool> {
    let Some(place) = options.verdicts.as_deref().filter(|_| sensors_at(maps) == Sensors::Cameras) else {
        return Ok(false);
    };
    let [a, b] = [MapDigest::of(&maps[0])?, MapDigest::of(&maps[1])?];
    Verdicts::at(place)?.has(&camera_key([&a, &b], &options.cameras))
}

fn of_cameras(
    paths: &[PathBuf; 2],
    options: &VerdictOptions,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<VerdictReport> {
    let params = &options.cameras;
    let vocabulary = Vocabulary::shipped();
    let swap = SwapFiles::new(std::env::temp_dir());
    let inputs = merging::load(paths, &vocabulary, &swap, watcher, &mut |text| go_on(text, stop, watcher))?;
    let verdicts = CameraVerdicts::of(options.verdicts.as_deref(), &inputs, params)?;
    let known = KnownBefore { confirm: &options.confirm, verdicts: verdicts.as_ref(), swap: None };
    let mut stage = |text: &str| go_on(text, stop, watcher);
    let pair_results = merging::pair_results(&inputs, &vocabulary, params, known, &mut stage)?;
    let text = pair_results.iter().map(|pair_result| merging::verdict_of(&inputs, &pair_result)).collect();
    let records: Vec<_> = pair_results.iter().map(|e| merging::PairRecord::new(&e, &inputs)).collect();
    let joins = pair_results.joined().next().is_some();
    Ok(VerdictReport { joins, text, pair_results: serde_json::to_value(records)? })
}

fn of_lidars(
    paths: &[PathBuf; 2],
    options: &VerdictOptions,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<VerdictReport> {
    let (inputs, warnings) = lidar::read_inputs(paths, &mut |text| go_on(text, stop, watcher))?;
    warnings.iter().for_each(|warning| watcher.warn(warning));
    let params = &options.lidars;
    let confirm = lidar::merging::confirmed_pairs(&inputs, &options.confirm)?;
    let verdicts = LidarVerdicts::of(options.verdicts.as_deref(), &inputs, params)?;
    let known = (&*confirm, verdicts.as_ref());
    let (mut text, mut records, mut joins) = (String::new(), Vec::new(), false);
    let across = |a: usize, b: usize| inputs[a].path == paths[0] && inputs[b].path == paths[1];
    for (a, b) in (0..inputs.len()).flat_map(|a| (0..inputs.len()).map(move |b| (a, b))) {
        if across(a, b) {
            go_on(&format!("comparing {} and {}", inputs[a].name, inputs[b].name), stop, watcher)?;
            let pair = lidar::merging::pair_alone(&inputs, [a, b], params, known)?;
            joins |= pair.is_kept();
            text += &lidar::merging::summary(&inputs, &pair);
            records.push(lidar::merging::PairRecord::of(&pair, &inputs));
        }
    }
    Ok(VerdictReport { joins, text, pair_results: serde_json::to_value(records)? })
}

fn go_on(text: &str, stop: &Stop, watcher: &dyn MergeWatcher) -> Result<()> {
    watcher.stage(text);
    if stop.requested() { Err(anyhow!("interrupted: nothing was written")) } else { Ok(()) }
}

/// A pair of maps that is worth a verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProposedPair {
    /// The maps as they were given, the earlier first.
    pub maps: [PathBuf; 2],
    /// Likeness of the words at their likeliest place, 0–1; nothing of LiDARs.
    pub score: Option<f32>,
    /// Places that both may show; nothing of LiDARs.
    pub places: Option<usize>,
}

/// The pairs of maps that are worth a verdict, the likeliest first: of cameras those that place recognition finds a common place of, in
/// one index over all, of LiDARs every two, since walls propose what no place does. Maps in buckets are called by their URIs.
///
/// # Errors
/// When a map cannot be read, there are both kinds, or `stop` was wished.
pub fn propose_pairs(
    maps: &[PathBuf],
    params: &MergingParams,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<Vec<ProposedPair>> {
    let given = blobs::local_maps(maps, &|text| watcher.stage(text))?;
    let maps: Vec<PathBuf> = given.iter().map(|map| map.local.clone()).collect();
    refuse_one(&maps)?;
    let called = |map: usize| given[map].given.clone();
    match sensors_at(&maps) {
        Sensors::Cameras => {}
        Sensors::Lidars => {
            let pair = |pair: [usize; 2]| ProposedPair { maps: pair.map(called), score: None, places: None };
            return Ok(merging::pairs(maps.len()).map(pair).collect());
        }
        Sensors::Mixed => {
            bail!("a map holds agents of both kinds; `loopbox unmerge` gives each agent's own map")
        }
    }
    let vocabulary = Vocabulary::shipped();
    let mut stage = |text: &str| go_on(text, stop, watcher);
    let loaded = merging::load_appearances(&maps, &vocabulary, &params.places, watcher, &mut stage)?;
    let (numbers, appearances): (Vec<usize>, Vec<_>) = loaded.into_iter().unzip();
    stage("looking for places that the maps share")?;
    let place = |number: usize| {
        let path = &maps[numbers[number]];
        maps.iter().position(|other| other == path).unwrap_or(numbers[number])
    };
    let mut pairs: Vec<([usize; 2], f32, usize)> = Vec::new();
    for ([a, b], score, places) in proposed(&appearances, &vocabulary, params) {
        let (a, b) = (place(a), place(b));
        pairs.push(([a.min(b), a.max(b)], score, places));
    }
    pairs.sort_by(|x, y| y.1.total_cmp(&x.1).then(x.0.cmp(&y.0)));
    let pair = |([a, b], score, places): ([usize; 2], f32, usize)| ProposedPair {
        maps: [called(a), called(b)],
        score: Some(score),
        places: Some(places),
    };
    Ok(pairs.into_iter().map(pair).collect())
}

/// Pairs a line each, with their score, for people.
pub fn listed_pairs(pairs: &[ProposedPair]) -> String {
    pairs.iter().fold(String::new(), |mut text, pair| {
        let [a, b] = [&pair.maps[0], &pair.maps[1]].map(|path| path.display());
        // Writing to a String cannot fail.
        let _ = match pair.score {
            Some(score) => writeln!(text, "{score:.3}\t{a}\t{b}"),
            None => writeln!(text, "–\t{a}\t{b}"),
        };
        text
    })
}
