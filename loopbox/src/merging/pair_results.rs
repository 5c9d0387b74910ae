//! What all pairs of a merge made of each other. Among a thousand maps they are half a million, and of most of them nothing is asked until
//! the results are written. So the places that were tried rest outside memory, and come back a pair at a time.

use super::PairResult;
use geometry::{Swap, Swapped};
use merge::further::Joined;
use merge::verification::TestedPlace;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Bytes that are given out of memory at a time.
const CHUNK: usize = 1 << 20;

/// What pairs of maps made of each other, in the order of all pairs: the later input, then the earlier.
#[derive(Clone, Default)]
pub struct PairResults {
    /// By the later of the two inputs and the earlier.
    pairs: BTreeMap<[usize; 2], Kept>,
    /// Where tested places rest; nothing where they stay in memory.
    shelf: Option<Shelf>,
}

/// A pair.
#[derive(Clone)]
struct Kept {
    /// Without the places that were tested, where these rest.
    pair_result: PairResult,
    resting: Option<Piece>,
}

impl PairResults {
    /// None yet, whose tested places will rest there.
    pub(crate) fn resting(swap: Arc<dyn Swap>) -> Self {
        Self { pairs: BTreeMap::new(), shelf: Some(Shelf { swap, full: Vec::new(), open: Vec::new() }) }
    }

    /// Takes in what two maps made of each other, in place of what was known of them.
    pub(crate) fn insert(&mut self, mut pair_result: PairResult) {
        let resting = self.shelf.as_mut().and_then(|shelf| shelf.keep(&pair_result.tested));
        if resting.is_some() {
            pair_result.tested = Arc::default();
        }
        self.pairs.insert(place(pair_result.as_given()), Kept { pair_result, resting });
    }

    /// How many pairs there are.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// What two inputs made of each other; nothing where that is not known.
    pub fn get(&self, [a, b]: [usize; 2]) -> Option<Cow<'_, PairResult>> {
        self.pairs.get(&place([a.min(b), a.max(b)])).map(|kept| self.whole(kept))
    }

    /// All, in their order. What rests is read for each when it comes, and given up with it.
    pub fn iter(&self) -> impl Iterator<Item = Cow<'_, PairResult>> {
        self.pairs.values().map(|kept| self.whole(kept))
    }

    /// All pairs, target and source, and what joins them; nothing of those that are not joined. Nothing is read for it.
    pub(crate) fn links(&self) -> impl Iterator<Item = ([usize; 2], Option<&Joined>)> {
        let pair_results = self.pairs.values().map(|kept| &kept.pair_result);
        pair_results.map(|PairResult { target, source, joined, .. }| ([*target, *source], joined.as_deref()))
    }

    /// Those that are joined.
    pub(crate) fn joined(&self) -> impl Iterator<Item = ([usize; 2], &Joined)> {
        self.links().filter_map(|(pair, joined)| Some((pair, joined?)))
    }

    /// Seconds that all took. Nothing is read for it.
    pub(super) fn seconds(&self) -> f64 {
        self.pairs.values().map(|kept| kept.pair_result.seconds.total()).sum()
    }

    fn whole<'a>(&'a self, kept: &'a Kept) -> Cow<'a, PairResult> {
        let tested = kept.resting.as_ref().and_then(|piece| self.shelf.as_ref()?.read(piece));
        match tested {
            Some(tested) => Cow::Owned(PairResult { tested: tested.into(), ..kept.pair_result.clone() }),
            None => Cow::Borrowed(&kept.pair_result),
        }
    }
}

impl FromIterator<PairResult> for PairResults {
    /// Those in memory.
    fn from_iter<T: IntoIterator<Item = PairResult>>(pairs: T) -> Self {
        let mut all = Self::default();
        pairs.into_iter().for_each(|pair_result| all.insert(pair_result));
        all
    }
}

/// Where a pair of inputs, the earlier first, stands in the order.
fn place([earlier, later]: [usize; 2]) -> [usize; 2] {
    [later, earlier]
}

/// Bytes that are written once and read in pieces.
#[derive(Clone)]
struct Shelf {
    swap: Arc<dyn Swap>,
    full: Vec<Chunk>,
    /// The chunk after these, which is being filled.
    open: Vec<u8>,
}

#[derive(Clone)]
enum Chunk {
    Swapped(Arc<dyn Swapped>),
    /// There was no room for it elsewhere, or it is among what may stay in memory.
    InMemory(Arc<[u8]>),
}

/// A part of a chunk, which it does not reach beyond.
#[derive(Clone, Copy)]
struct Piece {
    chunk: u32,
    start: u32,
    len: u32,
}

