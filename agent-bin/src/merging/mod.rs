//! Merging maps as a user asks for it: features, places, meetings, closures and the common map, one step after
//! the other, with their times. The steps themselves are in the crate `merge`.

mod input;
mod method;
mod names;
mod output;
mod progress;
mod record;
mod report;
mod verdict;

pub use input::Input;
pub use method::method_parser;
pub use names::{Names, listed};
pub use output::{keep_from, map_file, write_maps, write_results};
pub use progress::MergeProgress;
pub use record::MergeRecord;
pub use verdict::{verdict, without_company};

use anyhow::{Context, Result};
use map::{AgentId, KeyframeId};
use merge::closure::Closure;
use merge::common_map::{Addresses, CommonMap, Fused, FusionParams, Link};
use merge::estimate::Estimate;
use merge::further::{FurtherParams, Joined, join};
use merge::key_points::KeyPointParams;
use merge::meeting::{MeetingParams, Outcome, Place, Tried, meet};
use merge::merge_graph::MergeGraph;
use merge::method::{BaselineParams, Method};
use merge::prepared::PreparedMap;
use place_recog::{ProposeParams, RankParams, Vocabulary, propose, ranked};
use serde::{Deserialize, Serialize};
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
    /// How maps are joined at an accepted closure: by Loop-box, or by a method to compare it with.
    pub method: Method,
    /// The methods to compare with.
    pub baseline: BaselineParams,
    /// Closures after the first.
    pub further: FurtherParams,
    /// The common map.
    pub fusion: FusionParams,
}

/// What two maps made of each other. The first closure's source is the later map, its target the earlier one: maps
/// join the world of the first.
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
    /// Seconds each step took.
    pub seconds: Seconds,
}

/// Wall-clock seconds of the steps of an encounter.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Place recognition: the index and all queries.
    pub places: f64,
    /// Matching places and following one to its verdict.
    pub meeting: f64,
    /// Further closures; of a method other than Loop-box all that it does.
    pub further: f64,
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
    /// Seconds that making the common map took.
    pub fusion_seconds: f64,
}

impl Seconds {
    /// Of all steps.
    pub fn total(&self) -> f64 {
        self.places + self.meeting + self.further
    }
}

impl Encounter {
    /// The accepted place; nothing where the maps were not merged.
    pub fn accepted(&self) -> Option<&Tried> {
        self.tried.iter().find(|tried| matches!(tried.outcome, Outcome::Accepted(..)))
    }

    /// Of maps that were not merged: the refused place of most matches, which came closest.
    pub fn closest(&self) -> Option<&Tried> {
        let refused = self.tried.iter().filter(|tried| refusal(&tried.outcome).is_some());
        // Of equals the first.
        let more = |best: &'_ Tried, next: &'_ Tried| next.match_count > best.match_count;
        refused.reduce(|best, next| if more(best, next) { next } else { best })
    }

    /// Why the maps were not merged; nothing where they were.
    pub fn refusal(&self) -> Option<String> {
        if self.accepted().is_some() {
            return None;
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
        Outcome::Doubted(_, _, doubt) => Some(doubt.to_string()),
        Outcome::NotFollowed | Outcome::Accepted(..) => None,
    }
}

/// Looks for meetings of every two of the inputs and makes the common map. `progress` is told what comes next, and
/// ends the merging with an error of its own.
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
    let maps: Vec<&map::Map> = inputs.iter().map(|input| &input.map).collect();
    let names = |a: usize, b: usize| format!("{} and {}", inputs[a].name, inputs[b].name);
    let (mut common, addresses) = CommonMap::from_maps(&maps).context("the maps cannot be merged")?;
    let prepared: Vec<PreparedMap> = inputs
        .iter()
        .map(|input| PreparedMap::new(&input.map, &input.features, &params.key_points))
        .collect();
    let mut encounters = Vec::new();
    for source in 1..inputs.len() {
        for target in 0..source {
            progress(&format!("looking where {} met", names(target, source)))?;
            let encounter = encounter([target, source], inputs, &prepared, vocabulary, params)
                .with_context(|| names(target, source))?;
            for edge in encounter.joined.iter().flat_map(|joined| &joined.edges) {
                let address = |input: usize, id: KeyframeId| {
                    let agent: AgentId = inputs[input].map.keyframes.get(&id)?.agent;
                    addresses[input].of(agent, id)
                };
                if let (Some(from), Some(to)) = (address(target, edge.from), address(source, edge.to)) {
                    let from_from_to =
                        Estimate { a_from_b: edge.from_from_to, information: edge.information };
                    common.link(Link { from, to, from_from_to });
                }
            }
            encounters.push(encounter);
        }
    }
    progress("making the common map")?;
    let start = Instant::now();
    // A baseline says how whole maps lie to each other, and no more.
    let optimise = params.fusion.optimise && params.method.baseline().is_none();
    let fusion = FusionParams { optimise, ..params.fusion.clone() };
    let fused = common.fuse(&fusion).context("the common map cannot be made")?;
    let fusion_seconds = start.elapsed().as_secs_f64();
    let graph = common.graph(&fusion).context("the graph of merges cannot be made")?;
    Ok(Merging { encounters, addresses, common, graph, fused, fusion_seconds })
}

/// One pair of inputs.
fn encounter(
    [target, source]: [usize; 2],
    inputs: &[Input],
    prepared: &[PreparedMap],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
) -> Result<Encounter> {
    let start = Instant::now();
    let (of_target, of_source) = (&inputs[target], &inputs[source]);
    let proposals = propose(&of_target.words, &of_source.words, vocabulary, &params.places);
    let proposals = ranked(proposals, of_target.directed(), of_source.directed(), &params.rank);
    let places: Vec<Place> =
        proposals.iter().map(|p| Place { source: p.query, target: p.keyframe }).collect();
    let recognised = start.elapsed().as_secs_f64();
    let tried = meet(&prepared[source], &prepared[target], &places, &params.meeting);
    let met = start.elapsed().as_secs_f64();
    let closure = tried.iter().find_map(|tried| match &tried.outcome {
        Outcome::Accepted(closure, _) => Some(closure),
        _ => None,
    });
    let joined =
        closure.map(|closure| joined(&prepared[source], &prepared[target], closure, params)).transpose()?;
    let seconds = Seconds {
        places: recognised,
        meeting: met - recognised,
        further: start.elapsed().as_secs_f64() - met,
    };
    Ok(Encounter { target, source, proposed: places.len(), tried, joined, seconds })
}

/// What joins two maps at an accepted closure, by the method asked for.
fn joined(
    source: &PreparedMap,
    target: &PreparedMap,
    closure: &Closure,
    params: &MergingParams,
) -> Result<Joined> {
    let Some(baseline) = params.method.baseline() else {
        return join(source, target, closure, &params.further).context("the closures cannot be compared");
    };
    let placement = baseline.place(source, target, closure, &params.baseline);
    let context = || format!("they met, but the method {} does not join them", params.method);
    Ok(placement.with_context(context)?.into())
}
