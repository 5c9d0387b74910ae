//! How far two maps are looked at, and what that takes next.

use super::PushNew;
use super::known_map::{KnownMap, PATIENCE};
use crate::fleet::agents::FEWEST;
use fleet::manifest::Kind;
use fleet::store::Objects;
use map::KeyframeId;
use place_recog::{Proposal, ProposeParams, RankParams, Vocabulary, propose, ranked};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Instant;

/// Proposals by words whose features are looked at. Of opposite directions the best place is 25th and 30th by words
/// (`place_recog::ranked`).
const PROPOSALS: usize = 32;
/// Places that are tried by parts of the maps at the most: as many as merging matches before it follows the best.
const PLACES: usize = 4;

/// A place of both maps.
type Place = [KeyframeId; 2];

/// Two maps.
#[derive(Default)]
pub(super) struct Pair {
    /// The sketches as they were looked at.
    seen: [u64; 2],
    proposals: Vec<Proposal>,
    places: Vec<Place>,
    /// Places that were tried in vain.
    vain: BTreeSet<Place>,
    /// Whether a map that is here as a whole is looked at as a whole, after places that came to nothing by parts of both:
    /// what is here costs the link nothing, and gives the lines of the acceptance more to ask.
    by_wholes: bool,
    /// Which of the maps are.
    wholes: [bool; 2],
    /// How much the maps look alike at their best place: by the words, 0–1, and then by the features they share, 1 and more.
    similarity: f32,
    stage: Stage,
    /// Since when it is left to another one, if it is.
    left_since: Option<Instant>,
}

#[derive(Default, PartialEq)]
enum Stage {
    /// Not looked at yet, or not since one of the maps grew.
    #[default]
    New,
    /// The features of the proposals are to be compared.
    Choosing,
    /// So many of the places are tried.
    Trying { places: usize, is_ready: bool },
    /// The motion found is looked at with more keyframes.
    Confirming { keyframes: [Vec<KeyframeId>; 2], is_ready: bool },
    /// They met.
    Merged,
    /// They did not, as far as can be seen.
    Apart,
}

/// What a pair takes next.
pub(super) enum Step {
    /// Nothing by now.
    Idle,
    /// To be looked at further in the next go.
    Later,
    /// The digests of all keyframes, of either map those that lack.
    Waits([Vec<(Kind, u32)>; 2]),
    /// Objects of either map.
    Fetch([Vec<(Kind, u32)>; 2]),
    /// All is here that is to be merged.
    Ready,
}

/// How much more is looked at in one batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Budget {
    /// Keyframes that are looked for in another map: some 15 µs each.
    pub keyframes: usize,
    /// Pairs whose places are compared by their features: some ms each.
    pub choices: usize,
}

impl Pair {
    /// Leaves it to another one, if that does not take too long already; whether it is left.
    pub fn leave(&mut self, now: Instant) -> bool {
        now.saturating_duration_since(*self.left_since.get_or_insert(now)) < PATIENCE
    }

    /// Nobody looks at it any more: one of its agents is gone.
    pub fn take_back(&mut self) {
        self.left_since = None;
    }

    /// What it takes next.
    pub fn step(
        &mut self,
        [a, b]: [&mut KnownMap; 2],
        store: &dyn Objects,
        vocabulary: &Arc<Vocabulary>,
        budget: &mut Budget,
    ) -> Step {
        if a.missing > 0 || b.missing > 0 {
            return Step::Waits([a.lacking_digests(), b.lacking_digests()]);
        }
        if [&a.words, &b.words].iter().any(|words| words.len() < FEWEST) {
            return Step::Idle;
        }
        let now = [a.version, b.version];
        if std::mem::replace(&mut self.seen, now) != now && self.stage != Stage::Merged {
            self.stage = Stage::New;
        }
        if self.stage == Stage::New {
            if budget.keyframes == 0 {
                return Step::Later;
            }
            budget.keyframes = budget.keyframes.saturating_sub(b.words.len());
            self.propose([&*a, &*b], vocabulary);
        }
        if self.stage == Stage::Choosing
            && let Some(step) = self.choose([&mut *a, &mut *b], store, vocabulary, budget)
        {
            return step;
        }
        if self.by_wholes && self.is_pending() {
            self.wholes = [&*a, &*b].map(|map| map.lacks(&map.all(), store).is_empty());
            // Where both are here, they are merged as wholes anyway.
            if self.wholes[0] == self.wholes[1] {
                self.abandon();
            }
        }
        let keyframes = self.keyframes([&*a, &*b]);
        let lacking = [a.lacks(&keyframes[0], store), b.lacks(&keyframes[1], store)];
        match &mut self.stage {
            Stage::Trying { is_ready, .. } | Stage::Confirming { is_ready, .. } => {
                *is_ready = lacking.iter().all(Vec::is_empty);
                if *is_ready { Step::Ready } else { Step::Fetch(lacking) }
            }
            _ => Step::Idle,
        }
    }

