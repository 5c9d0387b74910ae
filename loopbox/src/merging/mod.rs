//! Merging maps as a user asks for it: features, places, meetings, closures and the common map, one step after
//! the other, with their times. The steps themselves are in the crate `merge`.

mod input;
mod joint;
mod mixed;
mod names;
mod options;
mod output;
mod places;
mod record;
mod report;
mod rig;
mod verdict;

pub use crate::results::keep_from;
pub(crate) use input::name_of;
pub use input::{Input, features_of_keyframes};
pub use mixed::{MixedAgent, MixedEncounter, MixedMerged, MixedOptions, MixedRecord, merge_mixed};
pub(crate) use names::untaken;
pub use names::{Names, listed};
pub(crate) use options::refuse_one;
pub use options::{MergeOptions, MergeWatcher, Merged, merge_maps, merge_maps_watched};
pub use output::{map_file, write_maps, write_results};
pub use record::MergeRecord;
pub use rig::{RigInput, RigMerged, RigRecord, merge_rig};
#[cfg(feature = "fleet")]
pub(crate) use verdict::refusal_of;
pub use verdict::{verdict, without_company};

use anyhow::{Context, Result};
use map::{AgentId, KeyframeId};
use merge::acceptance::Decision;
use merge::common_map::{Addresses, CommonMap, Fused, FusionParams, Link, TakenBack};
use merge::estimate::Estimate;
use merge::further::{FurtherParams, Joined};
use merge::key_points::KeyPointParams;
use merge::meeting::{Judged, MeetingParams, Outcome, Place, Tried, meet};
use merge::merge_graph::MergeGraph;
use merge::method::{BaselineParams, Method};
use merge::prepared::PreparedMap;
use place_recog::{ProposeParams, RankParams, Vocabulary, ranked};
use places::{Places, places};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// How maps are merged: all parameters of all steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergingParams {
    /// Places that two maps may share.
    pub places: ProposeParams,
    /// Which of the proposed are looked at first.
    pub rank: RankParams,
    /// Depth at key points.
    pub key_points: KeyPointParams,
    /// From places to a closure.
    pub meeting: MeetingParams,
    /// How maps are joined at an accepted closure: directly, or by a method to compare that with.
    pub method: Method,
    /// The methods to compare with.
    pub baseline: BaselineParams,
    /// Closures after the first.
    pub further: FurtherParams,
    /// The common map.
    pub fusion: FusionParams,
    /// Whether all that the agents of a common map observe, of each other's points too, is optimised jointly in the end
    /// (`merge --optimise`). Default false: it takes longer than all else, seconds for maps of a hundred keyframes.
    pub joint: bool,
}

/// Keyframes of a map that stay ready for the next pair, at the most: of 640 × 480 pixels each takes some 4 MB.
const READY: usize = 24;

/// What two maps made of each other. Which of them is the source and which the target follows from the maps
/// themselves and not from the order in which they are given, so that no verdict depends on that.
#[derive(Clone)]
pub struct Encounter {
    /// Index of the target among the inputs.
    pub target: usize,
    /// Index of the source among the inputs.
    pub source: usize,
    /// How many places were proposed.
    pub proposed: usize,
    /// The places tried, and what became of them; at most one is accepted.
    pub tried: Vec<Tried>,
    /// The closures along both maps; nothing where none was accepted.
    pub joined: Option<Joined>,
    /// What went wrong, where a closure was accepted and yet the maps are not joined.
    pub error: Option<String>,
    /// Seconds each step took.
    pub seconds: Seconds,
}

/// Wall-clock seconds of the steps of an encounter.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Place recognition: the index and all queries.
    pub places: f64,
    /// Matching places and following them to their verdicts, closures along both maps included.
    pub meeting: f64,
    /// What another method than the default does at the accepted closure.
    pub method: f64,
}

