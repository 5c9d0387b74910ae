//! Merging maps as a user asks for it: features, places, verification and the common map, one step after
//! the other, with their times. The steps themselves are in the crate `merge`.

mod batches;
mod confirming;
mod contradictions;
mod incremental;
mod input;
mod joint;
mod looking;
mod making;
mod manifest;
mod mixed;
mod names;
mod options;
mod output;
mod pair_results;
mod places;
mod record;
mod report;
mod rig;
mod verdict;

pub use crate::results::keep_from;
pub(crate) use confirming::named_pair;
#[cfg(all(test, feature = "fleet"))]
pub(crate) use incremental::Seen;
pub(crate) use input::name_of;
pub use input::{Input, features_of_keyframes};
pub(crate) use looking::pairs;
pub use manifest::{Manifest, ManifestMap, is_manifest};
pub(crate) use manifest::{agent_digests, assembled, begin, maps_of};
pub use mixed::{MixedAgent, MixedMerged, MixedOptions, MixedPairResult, MixedRecord, merge_mixed};
pub(crate) use names::untaken;
pub use names::{Names, listed};
pub use options::{MergeOptions, MergeWatcher, Merged, merge_maps, merge_maps_watched};
pub(crate) use options::{load, load_appearances, refuse_one};
pub(crate) use output::{GroupMap, write_groups};
pub use output::{map_file, write_maps, write_results};
pub use pair_results::PairResults;
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

use crate::verdicts::CameraVerdicts;
use anyhow::Result;
use geometry::Swap;
use merge::acceptance::Decision;
use merge::common_map::{Addresses, CommonMap, Fused, FusionParams, TakenBack};
use merge::further::{FurtherParams, Joined};
use merge::key_points::KeyPointParams;
use merge::merge_graph::MergeGraph;
use merge::method::{BaselineParams, Method};
use merge::place_verdict::Answer;
use merge::verification::{EvaluatedClosure, Outcome, TestedPlace, VerificationParams};
use place_recog::{ProposeParams, RankParams, Vocabulary};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How maps are merged: all parameters of all steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergingParams {
    /// Places that two maps may share.
    pub places: ProposeParams,
    /// Which of the proposed are looked at first.
    pub rank: RankParams,
    /// Depth at key points.
    pub key_points: KeyPointParams,
    /// From places to a closure.
    #[serde(rename = "meeting")]
    pub verification: VerificationParams,
    /// How maps are joined at an accepted closure: directly, or by a method to compare that with.
    pub method: Method,
    /// The methods to compare with.
    pub baseline: BaselineParams,
    /// Closures after the first.
    pub further: FurtherParams,
    /// The common map.
    pub fusion: FusionParams,
    /// Whether all that the agents of a common map observe, of each other's points too, is optimised jointly in the end. Of maps that
    /// are joined by another method than the direct one nothing is.
    pub joint: bool,
    /// Most keyframes of a common map that is optimised jointly: its time grows with them, a hundred take seconds.
    pub joint_keyframes: usize,
}

impl Default for MergingParams {
    fn default() -> Self {
        let (places, rank, key_points, verification) = Default::default();
        let (method, baseline, further, fusion) = Default::default();
        Self {
            places,
            rank,
            key_points,
            verification,
            method,
            baseline,
            further,
            fusion,
            joint: true,
            joint_keyframes: 1000,
        }
    }
}

/// What two maps made of each other. Which of them is the source and which the target follows from the maps
/// themselves and not from the order in which they are given, so that no verdict depends on that. Copies share all that is
/// large.
#[derive(Clone)]
pub struct PairResult {
    /// Index of the target among the inputs.
    pub target: usize,
    /// Index of the source among the inputs.
    pub source: usize,
    /// How many places were proposed.
    pub proposed: usize,
    /// The places tried, and what became of them; at most one is accepted.
    pub tested: Arc<[TestedPlace]>,
    /// The closures along both maps; nothing where none was accepted.
    pub joined: Option<Arc<Joined>>,
    /// What went wrong, where a closure was accepted and yet the maps are not joined.
    pub error: Option<String>,
    /// Seconds each step took.
    pub seconds: Seconds,
    /// The maps as they were, where they may grow and were merged.
    pub(crate) seen: Option<Arc<incremental::Seen>>,
}

/// Wall-clock seconds of the steps of a pair of maps.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Place recognition: the index and all queries.
    pub places: f64,
    /// Matching places and following them to their verdicts, closures along both maps included.
    #[serde(rename = "meeting")]
    pub verification: f64,
    /// What another method than the default does at the accepted closure.
    pub method: f64,
}

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

