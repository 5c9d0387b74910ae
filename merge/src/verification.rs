//! From places proposed by place recognition to a loop closure that may be believed.

pub use crate::pair::Place;

use crate::acceptance::{AcceptanceParams, Decision, Doubt, Evidence, Verdict, judge};
use crate::closure::{
    Closure, ClosureParams, ClosureRefusal, NeighbourhoodPose, close, close_neighbourhood, matches_at,
    neighbourhood_pose,
};
use crate::further::{FurtherParams, Joined, extend, join};
use crate::pair::{ViewPair, view_pair};
use crate::prepared::PreparedMap;
use crate::rivals::{rival_share, speaks_for};
use crate::two_view::TwoViewRefusal;
use backend::posegraph::PoseGraphError;
use map::{Edge, KeyframeId};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How a meeting of two agents is looked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VerificationParams {
    /// How many proposed places are matched at a time, before the best of them is followed. Default 4; at least 1.
    /// More give a better choice, at some 10 ms each.
    pub places: usize,
    /// How often the next so many places are matched when none of those before was accepted. Default 6; at least 1.
    /// More find meetings that place recognition ranks low, and take longer to find that there is none.
    pub rounds: usize,
    /// Most matched places of a round that are followed through all steps. Default 3; at least 1.
    pub closures: usize,
    /// When no place was accepted by itself: how many are looked at once more with the keyframes around them, those of
    /// most matches first. Default 4; 0 or more, 0 for none. Each takes some 100 ms.
    pub neighbourhoods: usize,
    /// How a closure is followed.
    pub closure: ClosureParams,
    /// What it must show.
    pub acceptance: AcceptanceParams,
}

impl Default for VerificationParams {
    fn default() -> Self {
        Self {
            places: 4,
            rounds: 6,
            closures: 3,
            neighbourhoods: 4,
            closure: ClosureParams::default(),
            acceptance: AcceptanceParams::default(),
        }
    }
}

impl VerificationParams {
    /// How many places of so many proposed are matched at most: among more, more look alike by chance.
    pub fn matched_of(&self, proposed: usize) -> usize {
        proposed.min(self.places.max(1) * self.rounds.max(1))
    }
}

/// What became of a place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    #[serde(rename = "Judged")]
    Evaluated(Box<EvaluatedClosure>),
}

/// A closure with the verdict on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluatedClosure {
    /// The closure.
    pub closure: Closure,
    /// What it joins along both maps; nothing where the closure alone was not worth asking.
    pub joined: Option<Joined>,
    /// What is thought of it.
    pub verdict: Verdict,
}

impl Outcome {
    /// The closure and its verdict, where there is one.
    pub fn evaluated(&self) -> Option<&EvaluatedClosure> {
        match self {
            Self::Evaluated(evaluated) => Some(evaluated),
            _ => None,
        }
    }

    /// The closure that is believed.
    pub fn accepted(&self) -> Option<&EvaluatedClosure> {
        self.evaluated().filter(|evaluated| evaluated.verdict.accepts())
    }

    /// Whether no other place of the two maps is asked: maps are accepted, or kept apart by things that one has and the
    /// other has not. Another closure of these would be believed because it sees less of them.
    pub fn settles(&self) -> bool {
        self.evaluated().is_some_and(|evaluated| match &evaluated.verdict.decision {
            Decision::Accepted => true,
            Decision::Undecided(doubt) => doubt.is_similar_place(),
            Decision::Refused(_) => false,
        })
    }

    /// The closure at which two places were told apart by what both saw of the surface.
    fn double(&self) -> Option<&Closure> {
        let evaluated = self.evaluated()?;
        let is_double = matches!(evaluated.verdict.decision, Decision::Refused(Doubt::Double { .. }));
        is_double.then_some(&evaluated.closure)
    }

    /// Whether there is a closure that nothing contradicts and of which too little is known.
    pub fn is_undecided(&self) -> bool {
        self.evaluated().is_some_and(|evaluated| matches!(evaluated.verdict.decision, Decision::Undecided(_)))
    }
}

/// A place with what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TestedPlace {
    /// The place.
    pub place: Place,
    /// Key points of its images that are each other's nearest.
    pub matched: usize,
    /// γ of its images, those that agree with one pose; 0 where none do. Of keyframes matched together, the key points of
    /// all that agree.
    pub match_count: usize,
    /// What became of it.
    pub outcome: Outcome,
}

