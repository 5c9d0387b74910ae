//! The numbers of a merging: what `merge.json` holds and `loopbox merge --json` prints.

mod agents;
mod closure;
mod pair_result;

pub use agents::{AgentRecord, GroupRecord};
pub use pair_result::{PairRecord, PairRecords};

use super::{Input, Merging, MergingParams};
use crate::common_map::groups::map_file;
use crate::common_map::names::Names;
use serde::Serialize;

/// Everything counted and measured when maps were merged.
#[derive(Clone, Debug, Serialize)]
pub struct MergeRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The commit that it was built from, where it is known.
    pub commit: Option<&'static str>,
    /// The maps given, in their order.
    pub inputs: Vec<InputRecord>,
    /// Every two of them.
    #[serde(rename = "encounters")]
    pub pair_results: PairRecords,
    /// Every agent of all maps, and where it is.
    pub agents: Vec<AgentRecord>,
    /// The agents that hang together, a map for each group; the first is `map.mcap`.
    pub groups: Vec<GroupRecord>,
    /// Time and memory.
    pub cost: Cost,
    /// The parameters.
    pub params: MergingParams,
    /// The files written beside this one, by their names.
    pub files: Vec<String>,
}

/// A map given.
#[derive(Clone, Debug, Serialize)]
pub struct InputRecord {
    /// Its path as given.
    pub path: String,
    /// What it is called.
    pub name: String,
    /// The names of its agents, as in [`AgentRecord::name`].
    pub agents: Vec<String>,
    /// Its keyframes.
    pub keyframes: usize,
    /// Features of them.
    pub features: usize,
    /// Keyframes whose features were found for this merge; those of the others were kept in the map.
    pub features_found: usize,
    /// Seconds it took to read the file.
    pub reading_s: f64,
    /// Seconds it took to read or find the features of all keyframes and their words.
    pub features_s: f64,
}

/// Time and memory.
#[derive(Clone, Debug, Serialize)]
pub struct Cost {
    /// Seconds to read the maps, each one's own; several are read at a time.
    pub reading_s: f64,
    /// Seconds for features, read or found, and words of all keyframes, likewise.
    pub features_s: f64,
    /// Seconds for all pairs of maps: place recognition, meetings and further closures.
    pub pairs_s: f64,
    /// Seconds to make the common map.
    pub fusion_s: f64,
    /// `pairs_s + fusion_s`: the merge, of maps whose keyframes have features.
    pub merge_s: f64,
    /// CPU seconds of all threads up to here, reading included.
    pub cpu_s: Option<f64>,
    /// Largest resident memory of the process, bytes.
    pub peak_memory_bytes: Option<u64>,
}

impl MergeRecord {
    /// The numbers of a merging; `files` are named when they are written.
    ///
    /// # Errors
    /// When the closures do not make the graph that they made before.
    pub fn new(
        inputs: &[Input],
        merging: &Merging,
        params: &MergingParams,
        names: &Names,
    ) -> anyhow::Result<Self> {
        Ok(Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: crate::program::commit(),
            inputs: inputs
                .iter()
                .zip(&merging.addresses)
                .map(|(i, a)| InputRecord::new(i, a, names))
                .collect(),
            pair_results: PairRecords::new(inputs, merging),
            agents: agents::all(merging, names)?,
            groups: groups(merging, names),
            cost: Cost::new(inputs, merging),
            params: params.clone(),
            files: Vec::new(),
        })
    }
}

/// The groups with their files.
fn groups(merging: &Merging, names: &Names) -> Vec<GroupRecord> {
    let group = |(index, fused)| GroupRecord::new(fused, &map_file(index, fused, names), names);
    merging.fused.iter().enumerate().map(group).collect()
}

impl InputRecord {
    fn new(input: &Input, addresses: &merge::common_map::Addresses, names: &Names) -> Self {
        Self {
            path: input.path.display().to_string(),
            name: input.name.clone(),
            agents: addresses.agents().map(|agent| names.of(agent).to_owned()).collect(),
            keyframes: input.map.keyframes.len(),
            features: input.words.values().map(|words| words.features()).sum(),
            features_found: input.found,
            reading_s: input.seconds.reading,
            features_s: input.seconds.features,
        }
    }
}

impl Cost {
    fn new(inputs: &[Input], merging: &Merging) -> Self {
        let pairs_s = merging.pair_results.seconds();
        Self {
            reading_s: inputs.iter().map(|input| input.seconds.reading).sum(),
            features_s: inputs.iter().map(|input| input.seconds.features).sum(),
            pairs_s,
            fusion_s: merging.fusion_seconds,
            merge_s: pairs_s + merging.fusion_seconds,
            cpu_s: view::process::cpu_seconds(),
            peak_memory_bytes: view::process::peak_memory_bytes(),
        }
    }
}
