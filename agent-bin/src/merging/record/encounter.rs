//! What two maps made of each other.

use super::closure::ClosureRecord;
use crate::merging::{Encounter, Input, Seconds, refusal};
use map::{KeyframeId, Map};
use merge::meeting::{Outcome, Tried};
use serde::Serialize;

/// A pair of maps.
#[derive(Clone, Debug, Serialize)]
pub struct EncounterRecord {
    /// The name of the earlier map, whose world the other joins.
    pub target: String,
    /// The name of the later map.
    pub source: String,
    /// Whether a closure was accepted.
    pub accepted: bool,
    /// Of a pair that was refused: why the place with most matches was.
    pub refusal: Option<String>,
    /// Places that place recognition proposed.
    pub proposed: usize,
    /// The places tried, those with most matches first.
    pub tried: Vec<PlaceRecord>,
    /// The accepted closure.
    pub closure: Option<ClosureRecord>,
    /// Closures that join the maps: those of the accepted place and further ones, as far as they agree.
    pub links: usize,
    /// Closures that do not agree with the others.
    pub rejected: usize,
    /// Further places along the maps whose images could not be aligned.
    pub failed: usize,
    /// How many of the rejected closures agree with each other at most.
    pub rival: usize,
    /// Seconds that each step took.
    pub seconds: Seconds,
}

/// A place that both maps may show.
#[derive(Clone, Debug, Serialize)]
pub struct PlaceRecord {
    /// Keyframe of the target.
    pub target_keyframe: u32,
    /// When it was taken, seconds.
    pub target_time: Option<f64>,
    /// Keyframe of the source.
    pub source_keyframe: u32,
    /// When it was taken, seconds.
    pub source_time: Option<f64>,
    /// γ: matches that agree with one relative pose; 0 where none do.
    pub match_count: usize,
    /// `accepted`, `not matched`, `not followed`, `not closed` or `doubted`.
    pub outcome: &'static str,
    /// Why it was not accepted.
    pub reason: Option<String>,
}

impl EncounterRecord {
    pub(super) fn new(encounter: &Encounter, inputs: &[Input]) -> Self {
        let maps = [encounter.target, encounter.source].map(|index| &inputs[index].map);
        let joined = encounter.joined.as_ref();
        let closure = encounter.accepted().and_then(|tried| match &tried.outcome {
            Outcome::Accepted(closure, evidence) => Some(ClosureRecord::new(closure, evidence)),
            _ => None,
        });
        Self {
            target: inputs[encounter.target].name.clone(),
            source: inputs[encounter.source].name.clone(),
            accepted: closure.is_some(),
            refusal: encounter.refusal(),
            proposed: encounter.proposed,
            tried: encounter.tried.iter().map(|tried| PlaceRecord::new(tried, maps)).collect(),
            closure,
            links: joined.map_or(0, |joined| joined.edges.len()),
            rejected: joined.map_or(0, |joined| joined.rejected.len()),
            failed: joined.map_or(0, |joined| joined.failed),
            rival: joined.map_or(0, |joined| joined.rival),
            seconds: encounter.seconds,
        }
    }
}

impl PlaceRecord {
    fn new(tried: &Tried, [target, source]: [&Map; 2]) -> Self {
        let time = |map: &Map, id: KeyframeId| map.keyframes.get(&id).map(|keyframe| keyframe.timestamp);
        Self {
            target_keyframe: tried.place.target.0,
            target_time: time(target, tried.place.target),
            source_keyframe: tried.place.source.0,
            source_time: time(source, tried.place.source),
            match_count: tried.match_count,
            outcome: match &tried.outcome {
                Outcome::NotMatched(_) => "not matched",
                Outcome::NotFollowed => "not followed",
                Outcome::NotClosed(_) => "not closed",
                Outcome::Doubted(..) => "doubted",
                Outcome::Accepted(..) => "accepted",
            },
            reason: refusal(&tried.outcome),
        }
    }
}