/// Matches the images of the proposed places, best proposals first and some at a time, and follows those with most
/// matches until one closure is believed. All places tried are returned, with their reasons; at most one is accepted.
///
/// The more places there are to try, the more often two of them look alike by chance: the false alarms expected of one
/// ([`max_false_alarms`](crate::two_view::TwoViewParams::max_false_alarms)) are divided among them.
///
/// Where no place is accepted by its own pairs of keyframes, the keyframes around some are matched together
/// ([`close_neighbourhood`]), which needs depth on one side only.
pub fn meet(
    source: &PreparedMap,
    target: &PreparedMap,
    places: &[Place],
    params: &VerificationParams,
    further: &FurtherParams,
) -> Vec<TestedPlace> {
    let mut tested = Vec::new();
    let mut params = params.clone();
    let count = params.matched_of(places.len());
    params.closure.pair.two_view.max_false_alarms /= count.max(1) as f64;
    params.closure.neighbourhood.pose.max_false_alarms /= params.neighbourhoods.max(1) as f64;
    for round in places.chunks(params.places.max(1)).take(params.rounds.max(1)) {
        let doubles: Vec<Closure> =
            tested.iter().filter_map(|tested: &TestedPlace| tested.outcome.double().cloned()).collect();
        let round = Round { places: round, proposed: places, doubles };
        tested.extend(try_round(source, target, round, &params, further));
        if tested.iter().any(|tested: &TestedPlace| tested.outcome.settles()) {
            return tested;
        }
    }
    // At a place that is another no more keyframes are asked.
    if tested.iter().all(|tested| tested.outcome.double().is_none()) {
        try_neighbourhoods(source, target, &mut tested, &params, further);
    }
    tested
}

/// Looks at the places of most matches once more, with the keyframes around them, until one closure is believed.
fn try_neighbourhoods(
    source: &PreparedMap,
    target: &PreparedMap,
    tested: &mut [TestedPlace],
    params: &VerificationParams,
    further: &FurtherParams,
) {
    let mut order: Vec<usize> = (0..tested.len()).collect();
    // Stable: of equals the one tried first.
    order.sort_by_key(|&index| std::cmp::Reverse(tested[index].matched));
    let mut spots: Vec<usize> = Vec::new();
    let radius = params.closure.neighbourhood.radius;
    for index in order {
        let near = |map: &PreparedMap, a: KeyframeId, b: KeyframeId| map.around(a, radius).contains(&b);
        let place = tested[index].place;
        let covered = spots.iter().any(|&spot| {
            let other = tested[spot].place;
            near(source, other.source, place.source) && near(target, other.target, place.target)
        });
        if !covered && spots.len() < params.neighbourhoods {
            spots.push(index);
        }
    }
    let pose = |&index: &usize| {
        let found = neighbourhood_pose(source, target, tested[index].place, &params.closure);
        (index, found)
    };
    let mut poses: Vec<(usize, Result<NeighbourhoodPose, ClosureRefusal>)> =
        spots.par_iter().map(pose).collect();
    let count =
        |found: &Result<NeighbourhoodPose, ClosureRefusal>| found.as_ref().map_or(0, |f| f.pose.distinct);
    poses.sort_by_key(|(_, found)| std::cmp::Reverse(count(found)));
    for (index, found) in poses {
        let match_count = count(&found);
        let outcome =
            match found.and_then(|found| close_neighbourhood(source, target, &found, &params.closure)) {
                Ok(closure) => decide(source, target, closure, Others::default(), params, further),
                Err(refusal) => Outcome::NotClosed(refusal),
            };
        let settled = outcome.settles();
        // What was found of the place alone stays where this found no more.
        if settled || outcome.evaluated().is_some() && tested[index].outcome.evaluated().is_none() {
            tested[index].outcome = outcome;
            tested[index].match_count = match_count;
        }
        if settled {
            break;
        }
    }
}

/// What is matched in one round of [`meet`].
struct Round<'a> {
    /// The places.
    places: &'a [Place],
    /// All that are proposed.
    proposed: &'a [Place],
    /// Closures of rounds before at which two places were told apart.
    doubles: Vec<Closure>,
}

/// One round of [`meet`]. Places that speak for the motion of a closure at which two places were told apart are not followed.
fn try_round(
    source: &PreparedMap,
    target: &PreparedMap,
    Round { places, proposed, mut doubles }: Round,
    params: &VerificationParams,
    further: &FurtherParams,
) -> Vec<TestedPlace> {
    let look = |place: &Place| -> Option<(Place, Result<ViewPair, TwoViewRefusal>)> {
        let (i, j) = (source.get(place.source)?, target.get(place.target)?);
        Some((*place, view_pair(i, j, &params.closure.pair)))
    };
    let mut seen: Vec<_> = places.par_iter().filter_map(look).collect();
    let count = |views: &Result<ViewPair, TwoViewRefusal>| views.as_ref().map_or(0, ViewPair::match_count);
    let matched = |views: &Result<ViewPair, TwoViewRefusal>| match views {
        Ok(views) => views.matches.len(),
        Err(refusal) => refusal.given(),
    };
    // Stable: of equals the better proposal first.
    seen.sort_by_key(|(_, views)| std::cmp::Reverse(count(views)));
    let pairs: Vec<&ViewPair> = seen.iter().filter_map(|(_, views)| views.as_ref().ok()).collect();
    let others = Others { matched: &pairs, proposed };
    let (mut followed, mut found) = (0, false);
    let is_of = |double: &Closure, views: &ViewPair| {
        speaks_for(source, target, double, views, &params.closure) == Some(true)
    };
    seen.iter()
        .map(|(place, views)| {
            let (matched, match_count) = (matched(views), count(views));
            let outcome = match views {
                Err(refusal) => Outcome::NotMatched(*refusal),
                Ok(_) if found || followed == params.closures => Outcome::NotFollowed,
                Ok(views) if doubles.iter().any(|double| is_of(double, views)) => Outcome::NotFollowed,
                Ok(views) => {
                    followed += 1;
                    follow(source, target, views.clone(), others, params, further)
                }
            };
            found |= outcome.settles();
            doubles.extend(outcome.double().cloned());
            TestedPlace { place: *place, matched, match_count, outcome }
        })
        .collect()
}

