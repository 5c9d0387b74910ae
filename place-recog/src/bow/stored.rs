//! The words of a keyframe in a kilobyte: a byte for the distance of each from the one before, and the counts of the few
//! that occur more than once.

use crate::vocabulary::{WordBag, WordId};

/// The largest distance that a byte holds; this byte says that the next word is so much farther.
const FAR: u8 = u8::MAX;

/// Words with their counts, ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StoredWords {
    distances: Box<[u8]>,
    /// Of words that occur more than once: the word and how often.
    repeated: Box<[(WordId, u32)]>,
}

impl StoredWords {
    /// Of a bag.
    pub fn new(bag: &WordBag) -> Self {
        let (mut distances, mut before) = (Vec::with_capacity(bag.counts().len()), 0);
        for &(word, _) in bag.counts() {
            let distance = word.0 - before;
            distances.extend((0..distance / u32::from(FAR)).map(|_| FAR));
            distances.push((distance % u32::from(FAR)) as u8);
            before = word.0;
        }
        let repeated = bag.counts().iter().copied().filter(|&(_, count)| count > 1).collect();
        Self { distances: distances.into(), repeated }
    }

    /// The words, each once.
    pub fn words(&self) -> impl Iterator<Item = WordId> + '_ {
        let mut word = 0;
        self.distances.iter().filter_map(move |&distance| {
            word += u32::from(distance);
            (distance != FAR).then_some(WordId(word))
        })
    }

    /// The words that occur more than once, and how often.
    pub fn repeated(&self) -> &[(WordId, u32)] {
        &self.repeated
    }

    /// The words and their counts.
    pub fn iter(&self) -> impl Iterator<Item = (WordId, u32)> + '_ {
        let count = |word| self.repeated.binary_search_by_key(&word, |entry| entry.0);
        self.words().map(move |word| (word, count(word).map_or(1, |at| self.repeated[at].1)))
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        self.distances.len() + size_of_val(&*self.repeated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_come_back_as_they_were() {
        let bag = WordBag::new([0, 1, 1, 130, 255, 510, 28_560, 28_560, 28_560].map(WordId));
        let stored = StoredWords::new(&bag);
        assert_eq!(stored.iter().collect::<Vec<_>>(), bag.counts());
        assert_eq!(stored.repeated(), [(WordId(1), 2), (WordId(28_560), 3)]);
        assert_eq!(StoredWords::default().iter().next(), None);
    }
}
