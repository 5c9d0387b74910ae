//! The inverted file: of each word the keyframes of which it is one of the most telling.

use crate::vocabulary::WordId;

#[derive(Clone, Debug)]
pub struct InvertedFile {
    lists: Vec<Vec<u32>>,
}

/// Slots with the votes they got, those of most votes first, of equals the first slot first.
pub struct Votes(Vec<u32>);

impl InvertedFile {
    pub fn new(words: usize) -> Self {
        Self { lists: vec![Vec::new(); words] }
    }

    pub fn add(&mut self, slot: u32, words: &[(WordId, f32)]) {
        words.iter().for_each(|(word, _)| self.lists[word.0 as usize].push(slot));
    }

    pub fn remove(&mut self, slot: u32, words: &[(WordId, f32)]) {
        words.iter().for_each(|(word, _)| self.lists[word.0 as usize].retain(|other| *other != slot));
    }

    /// Votes of a query's most telling words for the slots listed under them: the rarer a word is here, the more it counts
    /// (`ln(slots / listed)`, as inverse document frequency). The shortest lists are read first, whole lists, at most
    /// `max_postings` entries, but always one list.
    pub fn votes(&self, query: &[(WordId, f32)], slots: usize, max_postings: usize) -> Votes {
        let list = |word: WordId| &self.lists[word.0 as usize];
        let words = query.iter().map(|(word, _)| *word);
        let mut order: Vec<WordId> = words.filter(|word| !list(*word).is_empty()).collect();
        order.sort_by_key(|word| (list(*word).len(), *word));
        let (mut votes, mut touched, mut read) = (vec![0u16; slots], Vec::new(), 0);
        for word in order {
            let list = list(word);
            if read > 0 && read + list.len() > max_postings {
                break;
            }
            read += list.len();
            let vote = (STEPS * (slots as f32 / list.len() as f32).ln()) as u16 + 1;
            for &slot in list {
                let of_slot = &mut votes[slot as usize];
                if *of_slot == 0 {
                    touched.push(slot);
                }
                *of_slot = (*of_slot + vote).min(MOST);
            }
        }
        Votes::sorted(&votes, touched)
    }

    /// Memory of the lists, bytes.
    pub fn bytes(&self) -> usize {
        self.lists.capacity() * size_of::<Vec<u32>>()
            + self.lists.iter().map(|list| list.capacity() * size_of::<u32>()).sum::<usize>()
    }
}

/// Steps of a vote.
const STEPS: f32 = 8.0;
/// The most votes that are told apart; a vote more is still a number.
const MOST: u16 = 8191;

impl Votes {
    /// A counting sort: what a query costs is what it reads.
    fn sorted(votes: &[u16], mut touched: Vec<u32>) -> Self {
        touched.sort_unstable();
        let of = |slot: &u32| usize::from(MOST - votes[*slot as usize]);
        let mut starts = vec![0u32; usize::from(MOST) + 2];
        touched.iter().for_each(|slot| starts[of(slot) + 1] += 1);
        (1..starts.len()).for_each(|at| starts[at] += starts[at - 1]);
        let mut sorted = vec![0; touched.len()];
        for slot in touched {
            let at = &mut starts[of(&slot)];
            sorted[*at as usize] = slot;
            *at += 1;
        }
        Self(sorted)
    }

    /// The slots.
    pub fn slots(&self) -> impl Iterator<Item = u32> + '_ {
        self.0.iter().copied()
    }
}
