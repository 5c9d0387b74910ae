//! A merge as it is asked for, and its way from there to the results.

use super::joint::optimised;
use super::places::Appearances;
use super::verdicts::CameraVerdicts;
use super::{
    Input, KnownBefore, Manifest, MergeRecord, Merging, MergingParams, Names, isolated_agents, listed,
    merge_knowing, verdicts, write_results,
};
use crate::common_map::manifest::{ManifestMap, arrangements, begin, go_on};
use crate::swapping::SwapFiles;
use crate::verdicts::MapDigest;
use anyhow::Result;
use place_recog::{ProposeParams, Vocabulary};
use rayon::prelude::*;
use sources::Stop;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// How maps are to be merged.
#[derive(Clone, Debug)]
pub struct MergeOptions {
    /// Folder for the results; made if it is not there.
    pub out: PathBuf,
    /// Replace results of a run in that folder.
    pub force: bool,
    /// All parameters of all steps.
    pub params: MergingParams,
    /// Where verdicts on pairs are taken from and kept: a folder, which is made if it is not there, or the URI of a bucket. Where none is
    /// named, that of a manifest among the maps, else the folder `verdicts` in `out`.
    pub verdicts: Option<PathBuf>,
    /// Pairs of agents, each as `A+B`, of which a person says that both maps show one place: what differs between them keeps them apart no
    /// more. That is kept where verdicts are.
    pub confirm: Vec<String>,
    /// Maps of manifests among the given that are left out, by their names: as if they had never been merged.
    pub without: Vec<String>,
    /// Whether maps, clouds, trajectories and the report are written besides the manifest, which makes them at any time.
    pub map: bool,
}

impl MergeOptions {
    /// The usual merge, with results in `out`.
    pub fn to(out: impl Into<PathBuf>) -> Self {
        let (params, verdicts, confirm, without) = Default::default();
        Self { out: out.into(), force: false, params, verdicts, confirm, without, map: true }
    }
}

/// Is told how a merge goes.
pub trait MergeWatcher {
    /// What is done next.
    fn stage(&self, _text: &str) {}

    /// A step of what is done, for who looks for a fault.
    fn detail(&self, _text: &str) {}

    /// Something the user should know.
    fn warn(&self, _text: &str) {}
}

/// Tells nobody.
impl MergeWatcher for () {}

/// What came of a merge.
pub struct Merged {
    /// The maps.
    pub inputs: Vec<Input>,
    /// All that was found out about them.
    pub merging: Merging,
    /// What to call the agents.
    pub names: Names,
    /// The numbers, as in `merge.json`.
    pub record: MergeRecord,
    /// Wall-clock seconds of all of it, reading and writing included.
    pub seconds: f64,
}

impl Merged {
    /// Whether any two of the maps met. Only then results were written.
    pub fn any_joined(&self) -> bool {
        self.merging.any_joined()
    }

    /// For each pair what was decided and by what evidence, for people.
    pub fn verdict(&self) -> String {
        self.verdicts().collect()
    }

    /// The same, a pair at a time.
    pub fn verdicts(&self) -> impl Iterator<Item = String> {
        verdicts(&self.inputs, &self.merging)
    }
}

/// Merges the maps at `paths`, each a `map.mcap` or the folder of a run, and writes the common map; tells nobody how it
/// goes. A manifest stands for all of its maps, and verdicts that are kept are not found again. Where no two maps met, verdicts alone are
/// written.
///
/// ```no_run
/// use loopbox::merging::{MergeOptions, merge_maps};
///
/// let merged = merge_maps(&["out/a".into(), "out/b".into()], MergeOptions::to("out/merged"))?;
/// println!("{}", merged.verdict());
/// # Ok::<(), anyhow::Error>(())
/// ```
///
/// # Errors
/// When a map cannot be read, or the common map cannot be made or written. Then nothing but verdicts is written.
pub fn merge_maps(paths: &[PathBuf], options: MergeOptions) -> Result<Merged> {
    merge_maps_watched(paths, options, &Stop::default(), &())
}

