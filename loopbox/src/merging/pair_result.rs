//! What two maps made of each other, and what is said of it.

use super::incremental;
use merge::acceptance::Decision;
use merge::further::Joined;
use merge::place_verdict::Answer;
use merge::verification::{EvaluatedClosure, Outcome, TestedPlace};
use serde::Serialize;
use std::sync::Arc;

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
