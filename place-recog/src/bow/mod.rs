//! Bag of words: keyframes found by the words that they share with the query.
//!
//! Words are weighted by count and rarity (tf-idf, Sivic & Zisserman 2003); two images are compared by the L1
//! distance of their normalised weights (Nistér & Stewénius, CVPR 2006), which becomes
//! `score = 1 − ½ ‖v/|v| − w/|w|‖ = Σ min(vᵢ, wᵢ)`, 0 for nothing in common, 1 for the same words.
//!
//! **Cost.** Coarse to fine. A keyframe is *listed* under its most telling words only; a query reads the lists of its own
//! most telling words, at most `max_postings` entries, and scores the keyframes that they name most often in full, `scored`
//! of them. So a query costs the same in a map of a thousand keyframes and in one of a million. While there are no more
//! than `scored`, all are, and the result is that of comparing with every keyframe. A keyframe takes as many bytes as its
//! words, stored as gaps.

mod inverted;
mod stored;
#[cfg(test)]
mod tests;

use crate::vocabulary::{Vocabulary, WordBag, WordId};
use inverted::InvertedFile;
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use stored::StoredWords;

/// Parameters of the bag-of-words index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BowParams {
    /// How many of its words a keyframe is listed under, and a query looks up: those of most weight. Default 128; at least 1.
    /// More find keyframes that share less with the query, at four bytes and as many entries read each.
    pub listed: usize,
    /// Most entries of the lists that a query reads. Default 100,000, about 0.5 ms; at least 1. So many are in maps of some hundred
    /// thousand keyframes; fewer make queries there faster and miss more.
    pub max_postings: usize,
    /// How many keyframes are scored in full. Default 512; at least 1. All are in a map that has no more. Each takes some
    /// 2 µs.
    pub scored: usize,
    /// Least score of a candidate, 0…1. Default 0.01; lower returns more candidates by chance.
    pub min_score: f32,
}

impl Default for BowParams {
    fn default() -> Self {
        Self { listed: 128, max_postings: 100_000, scored: 512, min_score: 0.01 }
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
    /// By slot; slots are given in order of arrival.
    slots: Vec<Slot>,
    slot_of: BTreeMap<KeyframeId, u32>,
    inverted: InvertedFile,
}

/// A keyframe in the index.
#[derive(Clone, Debug)]
struct Slot {
    keyframe: KeyframeId,
    /// The sum of its words' weights.
    sum: f32,
    words: StoredWords,
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
        self.slots.iter().map(|slot| slot.words.bytes()).sum::<usize>()
            + self.slots.capacity() * size_of::<Slot>()
            + self.slot_of.len() * size_of::<(KeyframeId, u32)>()
            + self.inverted.bytes()
    }

    /// The tf-idf weights of words, and their sum.
    fn weights(&self, words: impl Iterator<Item = (WordId, u32)>) -> (WeightedWords, f32) {
        let weight = |(word, count): (WordId, u32)| (word, count as f32 * self.vocabulary.weight(word));
        let weighted: WeightedWords = words.map(weight).filter(|&(_, w)| w > 0.0).collect();
        let sum = weighted.iter().map(|&(_, w)| w).sum();
        (weighted, sum)
    }

    /// The tf-idf weights of a bag, divided by their sum; empty when no word has a weight.
    fn weighted(&self, bag: &WordBag) -> WeightedWords {
        let (mut weighted, sum) = self.weights(bag.counts().iter().copied());
        weighted.iter_mut().for_each(|(_, w)| *w /= sum);
        weighted
    }