/// The same, told to `watcher` and ended by `stop`.
///
/// # Errors
/// As [`merge_maps`], and when `stop` was wished.
pub fn merge_maps_watched(
    paths: &[PathBuf],
    mut options: MergeOptions,
    stop: &Stop,
    watcher: &dyn MergeWatcher,
) -> Result<Merged> {
    let start = Instant::now();
    let (given, mut output) = begin(paths, &options.without, (&options.out, options.force))?;
    // Other methods are compared as they are.
    options.params.joint &= options.params.method.baseline().is_none();
    let mut stage = |text: &str| {
        watcher.stage(text);
        go_on(stop)
    };
    let vocabulary = Vocabulary::shipped();
    let swap = Arc::new(SwapFiles::new(options.out.clone()));
    let inputs = load(&given.maps, &vocabulary, &swap, watcher, &mut stage)?;
    let params = &options.params;
    let digests = given.digests(&inputs.iter().map(|input| &input.path).collect::<Vec<_>>())?;
    let (place, kept) = given.verdicts(options.verdicts.as_deref(), &options.out)?;
    let verdicts = CameraVerdicts::among(kept, digests.clone(), params);
    let known = KnownBefore { confirm: &options.confirm, verdicts: Some(&verdicts), swap: Some(swap) };
    let mut merging = merge_knowing(&inputs, &vocabulary, params, known, &mut stage)?;
    let (names, provenance) = (Names::new(&merging.common), merging.provenance(&inputs, params));
    if params.joint && merging.any_joined() {
        stage("optimising the common map jointly")?;
        let settled = given.restore((&mut merging.fused, &merging.addresses), &digests, &provenance);
        for (fused, why) in
            optimised(&mut merging.fused, &settled, params.joint_keyframes, &|| stop.requested())
        {
            let names = names.list(&fused.agents);
            watcher.warn(&format!("the common map of {names} is not optimised jointly: {why}"));
        }
    }
    let mut record = MergeRecord::new(&inputs, &merging, params, &names)?;
    if merging.any_joined() {
        stage("writing the results")?;
        let groups = arrangements(&merging.fused, &merging.addresses, &provenance);
        let manifest = Manifest::new(lines(&inputs, digests), &place, groups, &options.out);
        match options.map {
            true => write_results(&mut output, &inputs, &merging, &names, Some(&manifest), &mut record)?,
            false => manifest.write(&mut output)?,
        }
        go_on(stop)?;
        output.commit()?;
        let lonely = isolated_agents(&merging, &names);
        if !lonely.is_empty() {
            let lonely: Vec<&str> = lonely.iter().map(String::as_str).collect();
            watcher.warn(&format!("{} met none of the others", listed(&lonely)));
        }
    }
    Ok(Merged { inputs, merging, names, record, seconds: start.elapsed().as_secs_f64() })
}

/// The maps as a manifest names them, whose files have these digests.
fn lines(inputs: &[Input], digests: Vec<MapDigest>) -> Vec<ManifestMap> {
    let line = |(input, sha256): (&Input, MapDigest)| {
        let (name, path) = (input.name.clone(), input.path.clone());
        ManifestMap { name, path, sha256 }
    };
    inputs.iter().zip(digests).map(line).collect()
}

/// Reads the maps with their features, and finds those that they lack. Maps of one name are told apart; those in metres
/// come first.
pub(crate) fn load(
    paths: &[PathBuf],
    vocabulary: &Arc<Vocabulary>,
    swap: &SwapFiles,
    watcher: &dyn MergeWatcher,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Vec<Input>> {
    let mut inputs: Vec<Input> = Vec::new();
    let read = |path: &Path| {
        let input = Input::load(path, vocabulary, swap)?;
        Ok(Loaded { warnings: input.warnings.clone(), what: input })
    };
    for mut input in read_all(paths, &read, watcher, stage)? {
        input.name_apart_from(&inputs);
        inputs.push(input);
    }
    // The common world is that of the first: metres, where one knows them.
    inputs.sort_by_key(|input| !input.map.is_metric());
    Ok(inputs)
}

/// What proposing asks of the maps, in the order of [`load`] and each with its place among `paths`. No more maps are held at a time than
/// there are cores.
pub(crate) fn load_appearances(
    paths: &[PathBuf],
    vocabulary: &Arc<Vocabulary>,
    params: &ProposeParams,
    watcher: &dyn MergeWatcher,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Vec<(usize, Appearances)>> {
    let folder = std::env::temp_dir();
    let kept = SwapFiles::new(folder.clone());
    let read = |path: &Path| {
        // Files of its own, which end with the map.
        let swap = SwapFiles::of_one_in(folder.clone(), rayon::current_num_threads());
        let mut input = Input::load(path, vocabulary, &swap)?;
        let (warnings, is_metric) = (std::mem::take(&mut input.warnings), input.map.is_metric());
        Ok(Loaded { what: (is_metric, Appearances::of(&input, params).apart(&kept)), warnings })
    };
    let read = read_all(paths, &read, watcher, stage)?;
    let mut all: Vec<(usize, (bool, Appearances))> = read.into_iter().enumerate().collect();
    all.sort_by_key(|(_, (is_metric, _))| !is_metric);
    Ok(all.into_iter().map(|(place, (_, appearances))| (place, appearances)).collect())
}

/// What is made of a map, with what is missing from it, for people.
struct Loaded<T> {
    what: T,
    warnings: Vec<String>,
}

/// What is made of each map, several read at a time.
fn read_all<T: Send>(
    paths: &[PathBuf],
    read: &(dyn Fn(&Path) -> Result<Loaded<T>> + Sync),
    watcher: &dyn MergeWatcher,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Vec<T>> {
    stage(&format!("reading {} maps, and finding the features that they lack", paths.len()))?;
    let loaded: Vec<Result<Loaded<T>>> = paths.par_iter().map(|path| read(path)).collect();
    let mut all = Vec::new();
    for loaded in loaded {
        let Loaded { what, warnings } = loaded?;
        warnings.iter().for_each(|warning| watcher.warn(warning));
        all.push(what);
    }
    Ok(all)
}