/// A merging with all that led to it.
pub struct Merging {
    /// Every pair of inputs, in their order.
    pub encounters: Vec<Encounter>,
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
        self.places + self.meeting + self.method
    }
}

impl Encounter {
    /// The two inputs in the order in which they were given.
    pub fn as_given(&self) -> [usize; 2] {
        [self.target.min(self.source), self.target.max(self.source)]
    }

    /// The accepted closure; nothing where there was none.
    pub fn accepted(&self) -> Option<&Judged> {
        self.tried.iter().find_map(|tried| tried.outcome.accepted())
    }

    /// Of maps that were not merged: the refused place that came closest. One left undecided comes before all others,
    /// then the one of most matches.
    pub fn closest(&self) -> Option<&Tried> {
        let refused = self.tried.iter().filter(|tried| refusal(&tried.outcome).is_some());
        let close = |tried: &Tried| (tried.outcome.is_undecided(), tried.match_count);
        // Of equals the first.
        refused.reduce(|best, next| if close(next) > close(best) { next } else { best })
    }

    /// Whether nothing contradicts a closure of the two, and too little is known to believe it.
    pub fn is_undecided(&self) -> bool {
        self.accepted().is_none() && self.closest().is_some_and(|tried| tried.outcome.is_undecided())
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
        Some(self.closest().and_then(|tried| refusal(&tried.outcome)).unwrap_or_else(nothing))
    }
}