    /// The words of most weight; of equals the first.
    fn most_informative(&self, mut weighted: WeightedWords) -> WeightedWords {
        let order = |a: &(WordId, f32), b: &(WordId, f32)| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0));
        let count = self.params.listed.max(1);
        if count < weighted.len() {
            weighted.select_nth_unstable_by(count, order);
            weighted.truncate(count);
        }
        weighted
    }

    /// The slots worth scoring in full: all where there are few, else those that the lists name most often, of none of so
    /// many groups more than its share, or twice what is wanted of it.
    fn worth_scoring(
        &self,
        query: &WeightedWords,
        count: usize,
        groups: usize,
        group: &dyn Fn(KeyframeId) -> Option<usize>,
    ) -> Vec<(u32, usize)> {
        let group = |slot: u32| Some((slot, group(self.slots[slot as usize].keyframe)?));
        let most = self.params.scored.max(1);
        if self.slots.len() <= most {
            return (0..self.slots.len() as u32).filter_map(group).collect();
        }
        let votes = self.inverted.votes(
            &self.most_informative(query.clone()),
            self.slots.len(),
            self.params.max_postings,
        );
        let of_each = most.div_ceil(groups.max(1)).max(count.saturating_mul(2));
        let mut taken = vec![0; groups];
        let fits = |&(_, group): &(u32, usize)| {
            taken[group] += 1;
            taken[group] <= of_each
        };
        votes.slots().filter_map(group).filter(fits).take(most.max(count)).collect()
    }

    /// The best `count` keyframes by comparing with every one, best first: what a query finds that is told to score all.
    pub fn query_all(&self, bag: &WordBag, count: usize) -> Vec<PlaceCandidate> {
        let all = (0..self.slots.len() as u32).map(|slot| (slot, 0)).collect();
        self.best(all, &self.weighted(bag), count, 1)
    }

    /// Of slots in groups the best `count` keyframes of each group, best first.
    fn best(
        &self,
        worth: Vec<(u32, usize)>,
        query: &WeightedWords,
        count: usize,
        groups: usize,
    ) -> Vec<PlaceCandidate> {
        // Of each word its weight in the query, and once in any image.
        let mut weights = vec![[0.0; 2]; self.vocabulary.len()];
        for &(word, weight) in query {
            weights[word.0 as usize] = [weight, self.vocabulary.weight(word)];
        }
        let scored = worth.into_iter().map(|(slot, group)| (self.score(slot, &weights), slot, group));
        let mut scored: Vec<(f32, u32, usize)> =
            scored.filter(|&(score, ..)| score > 0.0 && score >= self.params.min_score).collect();
        scored.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut taken = vec![0; groups];
        let fits = |&(_, _, group): &(f32, u32, usize)| {
            taken[group] += 1;
            taken[group] <= count
        };
        let candidate = |(score, slot, _): (f32, u32, usize)| PlaceCandidate {
            keyframe: self.slots[slot as usize].keyframe,
            score,
        };
        scored.into_iter().filter(fits).map(candidate).collect()
    }

    /// Σ min of a keyframe's weights and those of a query, by word: 1 − ½ of their L1 distance when each sums to 1.
    fn score(&self, slot: u32, query: &[[f32; 2]]) -> f32 {
        let Slot { sum, words, .. } = &self.slots[slot as usize];
        let share = |word: WordId, count: u32| {
            let [of_query, once] = query[word.0 as usize];
            // Most words are not the query's, and get nothing.
            of_query.min(count as f32 * once / sum)
        };
        let each_once: f32 = words.words().map(|word| share(word, 1)).sum();
        let more = words.repeated().iter().map(|&(word, count)| share(word, count) - share(word, 1));
        each_once + more.sum::<f32>()
    }
}

impl PlaceIndex<WordBag> for BowIndex {
    fn clear(&mut self) {
        *self = Self::new(Arc::clone(&self.vocabulary), self.params.clone());
    }

    /// Adds a keyframe, or replaces its words. One without words is never found.
    fn add(&mut self, keyframe: KeyframeId, bag: &WordBag) {
        let (weighted, sum) = self.weights(bag.counts().iter().copied());
        let new = Slot { keyframe, sum, words: StoredWords::new(bag) };
        let slot = match self.slot_of.get(&keyframe) {
            Some(&slot) => {
                let before = self.weights(self.slots[slot as usize].words.iter()).0;
                let listed = self.most_informative(before);
                self.inverted.remove(slot, &listed);
                self.slots[slot as usize] = new;
                slot
            }
            None => {
                self.slots.push(new);
                (self.slots.len() - 1) as u32
            }
        };
        let listed = self.most_informative(weighted);
        self.inverted.add(slot, &listed);
        self.slot_of.insert(keyframe, slot);
    }

    fn query_among(
        &self,
        bag: &WordBag,
        count: usize,
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Vec<PlaceCandidate> {
        self.query_each(bag, count, 1, &|id| admissible(id).then_some(0))
    }

    fn query_each(
        &self,
        bag: &WordBag,
        count: usize,
        groups: usize,
        group: &dyn Fn(KeyframeId) -> Option<usize>,
    ) -> Vec<PlaceCandidate> {
        let query = self.weighted(bag);
        self.best(self.worth_scoring(&query, count, groups, group), &query, count, groups)
    }
}
