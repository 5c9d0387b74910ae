//! The inverted file: of each word the keyframes that show it.

use super::WeightedWords;

/// A keyframe that shows a word, and the word's weight in it.
#[derive(Clone, Copy, Debug)]
struct Posting {
    slot: u32,
    weight: f32,
}

#[derive(Clone, Debug)]
pub struct InvertedFile {
    lists: Vec<Vec<Posting>>,
}

impl InvertedFile {
    pub fn new(words: usize) -> Self {
        Self { lists: vec![Vec::new(); words] }
    }

    pub fn add(&mut self, slot: u32, words: &WeightedWords) {
        for &(word, weight) in words {
            self.lists[word.0 as usize].push(Posting { slot, weight });
        }
    }

    pub fn remove(&mut self, slot: u32, words: &WeightedWords) {
        for &(word, _) in words {
            self.lists[word.0 as usize].retain(|posting| posting.slot != slot);
        }
    }

    /// Scores of `slots` slots against a query, and whether all lists were read: the shortest first, whole
    /// lists, at most `max_postings` entries, but always one list.
    pub fn scores(&self, query: &WeightedWords, slots: usize, max_postings: usize) -> (Vec<f32>, bool) {
        let mut order: Vec<usize> = (0..query.len()).collect();
        let length = |i: usize| self.lists[query[i].0.0 as usize].len();
        order.sort_by_key(|&i| length(i));
        let mut scores = vec![0.0; slots];
        let mut read = 0;
        for i in order {
            if read > 0 && read + length(i) > max_postings {
                return (scores, false);
            }
            read += length(i);
            let (word, weight) = query[i];
            for posting in &self.lists[word.0 as usize] {
                scores[posting.slot as usize] += weight.min(posting.weight);
            }
        }
        (scores, true)
    }

    /// Memory of the lists, bytes.
    pub fn bytes(&self) -> usize {
        self.lists.iter().map(|list| list.capacity() * size_of::<Posting>()).sum()
    }
}