/// The other places of two maps.
#[derive(Clone, Copy, Default)]
struct Others<'a> {
    /// Those matched with the one that is followed, itself among them.
    matched: &'a [&'a ViewPair],
    /// All that are proposed.
    proposed: &'a [Place],
}

/// Follows one matched place to its verdict.
fn follow(
    source: &PreparedMap,
    target: &PreparedMap,
    views: ViewPair,
    others: Others,
    params: &VerificationParams,
    further: &FurtherParams,
) -> Outcome {
    match close(source, target, views, &params.closure) {
        Ok(closure) => decide(source, target, closure, others, params, further),
        Err(refusal) => Outcome::NotClosed(refusal),
    }
}

/// γ of the further pairs along both maps that agree: what matches there, where their images put them.
fn matches_along(
    source: &PreparedMap,
    target: &PreparedMap,
    closure: &Closure,
    joined: &Joined,
    params: &ClosureParams,
) -> usize {
    let own = |edge: &&Edge| {
        closure.consistent_pairs().any(|pair| (pair.source, pair.target) == (edge.to, edge.from))
    };
    let further: Vec<&Edge> = joined.edges.iter().filter(|edge| !own(edge)).collect();
    let count = |edge: &&Edge| {
        let place = Place { source: edge.to, target: edge.from };
        matches_at(source, target, place, &edge.from_from_to, params)
    };
    further.par_iter().map(count).sum()
}

/// What is thought of a closure that was believed, once the maps have grown by `fresh` keyframes of the source and of the target:
/// the closure itself and what was joined then stand, moved to where their keyframes are by now, and of the new keyframes it is asked
/// whether they say the same. Nothing where they do not, or where one of its keyframes is gone: then the maps have to
/// [`meet`] anew.
pub fn follow_on(
    source: &PreparedMap,
    target: &PreparedMap,
    before: &EvaluatedClosure,
    fresh: [&BTreeSet<KeyframeId>; 2],
    acceptance: &AcceptanceParams,
    further: &FurtherParams,
) -> Option<EvaluatedClosure> {
    let joined = before.joined.as_ref().filter(|_| before.verdict.accepts())?;
    let closure = before.closure.moved(source, target)?;
    if !joined.edges.iter().all(|edge| source.has(edge.to) && target.has(edge.from)) {
        return None;
    }
    let joined = extend(source, target, &closure, joined, fresh, further).ok()?;
    let Evidence { matches, rival_place, ln_false_alarms, .. } = before.verdict.evidence;
    let evidence =
        Evidence { matches, rival_place, ln_false_alarms, ..Evidence::new(&closure, Some(&joined)) };
    let verdict = judge(evidence, acceptance);
    verdict.accepts().then_some(EvaluatedClosure { closure, joined: Some(joined), verdict })
}

/// The verdict on a closure. Both whole maps are asked too, but where no pair's images could be aligned; and the others, where
/// all else speaks for it.
fn decide(
    source: &PreparedMap,
    target: &PreparedMap,
    closure: Closure,
    others: Others,
    params: &VerificationParams,
    further: &FurtherParams,
) -> Outcome {
    let alone = judge(Evidence::new(&closure, None), &params.acceptance);
    if matches!(alone.decision, Decision::Refused(_)) && alone.evidence.inlier_share <= 0.0 {
        return Outcome::Evaluated(Box::new(EvaluatedClosure { closure, joined: None, verdict: alone }));
    }
    match join(source, target, &closure, further) {
        Err(error) => Outcome::Broken(error),
        Ok(joined) => {
            let mut evidence = Evidence::new(&closure, Some(&joined));
            if evidence.matches < params.acceptance.min_matches {
                evidence.matches += matches_along(source, target, &closure, &joined, &params.closure);
            }
            let mut verdict = judge(evidence, &params.acceptance);
            // Also where a person may confirm the place: that says nothing of the pose.
            if verdict.confirmed(&params.acceptance).accepts() {
                let Others { matched, proposed } = others;
                let share = rival_share(source, target, &closure, matched, proposed, &params.closure);
                verdict = judge(Evidence { rival_place: Some(share), ..evidence }, &params.acceptance);
            }
            Outcome::Evaluated(Box::new(EvaluatedClosure { closure, joined: Some(joined), verdict }))
        }
    }
}