    /// Finds places by the words of both maps.
    fn propose(&mut self, [a, b]: [&KnownMap; 2], vocabulary: &Arc<Vocabulary>) {
        self.by_wholes = false;
        self.proposals = propose(&a.words, &b.words, vocabulary, &ProposeParams::default());
        self.proposals.truncate(PROPOSALS);
        self.similarity = self.proposals.first().map_or(0.0, |best| best.score);
        self.stage = Stage::Choosing;
    }

    /// Chooses the places that are tried by the features of both maps; what that takes first, if anything.
    fn choose(
        &mut self,
        [a, b]: [&mut KnownMap; 2],
        store: &dyn Objects,
        vocabulary: &Arc<Vocabulary>,
        budget: &mut Budget,
    ) -> Option<Step> {
        let of = |keyframe: fn(&Proposal) -> KeyframeId| -> Vec<KeyframeId> {
            self.proposals.iter().map(keyframe).collect()
        };
        let lacking = [
            a.read(&of(|proposal| proposal.keyframe), store, vocabulary),
            b.read(&of(|proposal| proposal.query), store, vocabulary),
        ];
        if lacking.iter().any(|lacking| !lacking.is_empty()) {
            return Some(Step::Fetch(lacking));
        }
        if budget.choices == 0 {
            return Some(Step::Later);
        }
        budget.choices -= 1;
        let params = RankParams::default();
        let ranked = ranked(std::mem::take(&mut self.proposals), a.directed(), b.directed(), &params);
        let shared = ranked.first().and_then(|best| best.shared);
        self.similarity = shared.map_or(self.similarity, |shared| 1.0 + shared as f32);
        let places = ranked.iter().map(|place| [place.keyframe, place.query]);
        self.places = places.filter(|place| !self.vain.contains(place)).take(PLACES).collect();
        self.stage = match self.places.len() {
            0 => Stage::Apart,
            _ => Stage::Trying { places: 1, is_ready: false },
        };
        None
    }

    /// The keyframes of both maps by which it is seen whether they met, the most urgent first.
    pub fn keyframes(&self, [a, b]: [&KnownMap; 2]) -> [Vec<KeyframeId>; 2] {
        let (places, more) = match &self.stage {
            Stage::Trying { places, .. } => (*places, None),
            Stage::Confirming { keyframes, .. } => (self.places.len(), Some(keyframes)),
            _ => (0, None),
        };
        let of = |side: usize, known_map: &KnownMap| {
            let mut keyframes = Vec::new();
            if self.by_wholes && self.wholes[side] && places > 0 {
                return known_map.all();
            }
            for place in &self.places[..places.min(self.places.len())] {
                keyframes.push_new(known_map.around(place[side]));
            }
            keyframes.push_new(more.map_or_else(Vec::new, |more| more[side].clone()));
            keyframes
        };
        [of(0, a), of(1, b)]
    }

