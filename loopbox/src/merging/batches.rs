//! Merging in batches: of many pairs of maps a few are looked at in one batch, then the common map is made and told, then the next
//! few are. Which come first is judged here.
//!
//! An agent needs one merge to have its place. So pairs that would join two groups of agents come first, of these the
//! likeliest; what only says again how the agents of one group lie to each other comes last. In the end all were looked at,
//! and in which order makes no difference to what comes of it.

use super::PairResult;
use std::cmp::Ordering;
use std::time::{Duration, Instant};

/// What two maps made of each other before.
pub(crate) struct Known {
    /// What they made of each other.
    pub pair_result: PairResult,
    /// Whether they are to be looked at again: one of them changed since, say. Until then it counts.
    pub is_due: bool,
    /// Whether it is enough then to look at what is new, where they were merged.
    pub may_grow: bool,
}

/// How much is looked at in one batch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Share {
    /// Pairs at the most.
    pub pairs: usize,
    /// No further pair is begun after that; one always is.
    pub time: Duration,
}

impl Share {
    /// Whether after so many pairs since `begun` no further one is to be begun.
    pub fn is_used_up(&self, pairs: usize, begun: Instant) -> bool {
        pairs >= self.pairs.max(1) || pairs > 0 && begun.elapsed() >= self.time
    }
}

/// A pair of maps that is to be looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Waiting {
    /// The inputs, the earlier first.
    pub pair: [usize; 2],
    /// How much they look alike, by the best of their places; more is likelier, of what unit does not matter.
    pub similarity: f32,
    /// Whether it is known already what they made of each other, as far as that may change.
    pub is_again: bool,
}

/// Which of so many agents hang together.
#[derive(Clone, Debug)]
pub(crate) struct Groups(Vec<usize>);

impl Groups {
    /// So many agents, each alone.
    pub fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    /// Joins the groups of two; whether they were two.
    pub fn join(&mut self, [a, b]: [usize; 2]) -> bool {
        let (one, other) = (self.0[a], self.0[b]);
        self.0.iter_mut().filter(|group| **group == other).for_each(|group| *group = one);
        one != other
    }

    /// Whether two hang together.
    pub fn are_one(&self, [a, b]: [usize; 2]) -> bool {
        self.0[a] == self.0[b]
    }
}

/// The pair that is looked at next: one that would join two groups before all others, of these one that was never looked at,
/// then the likeliest, of equals the first.
pub(super) fn next(waiting: &[Waiting], groups: &Groups) -> Option<usize> {
    let before = |one: &Waiting, other: &Waiting| -> Ordering {
        let key = |waiting: &Waiting| (groups.are_one(waiting.pair), waiting.is_again);
        key(one).cmp(&key(other)).then(other.similarity.total_cmp(&one.similarity))
    };
    // Of equals `min_by` takes the first.
    (0..waiting.len()).min_by(|&a, &b| before(&waiting[a], &waiting[b]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waiting(pair: [usize; 2], similarity: f32) -> Waiting {
        Waiting { pair, similarity, is_again: false }
    }

    /// The order in which pairs are looked at where those `met` meet.
    fn order(mut all: Vec<Waiting>, mut groups: Groups, met: &[[usize; 2]]) -> Vec<[usize; 2]> {
        let mut order = Vec::new();
        while let Some(index) = next(&all, &groups) {
            let pair = all.remove(index).pair;
            if met.contains(&pair) {
                groups.join(pair);
            }
            order.push(pair);
        }
        order
    }

    #[test]
    fn who_is_alone_comes_first_and_of_these_the_likeliest() {
        let all =
            vec![waiting([0, 1], 0.9), waiting([0, 2], 0.2), waiting([1, 2], 0.3), waiting([0, 3], 0.1)];
        let together = order(all.clone(), Groups::new(4), &[[0, 1], [1, 2]]);
        // Once 2 is joined by 1, what it makes of 0 says nothing that is not known.
        assert_eq!(together, [[0, 1], [1, 2], [0, 3], [0, 2]]);
        let refused = order(all.clone(), Groups::new(4), &[]);
        assert_eq!(refused, [[0, 1], [1, 2], [0, 2], [0, 3]]);
        let mut joined = Groups::new(4);
        assert!(joined.join([0, 1]) && joined.join([2, 1]) && !joined.join([0, 2]));
        assert_eq!(order(all, joined, &[])[0], [0, 3]);
    }

    #[test]
    fn who_was_never_looked_at_comes_before_who_was() {
        let again = Waiting { is_again: true, ..waiting([0, 1], 0.9) };
        let all = vec![again, waiting([0, 2], 0.1)];
        assert_eq!(order(all, Groups::new(3), &[]), [[0, 2], [0, 1]]);
    }

    #[test]
    fn of_equals_the_first_comes_first() {
        let all = vec![waiting([0, 1], 0.5), waiting([0, 2], 0.5)];
        assert_eq!(order(all, Groups::new(3), &[]), [[0, 1], [0, 2]]);
    }

    #[test]
    fn a_share_lasts_for_one_pair_and_then_until_either_bound() {
        let share = Share { pairs: 2, time: Duration::ZERO };
        assert!(!share.is_used_up(0, Instant::now()) && share.is_used_up(1, Instant::now()));
        let share = Share { pairs: 2, time: Duration::MAX };
        assert!(!share.is_used_up(1, Instant::now()) && share.is_used_up(2, Instant::now()));
    }
}
