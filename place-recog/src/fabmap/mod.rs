//! FAB-MAP: the probability that an image shows a place of the map, or a new one.
//!
//! Cummins & Newman, "FAB-MAP: Probabilistic Localization and Mapping in the Space of Appearance" (IJRR 2008) and
//! "Appearance-only SLAM at Large Scale with FAB-MAP 2.0" (IJRR 2011). An image is the set of words z that it
//! shows. Words occur together: the Chow–Liu tree of the training images makes each depend on one parent. A
//! place is a set of things e that make words, seen with a detector that misses and errs; what one image told of
//! them is `p(e | place)`. All symbols are those of the first paper:
//!
//! - §4.3: `p(z | place) = Π p(z_q | z_parent, place)`, each factor a sum over e_q;
//! - mean field: a new place is one with the average of things, `p(e_q)` as in training;
//! - §4.4: the posterior over all places and the new one, with a prior for the new one.
//!
//! **What is different.** Words of real images depend on each other by more than a tree, so the likelihoods are
//! too sure of themselves; they are raised to the power `evidence` before they are compared. The average place
//! is one that showed as many words as the place it is compared with: a dim or blurred image shows few words,
//! and would otherwise seem to fit every dim or blurred place better than a new one. The places that are
//! looked at in full are the `shortlist` best by bag of words: each other one counts as an average place, so that
//! the cost of a query does not grow with the map.

mod model;
#[cfg(test)]
mod tests;

use crate::bow::{BowIndex, BowParams};
use crate::vocabulary::{Vocabulary, WordBag, WordId};
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use model::{Model, Observed};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parameters of FAB-MAP.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FabMapParams {
    /// `p(z = 1 | e = 1)`: how often a word is found where the thing is. Default 0.39 (Cummins & Newman 2008),
    /// between `false_detection` and 1. Higher takes more from words that are missing.
    pub detection: f64,
    /// `p(z = 1 | e = 0)`: how often a word is found without the thing. Default 0.1, which recognises most on our
    /// sequences: descriptors fall into neighbouring words by chance (0.005 finds a tenth less); 0 to `detection`.
    /// Higher takes less from words that are there.
    pub false_detection: f64,
    /// Prior probability that the query shows a new place. Default 0.9; inside 0 to 1. Higher finds fewer places and
    /// fewer wrong ones.
    pub new_place: f64,
    /// Power of the likelihoods. Default 0.1; above 0 to 1. Lower trusts the independence of words less and gives
    /// probabilities further from 0 and 1.
    pub evidence: f64,
    /// Places looked at in full. Default 100; at least 1. More cost about 3 µs each.
    pub shortlist: usize,
}

impl Default for FabMapParams {
    fn default() -> Self {
        Self { detection: 0.39, false_detection: 0.1, new_place: 0.9, evidence: 0.1, shortlist: 100 }
    }
}

/// Where an image may have been taken; the probabilities sum to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Location {
    /// Probability of a place that is not in the index.
    pub new_place: f64,
    /// Probability of all places of the index that were not looked at in full.
    pub elsewhere: f64,
    /// Probability of each place that was, highest first.
    pub places: Vec<(KeyframeId, f64)>,
}

/// Index of keyframes by the probability that they show the place of the query.
///
/// As a [`PlaceIndex`] it returns that probability as the score.
#[derive(Clone, Debug)]
pub struct FabMap {
    params: FabMapParams,
    model: Arc<Model>,
    /// Finds the shortlist.
    nearest: BowIndex,
    words: BTreeMap<KeyframeId, Vec<WordId>>,
}

impl FabMap {
    /// An empty index; what words depend on each other comes with the vocabulary.
    pub fn new(vocabulary: Arc<Vocabulary>, params: FabMapParams) -> Self {
        let model = Arc::new(Model::new(&vocabulary, &params));
        let nearest = BowIndex::new(vocabulary, BowParams { min_score: 0.0, ..BowParams::default() });
        Self { params, model, nearest, words: BTreeMap::new() }
    }

    /// Where an image with these words may have been taken, if only places for which `admissible` holds are known.
    pub fn locate(&self, bag: &WordBag, admissible: &dyn Fn(KeyframeId) -> bool) -> Location {
        let shortlist = self.nearest.query_among(bag, self.params.shortlist.max(1), admissible);
        self.weigh(bag, &shortlist, admissible)
    }

    /// The same with this shortlist.
    fn weigh(
        &self,
        bag: &WordBag,
        shortlist: &[PlaceCandidate],
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Location {
        let known = self.words.keys().filter(|&&id| admissible(id)).count();
        let seen: Vec<WordId> = bag.counts().iter().map(|&(word, _)| word).collect();
        let query = Observed::new(&self.model, &seen);
        let new_place = self.params.new_place.clamp(1e-12, 1.0 - 1e-12);
        if known == 0 {
            return Location { new_place: 1.0, elsewhere: 0.0, places: Vec::new() };
        }
        // All relative to the likelihood of an average place, and in logarithms.
        let prior = ((1.0 - new_place) / known as f64).ln();
        let mut places: Vec<(KeyframeId, f64)> = shortlist
            .iter()
            .filter_map(|candidate| Some((candidate.keyframe, self.words.get(&candidate.keyframe)?)))
            .map(|(id, words)| (id, prior + self.params.evidence * query.log_ratio(&self.model, words)))
            .collect();
        places.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let others = (known - places.len()) as f64 * prior.exp();
        let top = places.first().map_or(0.0, |place| place.1.max(0.0));
        let (base, elsewhere) = (new_place * (-top).exp(), others * (-top).exp());
        places.iter_mut().for_each(|(_, p)| *p = (*p - top).exp());
        let sum = base + elsewhere + places.iter().map(|place| place.1).sum::<f64>();
        places.iter_mut().for_each(|(_, p)| *p /= sum);
        Location { new_place: base / sum, elsewhere: elsewhere / sum, places }
    }
}

impl PlaceIndex<WordBag> for FabMap {
    fn clear(&mut self) {
        PlaceIndex::<WordBag>::clear(&mut self.nearest);
        self.words.clear();
    }

    fn add(&mut self, keyframe: KeyframeId, bag: &WordBag) {
        self.words.insert(keyframe, bag.counts().iter().map(|&(word, _)| word).collect());
        self.nearest.add(keyframe, bag);
    }

    fn query_among(
        &self,
        bag: &WordBag,
        count: usize,
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Vec<PlaceCandidate> {
        let candidate = |(keyframe, probability)| PlaceCandidate { keyframe, score: probability as f32 };
        self.locate(bag, admissible).places.into_iter().take(count).map(candidate).collect()
    }

    /// Each group has its share of the shortlist.
    fn query_each(
        &self,
        bag: &WordBag,
        count: usize,
        groups: usize,
        group: &dyn Fn(KeyframeId) -> Option<usize>,
    ) -> Vec<PlaceCandidate> {
        let share = self.params.shortlist.div_ceil(groups.max(1)).max(count);
        let shortlist = self.nearest.query_each(bag, share, groups, group);
        let location = self.weigh(bag, &shortlist, &|id| group(id).is_some());
        let mut taken = vec![0; groups];
        let fits = |&(id, _): &(KeyframeId, f64)| {
            let taken = group(id).and_then(|group| taken.get_mut(group));
            taken.is_some_and(|taken| {
                *taken += 1;
                *taken <= count
            })
        };
        let candidate = |(keyframe, probability)| PlaceCandidate { keyframe, score: probability as f32 };
        location.places.into_iter().filter(fits).map(candidate).collect()
    }
}
