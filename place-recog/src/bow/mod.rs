//! Bag of words: keyframes found by the words that they share with the query.
//!
//! Words are weighted by count and rarity (tf-idf, Sivic & Zisserman 2003); two images are compared by the L1
//! distance of their normalised weights (Nistér & Stewénius, CVPR 2006), which becomes
//! `score = 1 − ½ ‖v/|v| − w/|w|‖ = Σ min(vᵢ, wᵢ)`, 0 for nothing in common, 1 for the same words.
//!
//! **Cost.** An inverted file grows with the map: each word's list of keyframes gets longer. The lists are
//! therefore read from the shortest on, which tells most, and only up to `max_postings` entries in all; the best
//! keyframes by then are scored in full from their own words. While all lists together are shorter than that,
//! the result is that of comparing with every keyframe.

mod inverted;
#[cfg(test)]
mod tests;

use crate::features::Features;
use crate::vocabulary::{Vocabulary, WordBag, WordId};
use inverted::InvertedFile;
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parameters of the bag-of-words index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BowParams {
    /// Most entries of the inverted file that a query reads. Default 200,000, about 1 ms; at least 1. A map's
    /// results are exact up to about 2,000 keyframes of 1000 words; fewer entries make queries in larger maps
    /// faster and may miss keyframes that share only common words with the query.
    pub max_postings: usize,
    /// How many keyframes are scored in full, per one asked for, when the entries were not all read. Default
    /// 20; at least 1.
    pub rescored_per_result: usize,
    /// Least score of a candidate, 0…1. Default 0.01; lower returns more candidates by chance.
    pub min_score: f32,
}

impl Default for BowParams {
    fn default() -> Self {
        Self { max_postings: 200_000, rescored_per_result: 20, min_score: 0.01 }
    }
}

/// Words with tf-idf weights that sum to 1, in order of the words.
pub(crate) type WeightedWords = Vec<(WordId, f32)>;

/// Index of keyframes by the words that they show.
///
/// The same keyframes in the same order give the same results on any machine; equal scores are in the order in
/// which the keyframes came.
#[derive(Clone, Debug)]
pub struct BowIndex {
    vocabulary: Arc<Vocabulary>,
    params: BowParams,
    /// Keyframe and words by slot; slots are given in order of arrival.
    slots: Vec<(KeyframeId, WeightedWords)>,
    slot_of: BTreeMap<KeyframeId, u32>,
    inverted: InvertedFile,
}

impl BowIndex {
    /// An empty index over the words of `vocabulary`.
    pub fn new(vocabulary: Arc<Vocabulary>, params: BowParams) -> Self {
        let inverted = InvertedFile::new(vocabulary.len());
        Self { vocabulary, params, slots: Vec::new(), slot_of: BTreeMap::new(), inverted }
    }

    /// The number of keyframes in it.
    pub fn len(&self) -> usize {
        self.slot_of.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.slot_of.is_empty()
    }

    /// The vocabulary whose words it uses.
    pub fn vocabulary(&self) -> &Arc<Vocabulary> {
        &self.vocabulary
    }

    /// Memory of the keyframes, bytes, without the vocabulary.
    pub fn bytes(&self) -> usize {
        let words: usize =
            self.slots.iter().map(|(_, words)| words.capacity() * size_of::<(WordId, f32)>()).sum();
        words
            + self.slots.capacity() * size_of::<(KeyframeId, WeightedWords)>()
            + self.slot_of.len() * size_of::<(KeyframeId, u32)>()
            + self.inverted.bytes()
    }

    /// The tf-idf weights of a bag, divided by their sum; empty when no word has a weight.
    fn weighted(&self, bag: &WordBag) -> WeightedWords {
        let weight = |&(word, count): &(WordId, u32)| (word, count as f32 * self.vocabulary.weight(word));
        let mut weighted: WeightedWords = bag.counts().iter().map(weight).filter(|&(_, w)| w > 0.0).collect();
        let sum: f32 = weighted.iter().map(|&(_, w)| w).sum();
        weighted.iter_mut().for_each(|(_, w)| *w /= sum);
        weighted
    }

