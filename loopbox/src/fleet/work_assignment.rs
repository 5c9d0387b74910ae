//! Which of two agents that meet looks at the places of both: one of them, so that what it takes goes one way only.

use fleet::merge_results::MergeResults;
use map::Identity;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long the other one may take before one looks oneself: twice what two maps of 100 keyframes may take over
/// 256 kbit/s.
const PATIENCE: Duration = Duration::from_secs(180);

/// Pairs that are left to others, and since when.
#[derive(Default)]
pub(super) struct WorkAssignment(BTreeMap<[Identity; 2], Instant>);

impl WorkAssignment {
    /// The pairs among `all`, the smaller identity first, that are left to others: to the agent with the smaller one,
    /// where the other is one's `own`, until its `remote_results` say what became of it or it takes too long.
    pub fn assigned_to_others(
        &mut self,
        all: &[Identity],
        own: &[Identity],
        remote_results: &[Arc<MergeResults>],
    ) -> BTreeSet<[Identity; 2]> {
        self.0.retain(|pair, _| pair.iter().all(|agent| all.contains(agent)));
        let others = all.iter().filter(|agent| !own.contains(agent));
        let pairs = others.flat_map(|other| own.iter().map(move |own| [*other, *own]));
        let mut is_left = |pair: &[Identity; 2]| {
            let agents = pair.map(|agent| agent.to_string());
            let begun = *self.0.entry(*pair).or_insert_with(Instant::now);
            begun.elapsed() < PATIENCE && !remote_results.iter().any(|found| found.has_decided(&agents))
        };
        pairs.filter(|[other, own]| other < own).filter(|pair| is_left(pair)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fleet::merge_results::PairVerdict;
    use map::Uuid;

    fn agent(number: u128) -> Identity {
        Identity { uuid: Uuid::from_u128(number), epoch: 0 }
    }

    fn found(pending: bool) -> MergeResults {
        let agents = [agent(2), agent(1)].map(|agent| agent.to_string());
        let (names, verdict) = (["b".into(), "a".into()], "undecided".into());
        let pair_verdict = PairVerdict { names, agents, verdict, why: None, pending };
        MergeResults { agents: Vec::new(), pair_verdicts: vec![pair_verdict] }
    }

    #[test]
    fn one_of_two_looks_and_the_other_waits_for_what_it_says() {
        let pair = [agent(1), agent(2)];
        let left = |own: &[Identity], remote_results: &[Arc<MergeResults>]| {
            WorkAssignment::default().assigned_to_others(&pair, own, remote_results).contains(&pair)
        };
        assert!(!left(&[agent(1)], &[]));
        assert!(left(&[agent(2)], &[]));
        // A station has no map of its own, and whoever has both looks at them.
        assert!(!left(&[], &[]) && !left(&pair, &[]));
        assert!(left(&[agent(2)], &[found(true).into()]));
        assert!(!left(&[agent(2)], &[found(false).into()]));
    }
}
