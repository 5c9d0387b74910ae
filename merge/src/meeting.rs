//! From places proposed by place recognition to a loop closure that may be believed.

use crate::acceptance::{AcceptanceParams, Decision, Evidence, Verdict, judge};
use crate::closure::{Closure, ClosureParams, ClosureRefusal, close};
use crate::further::{FurtherParams, Joined, join};
use crate::pair::{ViewPair, view_pair};
use crate::prepared::PreparedMap;
use crate::two_view::TwoViewRefusal;
use backend::posegraph::PoseGraphError;
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
    /// There is a closure, and something is wrong with the maps it joins.
    Broken(PoseGraphError),
    /// There is a closure, and it was judged.
    Judged(Box<Judged>),
}

/// A closure with the verdict on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// The closure.
    pub closure: Closure,
    /// What it joins along both maps; nothing where the closure alone was not worth asking.
    pub joined: Option<Joined>,
    /// What is thought of it.
    pub verdict: Verdict,
}

impl Outcome {
    /// The closure and its verdict, where there is one.
    pub fn judged(&self) -> Option<&Judged> {
        match self {
            Self::Judged(judged) => Some(judged),
            _ => None,
        }
    }

    /// The closure that is believed.
    pub fn accepted(&self) -> Option<&Judged> {
        self.judged().filter(|judged| judged.verdict.accepts())
    }

    /// Whether there is a closure that nothing contradicts and of which too little is known.
    pub fn is_undecided(&self) -> bool {
        self.judged().is_some_and(|judged| matches!(judged.verdict.decision, Decision::Undecided(_)))
    }
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
///
/// The more places there are to try, the more often two of them look alike by chance: the false alarms expected of one
/// ([`max_false_alarms`](crate::two_view::TwoViewParams::max_false_alarms)) are divided among them.
pub fn meet(
    source: &PreparedMap,
    target: &PreparedMap,
    places: &[Place],
    params: &MeetingParams,
    further: &FurtherParams,
) -> Vec<Tried> {
    let mut tried = Vec::new();
    let mut params = params.clone();
    let count = places.len().min(params.places.max(1) * params.rounds.max(1));
    params.closure.pair.two_view.max_false_alarms /= count.max(1) as f64;
    for round in places.chunks(params.places.max(1)).take(params.rounds.max(1)) {
        tried.extend(try_round(source, target, round, &params, further));
        if tried.iter().any(|tried: &Tried| tried.outcome.accepted().is_some()) {
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
    further: &FurtherParams,
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
                    follow(source, target, views, params, further)
                }
            };
            found |= outcome.accepted().is_some();
            Tried { place, match_count, outcome }
        })
        .collect()
}

/// Follows one matched place to its verdict. Both whole maps are asked too, but where no pair's images could be aligned.
fn follow(
    source: &PreparedMap,
    target: &PreparedMap,
    views: ViewPair,
    params: &MeetingParams,
    further: &FurtherParams,
) -> Outcome {
    let closure = match close(source, target, views, &params.closure) {
        Ok(closure) => closure,
        Err(refusal) => return Outcome::NotClosed(refusal),
    };
    let alone = judge(Evidence::new(&closure, None), &params.acceptance);
    if matches!(alone.decision, Decision::Refused(_)) && alone.evidence.inlier_share <= 0.0 {
        return Outcome::Judged(Box::new(Judged { closure, joined: None, verdict: alone }));
    }
    match join(source, target, &closure, further) {
        Err(error) => Outcome::Broken(error),
        Ok(joined) => {
            let verdict = judge(Evidence::new(&closure, Some(&joined)), &params.acceptance);
            Outcome::Judged(Box::new(Judged { closure, joined: Some(joined), verdict }))
        }
    }
}
