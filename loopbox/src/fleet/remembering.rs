//! What pairs of maps made of each other, kept as long as neither changed: a map that changes is compared with all others
//! again, and they are not with each other.

use crate::merging::Encounter;
use fleet::hash::ObjectHash;
use map::Identity;
use slam_lidar::merging::verdict::Verdict;
use std::collections::BTreeMap;

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
    pairs: BTreeMap<[Identity; 2], Known>,
}

struct Known {
    /// Of the target and the source.
    contents: [Content; 2],
    /// Maps that were merged then: of more of them more look alike by chance, and each pair is believed less easily.
    among: usize,
    encounter: Encounter,
}

impl Memory {
    /// What two of these maps made of each other, if both are as they were. As long as maps still come it does not
    /// matter how many there were then; `exactly` as many have to be where the result is to last.
    pub fn recall(&self, maps: &[Content], [a, b]: [usize; 2], exactly: bool) -> Option<Encounter> {
        let known = self.pairs.get(&key(maps[a], maps[b]))?;
        let [target, source] = known.holds(maps, [a, b], exactly)?;
        Some(Encounter { target, source, ..known.encounter.clone() })
    }

    /// Keeps what pairs of these maps made of each other, and nothing of others. What was [recalled](Self::recall) of them,
    /// `exactly` or not, stays as it was found.
    pub fn keep(&mut self, maps: &[Content], encounters: &[Encounter], exactly: bool) {
        let mut before = std::mem::take(&mut self.pairs);
        for encounter in encounters {
            let contents = [encounter.target, encounter.source].map(|map| maps[map]);
            let key = key(contents[0], contents[1]);
            let pair = [encounter.target, encounter.source];
            let known = before.remove(&key).filter(|known| known.holds(maps, pair, exactly).is_some());
            let new = || Known { contents, among: maps.len(), encounter: encounter.clone() };
            self.pairs.insert(key, known.unwrap_or_else(new));
        }
    }
}

impl Known {
    /// Which of two of these maps are its target and source, if both are as they were; where it has to be `exactly`, if
    /// there were as many.
    fn holds(&self, maps: &[Content], pair: [usize; 2], exactly: bool) -> Option<[usize; 2]> {
        if exactly && self.among != maps.len() {
            return None;
        }
        let now = |content: &Content| pair.into_iter().find(|&map| maps[map] == *content);
        Some([now(&self.contents[0])?, now(&self.contents[1])?])
    }
}

/// What pairs of LiDAR maps made of each other: unlike cameras' it does not depend on how many maps there are.
#[derive(Default)]
pub(super) struct Verdicts(Vec<([Content; 2], Verdict, f64)>);

impl Verdicts {
    /// What two maps as they are made of each other, in this order, and the seconds it took.
    pub fn recall(&self, pair: [Content; 2]) -> Option<(Verdict, f64)> {
        let known = self.0.iter().find(|(known, ..)| *known == pair);
        known.map(|(_, verdict, seconds)| (verdict.clone(), *seconds))
    }

    /// Keeps what these pairs made of each other, and nothing of others.
    pub fn keep(&mut self, verdicts: impl Iterator<Item = ([Content; 2], Verdict, f64)>) {
        self.0 = verdicts.collect();
    }
}

fn key(a: Content, b: Content) -> [Identity; 2] {
    [a.agent.min(b.agent), a.agent.max(b.agent)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merging::Seconds;
    use map::Uuid;

    fn content(agent: u128, version: u8) -> Content {
        let agent = Identity { uuid: Uuid::from_u128(agent), epoch: 0 };
        Content { agent, hash: ObjectHash::of(&[version]) }
    }

    fn encounter(target: usize, source: usize) -> Encounter {
        let (tried, joined, error, seconds) = (Vec::new(), None, None, Seconds::default());
        Encounter { target, source, proposed: 10 * target + source, tried, joined, error, seconds }
    }

    #[test]
    fn pairs_of_unchanged_maps_are_known_wherever_they_stand() {
        let maps = [content(1, 0), content(2, 0), content(3, 0)];
        let mut memory = Memory::default();
        memory.keep(&maps, &[encounter(1, 0), encounter(0, 2), encounter(2, 1)], false);
        // The second changed, and they stand in another order.
        let now = [content(3, 0), content(2, 9), content(1, 0)];
        let known = memory.recall(&now, [0, 2], true).expect("neither changed");
        assert_eq!((known.target, known.source, known.proposed), (2, 0, 2));
        assert!(memory.recall(&now, [0, 1], true).is_none() && memory.recall(&now, [1, 2], false).is_none());
    }

    #[test]
    fn verdicts_are_known_of_maps_as_they_were_and_in_their_order() {
        let [a, b, changed] = [content(1, 0), content(2, 0), content(2, 1)];
        let mut known = Verdicts::default();
        let nothing = slam_lidar::merging::robot_map::RobotMap::new(&[]);
        let verdict = slam_lidar::merging::merge(&nothing, &nothing);
        known.keep([([a, b], verdict.clone(), 0.5)].into_iter());
        let recalled = known.recall([a, b]).map(|(known, seconds)| (known.decision, seconds));
        assert_eq!(recalled, Some((verdict.decision, 0.5)));
        assert!(known.recall([b, a]).is_none() && known.recall([a, changed]).is_none());
        known.keep(std::iter::empty());
        assert!(known.recall([a, b]).is_none());
    }

    #[test]
    fn among_more_maps_a_pair_is_judged_anew_once_the_result_is_to_last() {
        let maps = [content(1, 0), content(2, 0), content(3, 0)];
        let mut memory = Memory::default();
        memory.keep(&maps[..2], &[encounter(0, 1)], false);
        assert!(
            memory.recall(&maps, [0, 1], false).is_some() && memory.recall(&maps, [0, 1], true).is_none()
        );
        // What was only recalled is still what was found among two.
        memory.keep(&maps, &[encounter(0, 1), encounter(0, 2)], false);
        assert!(memory.recall(&maps, [0, 1], true).is_none() && memory.recall(&maps, [0, 2], true).is_some());
    }
}