    /// The best `count` slots with scores under `admissible`, best first.
    fn ranked(
        &self,
        query: &WeightedWords,
        count: usize,
        admissible: impl Fn(u32) -> bool,
    ) -> Vec<(f32, u32)> {
        let (scores, complete) = self.inverted.scores(query, self.slots.len(), self.params.max_postings);
        let scored = scores.iter().zip(0u32..).filter(|&(&score, slot)| score > 0.0 && admissible(slot));
        let mut ranked: Vec<(f32, u32)> = scored.map(|(&score, slot)| (score, slot)).collect();
        if complete {
            best(&mut ranked, count);
        } else {
            best(&mut ranked, count.saturating_mul(self.params.rescored_per_result.max(1)));
            for (score, slot) in &mut ranked {
                *score = similarity(query, &self.slots[*slot as usize].1);
            }
            best(&mut ranked, count);
        }
        ranked.retain(|&(score, _)| score >= self.params.min_score);
        ranked
    }
}

impl PlaceIndex<WordBag> for BowIndex {
    fn clear(&mut self) {
        *self = Self::new(Arc::clone(&self.vocabulary), self.params.clone());
    }

    /// Adds a keyframe, or replaces its words. One without words is never found.
    fn add(&mut self, keyframe: KeyframeId, bag: &WordBag) {
        let words = self.weighted(bag);
        let slot = match self.slot_of.get(&keyframe) {
            Some(&slot) => {
                self.inverted.remove(slot, &self.slots[slot as usize].1);
                slot
            }
            None => self.slots.len() as u32,
        };
        self.inverted.add(slot, &words);
        if self.slot_of.insert(keyframe, slot).is_some() {
            self.slots[slot as usize].1 = words;
        } else {
            self.slots.push((keyframe, words));
        }
    }

    fn query_among(
        &self,
        bag: &WordBag,
        count: usize,
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Vec<PlaceCandidate> {
        let ranked = self.ranked(&self.weighted(bag), count, |slot| admissible(self.slots[slot as usize].0));
        let candidate =
            |(score, slot): (f32, u32)| PlaceCandidate { keyframe: self.slots[slot as usize].0, score };
        ranked.into_iter().map(candidate).collect()
    }
}

impl PlaceIndex<Features> for BowIndex {
    fn clear(&mut self) {
        PlaceIndex::<WordBag>::clear(self);
    }

    fn add(&mut self, keyframe: KeyframeId, features: &Features) {
        let bag = self.vocabulary.words(features);
        self.add(keyframe, &bag);
    }

    fn query_among(
        &self,
        features: &Features,
        count: usize,
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Vec<PlaceCandidate> {
        self.query_among(&self.vocabulary.words(features), count, admissible)
    }
}

/// Keeps the `count` highest scores, highest first; of equal ones the first slot.
fn best(ranked: &mut Vec<(f32, u32)>, count: usize) {
    let order = |a: &(f32, u32), b: &(f32, u32)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
    if count < ranked.len() {
        if count > 0 {
            ranked.select_nth_unstable_by(count - 1, order);
        }
        ranked.truncate(count);
    }
    ranked.sort_unstable_by(order);
}

/// Σ min of two lists of weights: 1 − ½ of their L1 distance when each sums to 1.
fn similarity(a: &WeightedWords, b: &WeightedWords) -> f32 {
    let (mut i, mut j, mut sum) = (0, 0, 0.0);
    while let (Some(&(word_a, weight_a)), Some(&(word_b, weight_b))) = (a.get(i), b.get(j)) {
        if word_a == word_b {
            sum += weight_a.min(weight_b);
        }
        i += usize::from(word_a <= word_b);
        j += usize::from(word_b <= word_a);
    }
    sum
}