impl Shelf {
    /// Puts tested places; nothing where they stay where they are, since they are none or would come back otherwise.
    fn keep(&mut self, tested: &[TestedPlace]) -> Option<Piece> {
        let bytes = rmp_serde::to_vec(tested).ok().filter(|_| !tested.is_empty())?;
        rmp_serde::from_slice::<Vec<TestedPlace>>(&bytes).ok().filter(|back| *back == tested)?;
        if !self.open.is_empty() && self.open.len() + bytes.len() > CHUNK {
            self.close();
        }
        let (chunk, start) = (self.full.len().try_into().ok()?, self.open.len().try_into().ok()?);
        let piece = Piece { chunk, start, len: bytes.len().try_into().ok()? };
        self.open.extend(bytes);
        Some(piece)
    }

    /// Gives the chunk that is being filled out of memory.
    fn close(&mut self) {
        let bytes = std::mem::take(&mut self.open);
        let chunk = self.swap.keep(&bytes).map_or_else(|| Chunk::InMemory(bytes.into()), Chunk::Swapped);
        chunk.rest();
        self.full.push(chunk);
    }

    /// The places of a piece; nothing where it is not among these.
    fn read(&self, piece: &Piece) -> Option<Vec<TestedPlace>> {
        let start = piece.start as usize;
        let range = start..start + piece.len as usize;
        let Some(chunk) = self.full.get(piece.chunk as usize) else {
            return rmp_serde::from_slice(self.open.get(range)?).ok();
        };
        let tested = rmp_serde::from_slice(chunk.bytes().get(range)?).ok();
        chunk.rest();
        tested
    }
}

impl Chunk {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Swapped(bytes) => bytes.bytes(),
            Self::InMemory(bytes) => bytes,
        }
    }

    /// Gives its memory back, where it is elsewhere too.
    fn rest(&self) {
        if let Self::Swapped(bytes) = self {
            bytes.rest();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merging::Seconds;
    use crate::swapping::SwapFiles;
    use map::KeyframeId;
    use merge::two_view::TwoViewRefusal;
    use merge::verification::{Outcome, Place};

    /// Two maps of which no place fits.
    fn strangers([target, source]: [usize; 2], places: usize) -> PairResult {
        let tested = |number: usize| {
            let id = KeyframeId(number as u32);
            let refusal = TwoViewRefusal::TooFewMatches { given: target + number, needed: 16 };
            let place = Place { source: id, target: id };
            TestedPlace { place, matched: number, match_count: 0, outcome: Outcome::NotMatched(refusal) }
        };
        let seconds = Seconds { places: 0.25, ..Seconds::default() };
        let (joined, error, seen) = Default::default();
        let tested = (0..places).map(tested).collect();
        PairResult { target, source, proposed: source, tested, joined, error, seconds, seen }
    }

    /// What pairs that are not joined hold.
    fn contents(pair_results: &PairResults) -> Vec<([usize; 2], usize, Vec<TestedPlace>)> {
        pair_results.iter().map(|one| ([one.target, one.source], one.proposed, one.tested.to_vec())).collect()
    }

    #[test]
    fn what_rests_on_the_disk_comes_back_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let swap = Arc::new(SwapFiles::beyond(folder.path().to_owned(), 0));
        let all = || {
            (0..80).flat_map(|a| (0..a).map(move |b| strangers(if a % 2 == 0 { [a, b] } else { [b, a] }, 24)))
        };
        let in_memory: PairResults = all().collect();
        let mut resting = PairResults::resting(Arc::clone(&swap) as Arc<dyn Swap>);
        // Whichever comes first.
        let (odd, even): (Vec<_>, Vec<_>) = all().partition(|one| one.source % 2 == 1);
        odd.into_iter().chain(even).for_each(|one| resting.insert(one));
        assert!(swap.on_disk() > 0, "nothing is on the disk");
        assert!(resting.pairs.values().all(|kept| kept.pair_result.tested.is_empty()), "it is in memory too");
        assert_eq!(resting.len(), 80 * 79 / 2);
        assert!(contents(&resting) == contents(&in_memory));
        assert_eq!(resting.seconds(), in_memory.seconds());
        // In place of what was known.
        resting.insert(strangers([7, 3], 2));
        assert_eq!(resting.get([3, 7]).unwrap().tested.len(), 2);
        assert_eq!((resting.len(), resting.get([3, 80]).is_none()), (80 * 79 / 2, true));
    }

    #[test]
    fn without_a_disk_it_stays_in_memory() {
        let mut kept = PairResults::resting(Arc::new(SwapFiles::beyond("/nonexistent".into(), 0)));
        (1..2000).for_each(|other| kept.insert(strangers([0, other], 40)));
        assert!(kept.shelf.as_ref().is_some_and(|shelf| !shelf.full.is_empty()), "no chunk is full");
        assert!(kept.iter().all(|one| one.tested.len() == 40 && one.tested[39].matched == 39));
    }
}