/// Why a place was not accepted; nothing where it was, or was not followed.
pub fn refusal(outcome: &Outcome) -> Option<String> {
    match outcome {
        Outcome::NotMatched(refusal) => Some(refusal.to_string()),
        Outcome::NotClosed(refusal) => Some(refusal.to_string()),
        Outcome::Broken(error) => Some(error.to_string()),
        Outcome::Judged(judged) => judged.verdict.doubt().map(|doubt| doubt.to_string()),
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
        Outcome::Judged(judged) => match judged.verdict.decision {
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
    merge_knowing(inputs, vocabulary, params, &|_| None, progress)
}

/// The same where of some pairs of inputs, the earlier first, it is `known` what they made of each other.
///
/// # Errors
/// As [`merge`].
pub(crate) fn merge_knowing(
    inputs: &[Input],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    known: &(dyn Fn([usize; 2]) -> Option<Encounter> + Sync),
    progress: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Merging> {
    let maps: Vec<&map::Map> = inputs.iter().map(|input| &input.map).collect();
    let names = |a: usize, b: usize| format!("{} and {}", inputs[a].name, inputs[b].name);
    let (mut common, addresses) = CommonMap::from_maps(&maps).context("the maps cannot be merged")?;
    let mut prepared: Vec<PreparedMap> = inputs
        .iter()
        .map(|input| PreparedMap::new(&input.map, &input.features, &params.key_points))
        .collect();
    let meeting = meeting_among(inputs.len(), params);
    let mut recalled: BTreeMap<[usize; 2], Encounter> =
        pairs(inputs.len()).filter_map(|pair| Some((pair, known(pair)?))).collect();
    progress("looking for places that the maps share")?;
    let mut shared = places(inputs, vocabulary, params, &|pair| !recalled.contains_key(&pair));
    let mut encounters = Vec::new();
    for [earlier, later] in pairs(inputs.len()) {
        progress(&format!("looking where {} met", names(earlier, later)))?;
        let encounter = match recalled.remove(&[earlier, later]) {
            Some(encounter) => encounter,
            None => {
                let mut take = |pair| Some((pair, shared.remove(&pair)?));
                let found = take([earlier, later]).or_else(|| take([later, earlier]));
                let (pair, places) = found.unwrap_or(([earlier, later], Places::default()));
                let encounter = encounter(pair, places, inputs, &prepared, &meeting, params);
                // What every pair leaves behind would be as much as all images.
                for map in pair {
                    prepared[map].forget_beyond(READY);
                    inputs[map].map.rest();
                }
                encounter
            }
        };
        let Encounter { target, source, .. } = encounter;
        for edge in encounter.joined.iter().flat_map(|joined| &joined.edges) {
            let address = |input: usize, id: KeyframeId| {
                let agent: AgentId = inputs[input].map.keyframes.get(&id)?.agent;
                addresses[input].of(agent, id)
            };
            if let (Some(from), Some(to)) = (address(target, edge.from), address(source, edge.to)) {
                let from_from_to = Estimate { a_from_b: edge.from_from_to, information: edge.information };
                common.link(Link { from, to, from_from_to });
            }
        }
        encounters.push(encounter);
    }
    progress("making the common map")?;
    let start = Instant::now();
    // A baseline says how whole maps lie to each other, and no more.
    let optimise = params.fusion.optimise && params.method.baseline().is_none();
    let fusion = FusionParams { optimise, ..params.fusion.clone() };
    let (fused, taken_back) = common.settle(&fusion).context("the common map cannot be made")?;
    let fusion_seconds = start.elapsed().as_secs_f64();
    let graph = common.graph(&fusion).context("the graph of merges cannot be made")?;
    Ok(Merging { encounters, addresses, common, graph, fused, taken_back, fusion_seconds })
}

/// How meetings are looked for among so many maps: of many pairs more look alike by chance, so the false alarms that
/// are expected of one are divided among them.
fn meeting_among(maps: usize, params: &MergingParams) -> MeetingParams {
    let mut meeting = params.meeting.clone();
    let pairs = (maps * maps.saturating_sub(1) / 2).max(1);
    meeting.closure.pair.two_view.max_false_alarms /= pairs as f64;
    meeting.closure.neighbourhood.pose.max_false_alarms /= pairs as f64;
    meeting
}

/// Every two of so many inputs, the earlier first: (0, 1), (0, 2), (1, 2), (0, 3), …
fn pairs(inputs: usize) -> impl Iterator<Item = [usize; 2]> {
    (1..inputs).flat_map(|later| (0..later).map(move |earlier| [earlier, later]))
}

/// One pair of inputs.
fn encounter(
    [target, source]: [usize; 2],
    places: Places,
    inputs: &[Input],
    prepared: &[PreparedMap],
    meeting: &MeetingParams,
    params: &MergingParams,
) -> Encounter {
    let start = Instant::now();
    let (of_target, of_source) = (&inputs[target], &inputs[source]);
    let proposals = ranked(places.proposals, of_target.directed(), of_source.directed(), &params.rank);
    let (places_s, places): (f64, Vec<Place>) =
        (places.seconds, proposals.iter().map(|p| Place { source: p.query, target: p.keyframe }).collect());
    let ranked = start.elapsed().as_secs_f64();
    let tried = meet(&prepared[source], &prepared[target], &places, meeting, &params.further);
    let met = start.elapsed().as_secs_f64();
    let accepted = tried.iter().find_map(|tried| tried.outcome.accepted());
    let joined = accepted.map(|judged| joined([&prepared[target], &prepared[source]], judged, params));
    let (joined, error) = match joined {
        None => (None, None),
        Some(Ok(joined)) => (joined, None),
        Some(Err(error)) => (None, Some(format!("{error:#}"))),
    };
    let seconds = Seconds {
        places: places_s + ranked,
        meeting: met - ranked,
        method: start.elapsed().as_secs_f64() - met,
    };
    Encounter { target, source, proposed: places.len(), tried, joined, error, seconds }
}

/// What joins two maps at an accepted closure, by the method asked for.
fn joined(
    [target, source]: [&PreparedMap; 2],
    judged: &Judged,
    params: &MergingParams,
) -> Result<Option<Joined>> {
    let Some(baseline) = params.method.baseline() else { return Ok(judged.joined.clone()) };
    let placement = baseline.place(source, target, &judged.closure, &params.baseline);
    let context = || format!("they met, but the method {} does not join them", params.method);
    Ok(Some(placement.with_context(context)?.into()))
}
