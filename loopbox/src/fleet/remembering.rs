//! What pairs of cameras' maps made of each other, kept as long as neither changed: a map that changes is compared with all others
//! again, and they are not with each other. What pairs made of each other before they changed is kept as well, as only what is new of
//! them is asked then; those of LiDARs, of which that is not so, are kept as [`verdicts`](crate::verdicts).

use crate::merging::{Known, PairResult, Places};
use fleet::hash::ObjectHash;
use map::Identity;
use std::borrow::Borrow;
use std::collections::{BTreeMap, BTreeSet};

/// A map among others, by whose it is and what it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Content {
    /// Whose.
    pub agent: Identity,
    /// Stands for all of it that merging looks at.
    pub hash: ObjectHash,
}

/// What is known of pairs.
#[derive(Default)]
pub(super) struct Memory {
    pairs: BTreeMap<[Identity; 2], Remembered>,
    /// Places that two maps may share, of pairs that are still to be looked at, by target and source.
    places: Vec<([Content; 2], Places)>,
}

struct Remembered {
    /// Of the target and the source.
    contents: [Content; 2],
    pair_result: PairResult,
}

impl Memory {
    /// What two of these maps made of each other. It is due again where one of them is not as it was; as long as maps still
    /// come it does not matter whether all of them was looked at since they met; `exactly` all of them has to be where the result is
    /// to last. Which other maps there were then says nothing of a pair.
    pub fn recall(&self, maps: &[Content], [a, b]: [usize; 2], exactly: bool) -> Option<Known> {
        let remembered = self.pairs.get(&key(maps[a], maps[b]))?;
        let is_source_first = remembered.contents[1].agent == maps[a].agent;
        let [target, source] = if is_source_first { [b, a] } else { [a, b] };
        let is_same = remembered.contents == [maps[target], maps[source]];
        let is_grown = remembered.pair_result.seen.as_ref().is_some_and(|seen| seen.is_grown);
        let is_due = !is_same || exactly && is_grown;
        let pair_result = PairResult { target, source, ..remembered.pair_result.clone() };
        Some(Known { pair_result, is_due, may_grow: !exactly })
    }

    /// Keeps what pairs of these maps made of each other now, beside what is known of others of them, and nothing of others.
    pub fn keep(&mut self, maps: &[Content], pair_results: impl Iterator<Item: Borrow<PairResult>>) {
        let agents: BTreeSet<Identity> = maps.iter().map(|map| map.agent).collect();
        self.pairs.retain(|pair, _| pair.iter().all(|agent| agents.contains(agent)));
        for pair_result in pair_results {
            let pair_result: &PairResult = pair_result.borrow();
            let contents = [pair_result.target, pair_result.source].map(|map| maps[map]);
            let remembered = Remembered { contents, pair_result: pair_result.clone() };
            self.pairs.insert(key(contents[0], contents[1]), remembered);
        }
    }

    /// Places that these maps may share, by target and source, as far as both are as they were. They are not kept here
    /// any more.
    pub fn remove_places(&mut self, maps: &[Content]) -> BTreeMap<[usize; 2], Places> {
        let numbers: BTreeMap<Identity, usize> =
            maps.iter().enumerate().map(|(number, map)| (map.agent, number)).collect();
        let number = |content: &Content| {
            let number = *numbers.get(&content.agent)?;
            (maps[number] == *content).then_some(number)
        };
        let known = std::mem::take(&mut self.places).into_iter();
        let of_these = known
            .filter_map(|([target, source], places)| Some(([number(&target)?, number(&source)?], places)));
        of_these.collect()
    }

    /// Keeps places that these maps may share.
    pub fn keep_places(&mut self, maps: &[Content], places: BTreeMap<[usize; 2], Places>) {
        self.places = places.into_iter().map(|(pair, places)| (pair.map(|map| maps[map]), places)).collect();
    }
}

fn key(a: Content, b: Content) -> [Identity; 2] {
    [a.agent.min(b.agent), a.agent.max(b.agent)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use map::Uuid;

    fn content(agent: u128, version: u8) -> Content {
        let agent = Identity { uuid: Uuid::from_u128(agent), epoch: 0 };
        Content { agent, hash: ObjectHash::of(&[version]) }
    }

    fn pair_result(target: usize, source: usize) -> PairResult {
        let (tested, joined, error, seconds, seen) = Default::default();
        PairResult { target, source, proposed: 10 * target + source, tested, joined, error, seconds, seen }
    }

    fn is_due(memory: &Memory, maps: &[Content], pair: [usize; 2], exactly: bool) -> Option<bool> {
        memory.recall(maps, pair, exactly).map(|known| known.is_due)
    }

    #[test]
    fn pairs_of_unchanged_maps_are_known_at_any_index_and_those_of_changed_ones_are_due() {
        let maps = [content(1, 0), content(2, 0), content(3, 0)];
        let mut memory = Memory::default();
        memory.keep(&maps, [pair_result(1, 0), pair_result(0, 2), pair_result(2, 1)].iter());
        // The second changed, and they stand in another order.
        let now = [content(3, 0), content(2, 9), content(1, 0)];
        let known = memory.recall(&now, [0, 2], true).expect("neither changed");
        let Known { pair_result: met, is_due: false, .. } = known else { panic!("neither changed") };
        assert_eq!((met.target, met.source, met.proposed), (2, 0, 2));
        let changed = memory.recall(&now, [0, 1], false).expect("they met before");
        assert!(changed.is_due && is_due(&memory, &now, [0, 1], true) == Some(true));
        assert_eq!(is_due(&memory, &now, [1, 2], false), Some(true));
        assert_eq!([changed.pair_result.target, changed.pair_result.source], [0, 1]);
        // Nothing is kept of one that is not there any more.
        memory.keep(&maps[..2], std::iter::empty::<PairResult>());
        assert_eq!(is_due(&memory, &maps, [0, 2], false), None);
    }

    #[test]
    fn places_are_kept_of_maps_as_they_are() {
        let maps = [content(1, 0), content(2, 0), content(3, 0)];
        let mut memory = Memory::default();
        memory.keep_places(&maps, [[1, 0], [2, 1], [0, 2]].map(|pair| (pair, Places::default())).into());
        let now = [content(3, 0), content(1, 0), content(2, 9)];
        let known: Vec<[usize; 2]> = memory.remove_places(&now).into_keys().collect();
        assert_eq!(known, [[1, 0]]);
    }

    #[test]
    fn a_pair_is_evaluated_anew_for_its_own_changes_and_not_for_other_maps() {
        let maps = [content(1, 0), content(2, 0), content(3, 0)];
        let mut memory = Memory::default();
        memory.keep(&maps[..2], [pair_result(0, 1)].iter());
        let due = |memory: &Memory, exactly: bool| is_due(memory, &maps, [0, 1], exactly);
        assert_eq!((due(&memory, false), due(&memory, true)), (Some(false), Some(false)));
        // One of which only what was new was looked at since is looked at once more before the result is to last.
        let seen = Some(std::sync::Arc::new(crate::merging::Seen { is_grown: true, ..Default::default() }));
        memory.keep(&maps, [PairResult { seen, ..pair_result(1, 2) }].iter());
        let grown = |exactly: bool| memory.recall(&maps, [1, 2], exactly).expect("it is known");
        assert!(!grown(false).is_due && grown(false).may_grow && grown(true).is_due && !grown(true).may_grow);
        memory.keep(&maps, [pair_result(0, 2)].iter());
        assert_eq!((due(&memory, true), is_due(&memory, &maps, [0, 2], true)), (Some(false), Some(false)));
    }
}
