//! What two maps made of each other.

use super::closure::ClosureRecord;
use crate::merging::{Input, Merging, PairResult, PairResults, Seconds, outcome_name, refusal};
use map::{KeyframeId, Map};
use merge::acceptance::{Line, PlaceEvidence};
use merge::place_verdict::{Answer, Piece};
use merge::verification::TestedPlace;
use serde::{Serialize, Serializer};
use std::fmt;
use std::sync::Arc;

/// Pieces of surface that are listed.
const MOST_PIECES: usize = 20;

/// A pair of maps.
#[derive(Clone, Debug, Serialize)]
pub struct PairRecord {
    /// The name of the map that was searched. Which of two maps that is follows from the maps, not from their order.
    pub target: String,
    /// The name of the other map, whose keyframes were looked for.
    pub source: String,
    /// `accepted`, `undecided` or `refused`.
    pub verdict: &'static str,
    /// `same`, `same-changed`, `cannot-tell` or `different`: whether both show one place. Only the first two are said of maps that are
    /// joined. Nothing where they have nothing in common that could be asked.
    pub answer: Option<Answer>,
    /// Whether they are joined because a person said that both show one place.
    pub confirmed: bool,
    /// What both saw of the surface at the place that decided.
    pub place: Option<PlaceEvidence>,
    /// The pieces of that surface that say most, for and against, each with the part of `place.ln_ratio` that it adds.
    pub pieces: Vec<(Piece, f64)>,
    /// Whether a closure was accepted.
    pub accepted: bool,
    /// Of a pair that was not merged: why the place that came closest was not accepted.
    pub refusal: Option<String>,
    /// Places that place recognition proposed.
    pub proposed: usize,
    /// The places tried, those with most matches first.
    #[serde(rename = "tried")]
    pub tested: Vec<PlaceRecord>,
    /// The accepted closure, or of a pair that was not merged the one that came closest, where there is one.
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
    /// `accepted`, `undecided`, `refused`, `not matched`, `not followed`, `not closed` or `broken`.
    pub outcome: &'static str,
    /// Why it was not accepted: the line of the test that decided.
    pub reason: Option<String>,
    /// Every line of the test that was asked of it.
    pub lines: Vec<Line>,
}

/// What every two of the maps given made of each other, in the order of all pairs: a list of [`PairRecord`]s, of which each is made when
/// it is written.
#[derive(Clone)]
pub struct PairRecords {
    /// The inputs' names and maps.
    inputs: Vec<(String, Arc<Map>)>,
    pair_results: Arc<PairResults>,
}

impl PairRecords {
    pub(crate) fn new(inputs: &[Input], merging: &Merging) -> Self {
        let inputs = inputs.iter().map(|input| (input.name.clone(), Arc::clone(&input.map)));
        Self { inputs: inputs.collect(), pair_results: Arc::clone(&merging.pair_results) }
    }
}

impl Serialize for PairRecords {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let named = |input: usize| (&*self.inputs[input].0, &*self.inputs[input].1);
        serializer.collect_seq(self.pair_results.iter().map(|pair| PairRecord::of(&pair, named)))
    }
}

impl fmt::Debug for PairRecords {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("PairRecords").field("pairs", &self.pair_results.len()).finish_non_exhaustive()
    }
}

impl PairRecord {
    pub(crate) fn new(pair_result: &PairResult, inputs: &[Input]) -> Self {
        Self::of(pair_result, |input| (&*inputs[input].name, &*inputs[input].map))
    }

    /// That of inputs which are called so and have these maps.
    fn of<'a>(pair_result: &PairResult, input: impl Fn(usize) -> (&'a str, &'a Map)) -> Self {
        let [target, source] = [pair_result.target, pair_result.source].map(input);
        let maps = [target.1, source.1];
        let joined = pair_result.joined.as_ref();
        let closest = || pair_result.closest().and_then(|tested| tested.outcome.evaluated());
        let closure = pair_result.accepted().or_else(closest).map(ClosureRecord::new);
        Self {
            target: target.0.to_owned(),
            source: source.0.to_owned(),
            verdict: pair_result.verdict(),
            answer: pair_result.answer(),
            confirmed: pair_result.is_confirmed(),
            place: pair_result.decisive().and_then(|evaluated| evaluated.verdict.evidence.place),
            pieces: pieces(pair_result),
            accepted: pair_result.verdict() == "accepted",
            refusal: pair_result.refusal(),
            proposed: pair_result.proposed,
            tested: pair_result.tested.iter().map(|tested| PlaceRecord::new(tested, maps)).collect(),
            closure,
            links: joined.map_or(0, |joined| joined.edges.len()),
            rejected: joined.map_or(0, |joined| joined.rejected.len()),
            failed: joined.map_or(0, |joined| joined.failed),
            rival: joined.map_or(0, |joined| joined.rival),
            seconds: pair_result.seconds,
        }
    }
}

/// The pieces that say most.
fn pieces(pair_result: &PairResult) -> Vec<(Piece, f64)> {
    let place = pair_result.decisive().and_then(|evaluated| evaluated.joined.as_ref()?.place.as_ref());
    let mut pieces = place.map_or(Vec::new(), |place| place.weighed.pieces.clone());
    pieces.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    pieces.truncate(MOST_PIECES);
    pieces
}

impl PlaceRecord {
    fn new(tested: &TestedPlace, [target, source]: [&Map; 2]) -> Self {
        let time = |map: &Map, id: KeyframeId| map.keyframes.get(&id).map(|keyframe| keyframe.timestamp);
        Self {
            target_keyframe: tested.place.target.0,
            target_time: time(target, tested.place.target),
            source_keyframe: tested.place.source.0,
            source_time: time(source, tested.place.source),
            match_count: tested.match_count,
            outcome: outcome_name(&tested.outcome),
            reason: refusal(&tested.outcome),
            lines: tested.outcome.evaluated().map_or(Vec::new(), |evaluated| evaluated.verdict.lines.clone()),
        }
    }
}