impl Seconds {
    /// Of all steps.
    pub fn total(&self) -> f64 {
        self.places + self.verification + self.method
    }
}

impl PairResult {
    /// The two inputs in the order in which they were given.
    pub fn as_given(&self) -> [usize; 2] {
        [self.target.min(self.source), self.target.max(self.source)]
    }

    /// The accepted closure; nothing where there was none.
    pub fn accepted(&self) -> Option<&EvaluatedClosure> {
        self.tested.iter().find_map(|tested| tested.outcome.accepted())
    }

    /// The closure that the verdict rests on: the accepted one, or that at which two places were told apart, or the one that came
    /// closest.
    pub fn decisive(&self) -> Option<&EvaluatedClosure> {
        let evaluated = || self.tested.iter().filter_map(|tested| tested.outcome.evaluated());
        let is_double = |evaluated: &&EvaluatedClosure| {
            evaluated.verdict.evidence.place.is_some_and(|place| place.answer == Answer::Different)
        };
        let double = || evaluated().find(is_double).filter(|_| !self.is_undecided());
        self.accepted().or_else(double).or_else(|| self.closest()?.outcome.evaluated())
    }

    /// What is said of the two maps; nothing where they have nothing in common that could be asked.
    pub fn answer(&self) -> Option<Answer> {
        let place = self.decisive()?.verdict.evidence.place?;
        let is_joined = self.accepted().is_some() && self.error.is_none();
        Some(match place.answer {
            answer if is_joined => answer.of_joined(place.changed),
            // What else speaks against a closure leaves it open whether the place is one.
            answer if answer.joins() => Answer::CannotTell,
            answer => answer,
        })
    }

    /// Of maps that were not merged: the refused place that came closest. One left undecided comes before all others,
    /// then the one of most matches.
    pub fn closest(&self) -> Option<&TestedPlace> {
        let refused = self.tested.iter().filter(|tested| refusal(&tested.outcome).is_some());
        let close = |tested: &TestedPlace| (tested.outcome.is_undecided(), tested.match_count);
        // Of equals the first.
        refused.reduce(|best, next| if close(next) > close(best) { next } else { best })
    }

    /// Whether nothing contradicts a closure of the two, and too little is known to believe it.
    pub fn is_undecided(&self) -> bool {
        self.accepted().is_none() && self.closest().is_some_and(|tested| tested.outcome.is_undecided())
    }

    /// `accepted`, `undecided` or `refused`.
    pub fn verdict(&self) -> &'static str {
        match (self.accepted(), &self.error) {
            (Some(_), None) => "accepted",
            _ if self.is_undecided() => "undecided",
            _ => "refused",
        }
    }

    /// Why the maps were not merged; nothing where they were.
    pub fn refusal(&self) -> Option<String> {
        if self.accepted().is_some() {
            return self.error.clone();
        }
        let nothing = || "no place of one looks like a place of the other".to_owned();
        Some(self.closest().and_then(|tested| refusal(&tested.outcome)).unwrap_or_else(nothing))
    }
}

/// Why a place was not accepted; nothing where it was, or was not followed.
pub fn refusal(outcome: &Outcome) -> Option<String> {
    match outcome {
        Outcome::NotMatched(refusal) => Some(refusal.to_string()),
        Outcome::NotClosed(refusal) => Some(refusal.to_string()),
        Outcome::Broken(error) => Some(error.to_string()),
        Outcome::Evaluated(evaluated) => evaluated.verdict.doubt().map(|doubt| doubt.to_string()),
        Outcome::NotFollowed => None,
    }
}

/// What became of a place, in a word or two.
pub fn outcome_name(outcome: &Outcome) -> &'static str {
    match outcome {
        Outcome::NotMatched(_) => "not matched",
        Outcome::NotFollowed => "not followed",
        Outcome::NotClosed(_) => "not closed",
        Outcome::Broken(_) => "broken",
        Outcome::Evaluated(evaluated) => match evaluated.verdict.decision {
            Decision::Accepted => "accepted",
            Decision::Undecided(_) => "undecided",
            Decision::Refused(_) => "refused",
        },
    }
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
    let found = places::places(maps, vocabulary, params, &|_| true);
    let pair = |(pair, places): ([usize; 2], places::Places)| {
        let best = places.proposals.first()?;
        Some((pair, best.score, places.proposals.len()))
    };
    found.into_iter().filter_map(pair).collect()
}