    /// Takes note of what the merge found: nothing, or that they met and which keyframes are to be looked at then.
    pub fn record_outcome(&mut self, met: Option<[Vec<KeyframeId>; 2]>) {
        self.stage = match (&self.stage, met) {
            (Stage::Trying { places, .. }, Some(keyframes)) => {
                self.places.truncate(*places);
                Stage::Confirming { keyframes, is_ready: false }
            }
            (Stage::Confirming { .. }, Some(_)) => Stage::Merged,
            (Stage::Trying { places, .. }, None) if *places < self.places.len() => {
                Stage::Trying { places: (2 * places).min(self.places.len()), is_ready: false }
            }
            (Stage::Trying { places, .. }, None) if !self.by_wholes => {
                self.by_wholes = true;
                Stage::Trying { places: *places, is_ready: false }
            }
            _ => return self.abandon(),
        };
    }

    /// Looks no further at parts of the maps.
    pub fn abandon(&mut self) {
        self.vain.extend(self.places.drain(..));
        self.stage = Stage::Apart;
    }

    /// They met by all that is here.
    pub fn mark_merged(&mut self) {
        self.stage = Stage::Merged;
    }

    /// Whether all is here that is to be merged.
    pub fn is_ready(&self) -> bool {
        matches!(self.stage, Stage::Trying { is_ready: true, .. } | Stage::Confirming { is_ready: true, .. })
    }

    /// Whether they met by parts of the maps, and more of them is to be looked at.
    pub fn is_confirming(&self) -> bool {
        matches!(self.stage, Stage::Confirming { .. })
    }

    /// How urgent it is: what was not looked at yet, then the likeliest.
    pub fn urgency(&self) -> (bool, f32) {
        (self.stage == Stage::New, self.similarity)
    }

    /// Whether more of the maps is to be looked at before anything is said.
    pub fn is_pending(&self) -> bool {
        matches!(self.stage, Stage::Choosing | Stage::Trying { .. } | Stage::Confirming { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use place_recog::WordBag;
    use std::time::Duration;

    #[test]
    fn a_pair_is_left_to_another_one_for_three_minutes_and_anew_once_its_agent_comes_back() {
        let (start, mut pair) = (Instant::now(), Pair::default());
        let at = |seconds: u64| start + Duration::from_secs(seconds);
        assert!(pair.leave(at(0)) && pair.leave(at(179)) && !pair.leave(at(180)));
        pair.take_back();
        assert!(pair.leave(at(200)) && pair.leave(at(379)) && !pair.leave(at(380)));
    }

    fn place(number: u32) -> Place {
        [KeyframeId(number), KeyframeId(100 + number)]
    }

    #[test]
    fn a_pair_is_given_up_after_all_places_by_parts_and_by_what_is_here_as_a_whole() {
        let stage = Stage::Trying { places: 1, is_ready: true };
        let mut pair = Pair { places: (0..3).map(place).collect(), stage, ..Pair::default() };
        for (places, by_wholes) in [(2, false), (3, false), (3, true)] {
            pair.record_outcome(None);
            assert!(pair.stage == Stage::Trying { places, is_ready: false } && pair.by_wholes == by_wholes);
        }
        pair.record_outcome(None);
        assert!(pair.stage == Stage::Apart && pair.vain.len() == 3 && !pair.is_pending());
    }

    #[test]
    fn who_met_by_wholes_is_looked_at_by_wholes_until_it_is_decided() {
        let stage = Stage::Trying { places: 1, is_ready: true };
        let mut pair =
            Pair { places: vec![place(0)], by_wholes: true, wholes: [true, false], stage, ..Pair::default() };
        pair.record_outcome(Some([vec![KeyframeId(5)], vec![KeyframeId(105)]]));
        let (mut here, mut remote) = (KnownMap::default(), KnownMap::default());
        for number in 0..9 {
            here.words.insert(KeyframeId(number), WordBag::default());
            remote.words.insert(KeyframeId(100 + number), WordBag::default());
        }
        let [all, some] = pair.keyframes([&here, &remote]);
        assert_eq!(all, (0..9).map(KeyframeId).collect::<Vec<_>>());
        // Three adjacent ones around the first, without which nothing can be looked at.
        assert_eq!(some, [100, 101, 102, 105].map(KeyframeId));
        pair.record_outcome(None);
        assert!(pair.stage == Stage::Apart);
    }
}
