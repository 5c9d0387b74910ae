//! Merging maps as a user asks for it: features, places, verification and the common map, one step after
//! the other, with their times. The steps themselves are in the crate `merge`.

mod batches;
mod confirming;
mod contradictions;
mod incremental;
pub(crate) mod input;
mod joint;
mod looking;
mod making;
mod mixed;
mod options;
mod output;
pub(crate) mod pair_result;
mod pair_results;
pub(crate) mod params;
mod places;
mod record;
mod report;
#[cfg(test)]
mod resting_tests;
mod rig;
mod verdict;
pub(crate) mod verdicts;

pub use crate::common_map::groups::{map_file, write_maps};
pub use crate::common_map::manifest::{Manifest, ManifestMap, is_manifest};
pub use crate::common_map::names::{Names, listed};
pub use crate::results::keep_from;
pub(crate) use crate::verdicts::pairs;
#[cfg(all(test, feature = "fleet"))]
pub(crate) use incremental::Seen;
pub use input::{Input, features_of_keyframes};
pub use mixed::{MixedAgent, MixedMerged, MixedOptions, MixedPairResult, MixedRecord, merge_mixed};
pub use options::{MergeOptions, MergeWatcher, Merged, merge_maps, merge_maps_watched};
pub(crate) use options::{load, load_appearances};
pub use output::write_results;
pub use pair_result::{PairResult, Seconds, outcome_name, refusal};
pub use pair_results::PairResults;
pub use params::MergingParams;
pub(crate) use places::Appearances;
pub use record::MergeRecord;
pub(crate) use record::PairRecord;
pub use rig::{RigInput, RigMerged, RigRecord, merge_rig};
pub(crate) use verdict::of_pair_alone as verdict_of;
pub use verdict::{isolated_agents, verdicts};
#[cfg(feature = "fleet")]
pub(crate) use {
    batches::{Groups, Known, Share},
    looking::{Batch, Looked, look},
    making::common_map,
    places::Places,
    verdict::refusal_of,
};

use anyhow::Result;
use geometry::Swap;
use merge::common_map::{Addresses, CommonMap, Fused, TakenBack};
use merge::merge_graph::MergeGraph;
use place_recog::Vocabulary;
use std::sync::Arc;
use verdicts::CameraVerdicts;

/// A merging with all that led to it.
pub struct Merging {
    /// Every pair of inputs that was looked at, in their order: of a [`merge`](fn@merge) all.
    pub pair_results: Arc<PairResults>,
    /// Where the inputs' keyframes are in the common map.
    pub addresses: Vec<Addresses>,
    /// The agents' own maps and the closures between them.
    pub common: CommonMap,
    /// Who was joined with whom.
    pub graph: MergeGraph,
    /// A map for each group of agents that hang together.
    pub fused: Vec<Fused>,
    /// The merges that the common map took back, and why.
    pub taken_back: Vec<TakenBack>,
    /// Seconds that making the common map took.
    pub fusion_seconds: f64,
}

/// Looks for meetings of every two of the inputs and makes the common map. `progress` is told what comes next, and
/// ends the merging with an error of its own. What goes wrong with one pair of maps is noted there, and the others are
/// merged.
///
/// # Errors
/// When the inputs cannot be in one map (two are of one run, say), the closures make no common map, or `progress`
/// will not go on.
pub fn merge(
    inputs: &[Input],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    progress: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Merging> {
    merge_knowing(inputs, vocabulary, params, KnownBefore::default(), progress)
}

/// What a merge begins with besides the maps.
#[derive(Clone, Default)]
pub(crate) struct KnownBefore<'a> {
    /// Pairs of inputs, `A+B`, of which a person says that both show one place.
    pub confirm: &'a [String],
    /// Where what pairs made of each other is kept for other merges.
    pub verdicts: Option<&'a CameraVerdicts<'a>>,
    /// Where that rests until the results are written; nothing where it stays in memory.
    pub swap: Option<Arc<dyn Swap>>,
}

/// [`merge`](fn@merge), of which something is known.
///
/// # Errors
/// As [`merge`](fn@merge), and when a verdict cannot be read or kept, or a pair cannot be joined that is confirmed.
pub(crate) fn merge_knowing(
    inputs: &[Input],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    known: KnownBefore,
    progress: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Merging> {
    let pair_results = pair_results(inputs, vocabulary, params, known, progress)?;
    progress("making the common map")?;
    making::common_map(inputs, pair_results.into(), params, params.fusion.optimise, &[])
}

/// What every two of the inputs make of each other, in their order.
///
/// # Errors
/// When the inputs cannot be in one map (two are of one run, say), `progress` will not go on, a verdict cannot be read or
/// kept, or a pair cannot be joined that is confirmed.
pub(crate) fn pair_results(
    inputs: &[Input],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    KnownBefore { confirm, verdicts, swap }: KnownBefore,
    progress: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<PairResults> {
    let known = |pair: [usize; 2]| {
        let found = verdicts.map_or(Ok(None), |verdicts| verdicts.get(pair))?;
        Ok(found.map(|pair_result| batches::Known { pair_result, is_due: false, may_grow: false }))
    };
    let keep = |pair_result: &PairResult| verdicts.map_or(Ok(()), |verdicts| verdicts.put(pair_result));
    let go = looking::Batch::whole(&known, swap, &keep);
    let mut pair_results = looking::look(inputs, vocabulary, params, go, progress)?.pair_results;
    confirming::confirm_pairs(&mut pair_results, inputs, confirm, params, verdicts)?;
    Ok(pair_results)
}

/// How much every two of the maps look alike by their likeliest place, and how many places they may share; those that share
/// none are left out.
pub(crate) fn proposed(
    maps: &[Appearances],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
) -> Vec<([usize; 2], f32, usize)> {
    let found = places::likely_places(maps, vocabulary, &params.places);
    found.into_iter().filter_map(|(pair, places)| Some((pair, places.first()?.score, places.len()))).collect()
}
