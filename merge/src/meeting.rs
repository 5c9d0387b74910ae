//! From places proposed by place recognition to a loop closure that may be believed.

use crate::acceptance::{AcceptanceParams, Doubt, Evidence, evidence, judge};
use crate::closure::{Closure, ClosureParams, ClosureRefusal, close};
use crate::pair::{ViewPair, view_pair};
use crate::prepared::PreparedMap;
use crate::two_view::TwoViewRefusal;
use map::KeyframeId;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a meeting of two agents is looked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MeetingParams {
    /// How many proposed places are matched at a time, before the best of them is followed. Default 4; at least 1.
    /// More give a better choice, at some 10 ms each.
    pub places: usize,
    /// How often the next so many places are matched when none of those before was accepted. Default 6; at least 1.
    /// More find meetings that place recognition ranks low, and take longer to find that there is none.
    pub rounds: usize,
    /// Most matched places of a round that are followed through all steps. Default 3; at least 1.
    pub closures: usize,
    /// How a closure is followed.
    pub closure: ClosureParams,
    /// What it must show.
    pub acceptance: AcceptanceParams,
}

impl Default for MeetingParams {
    fn default() -> Self {
        Self {
            places: 4,
            rounds: 6,
            closures: 3,
            closure: ClosureParams::default(),
            acceptance: AcceptanceParams::default(),
        }
    }
}

/// A place that both agents may have seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Keyframe of the source.
    pub source: KeyframeId,
    /// Keyframe of the target.
    pub target: KeyframeId,
}

/// What became of a place.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The images do not fit.
    NotMatched(TwoViewRefusal),
    /// Others were followed before it, and they sufficed or were enough.
    NotFollowed,
    /// The steps came to nothing.
    NotClosed(ClosureRefusal),
    /// There is a closure, which is not believed.
    Doubted(Box<Closure>, Evidence, Doubt),
    /// There is a closure, and it is believed.
    Accepted(Box<Closure>, Evidence),
}

/// A place with what became of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Tried {
    /// The place.
    pub place: Place,
    /// γ of its images; 0 where they do not fit.
    pub match_count: usize,
    /// What became of it.
    pub outcome: Outcome,
}

/// Matches the images of the proposed places, best proposals first and some at a time, and follows those with most
/// matches until one closure is believed. All places tried are returned, with their reasons; at most one is accepted.
pub fn meet(
    source: &PreparedMap,
    target: &PreparedMap,
    places: &[Place],
    params: &MeetingParams,
) -> Vec<Tried> {
    let mut tried = Vec::new();
    for round in places.chunks(params.places.max(1)).take(params.rounds.max(1)) {
        tried.extend(try_round(source, target, round, params));
        if tried.iter().any(|tried: &Tried| matches!(tried.outcome, Outcome::Accepted(..))) {
            break;
        }
    }
    tried
}

/// One round of [`meet`].
fn try_round(
    source: &PreparedMap,
    target: &PreparedMap,
    places: &[Place],
    params: &MeetingParams,
) -> Vec<Tried> {
    let look = |place: &Place| -> Option<(Place, Result<ViewPair, TwoViewRefusal>)> {
        let (i, j) = (source.get(place.source)?, target.get(place.target)?);
        Some((*place, view_pair(i, j, &params.closure.pair)))
    };
    let mut seen: Vec<_> = places.par_iter().filter_map(look).collect();
    let count = |views: &Result<ViewPair, TwoViewRefusal>| views.as_ref().map_or(0, ViewPair::match_count);
    // Stable: of equals the better proposal first.
    seen.sort_by_key(|(_, views)| std::cmp::Reverse(count(views)));
    let (mut followed, mut found) = (0, false);
    seen.into_iter()
        .map(|(place, views)| {
            let match_count = count(&views);
            let outcome = match views {
                Err(refusal) => Outcome::NotMatched(refusal),
                Ok(_) if found || followed == params.closures => Outcome::NotFollowed,
                Ok(views) => {
                    followed += 1;
                    follow(source, target, views, params)
                }
            };
            found |= matches!(outcome, Outcome::Accepted(..));
            Tried { place, match_count, outcome }
        })
        .collect()
}

/// Follows one matched place to its verdict.
fn follow(source: &PreparedMap, target: &PreparedMap, views: ViewPair, params: &MeetingParams) -> Outcome {
    match close(source, target, views, &params.closure) {
        Err(refusal) => Outcome::NotClosed(refusal),
        Ok(closure) => {
            let evidence = evidence(&closure);
            match judge(&evidence, &params.acceptance) {
                Ok(()) => Outcome::Accepted(Box::new(closure), evidence),
                Err(doubt) => Outcome::Doubted(Box::new(closure), evidence, doubt),
            }
        }
    }
}
