//! What merging found out about where agents are.

use crate::merging::{Input, Merging, refusal_of};
use fleet::merge_results::{ACCEPTED, MergeResults, NOT_YET, PairVerdict, PlacedAgent, numbers};
use map::AgentId;
use std::collections::{BTreeMap, BTreeSet};

/// What a merging of maps found; `whole` says of each whether it is all of the agent's map. Pairs of inputs, the first one
/// first, of which it `is_open` whether more is to be looked at, are not merged yet, and nothing worse is said of them.
pub(super) fn found(
    inputs: &[Input],
    merging: &Merging,
    whole: &[bool],
    is_open: impl Fn([usize; 2]) -> bool,
) -> MergeResults {
    let identity = |agent: AgentId| {
        let own = merging.common.agents().get(&agent)?;
        own.agents.values().next()?.identity.map(|identity| identity.to_string())
    };
    let agent = |(number, input): (usize, &Input)| {
        let id = merging.addresses.get(number)?.agents().next()?;
        let component = merging.fused.iter().map(|fused| &fused.component);
        let (root, place) = component
            .into_iter()
            .find_map(|component| Some((component.root, component.agents.get(&id)?.root_from_agent)))?;
        Some(PlacedAgent {
            agent: identity(id)?,
            name: input.name.clone(),
            keyframes: input.features.len(),
            whole: whole.get(number).copied().unwrap_or(false),
            root: identity(root)?,
            root_from_agent: numbers(&place),
        })
    };
    let pair_verdicts = merging.pair_results.iter().map(|pair_result| PairVerdict {
        names: pair_result.as_given().map(|input| inputs[input].name.clone()),
        agents: pair_result.as_given().map(|input| {
            let agent = merging.addresses.get(input).and_then(|addresses| addresses.agents().next());
            agent.and_then(identity).unwrap_or_default()
        }),
        verdict: reported_verdict(pair_result.verdict(), is_open(pair_result.as_given())),
        why: refusal_of(merging, &pair_result),
        pending: false,
    });
    MergeResults {
        agents: inputs.iter().enumerate().filter_map(agent).collect(),
        pair_verdicts: pair_verdicts.collect(),
    }
}

/// What is said of a pair, of which it `is_open` whether more is to be looked at.
pub(super) fn reported_verdict(verdict: &str, is_open: bool) -> String {
    let verdict = if is_open && verdict != ACCEPTED { NOT_YET } else { verdict };
    verdict.to_owned()
}

/// Of what `parts` of maps found what `whole` maps do not say yet. Of agents that hang together by parts one of those that do
/// so by whole maps too is kept, the others beside it: they stand where it does.
pub(super) fn lacking(parts: MergeResults, whole: &MergeResults) -> MergeResults {
    let root_of = |agent: &str| Some(&*whole.agents.iter().find(|known| known.agent == agent)?.root);
    let mut groups = BTreeMap::<&str, Vec<&PlacedAgent>>::new();
    parts.agents.iter().for_each(|agent| groups.entry(&agent.root).or_default().push(agent));
    let mut kept = BTreeSet::new();
    for group in groups.values() {
        let mut sizes = BTreeMap::<&str, usize>::new();
        group
            .iter()
            .filter_map(|agent| root_of(&agent.agent))
            .for_each(|root| *sizes.entry(root).or_default() += 1);
        let most = sizes.into_iter().max_by_key(|(_, size)| *size).map(|(root, _)| root);
        let is_known = |agent: &&&PlacedAgent| most.is_some() && root_of(&agent.agent) == most;
        let others: Vec<&str> =
            group.iter().filter(|agent| !is_known(agent)).map(|agent| &*agent.agent).collect();
        let anchor = group.iter().find(is_known).filter(|_| !others.is_empty());
        kept.extend(others.into_iter().chain(anchor.map(|agent| &*agent.agent)).map(str::to_owned));
    }
    let is_reported = |pair_verdict: &PairVerdict| {
        let is_same =
            |known: &PairVerdict| pair_verdict.agents.iter().all(|agent| known.agents.contains(agent));
        whole.pair_verdicts.iter().any(is_same)
    };
    let mut lacking = parts;
    lacking.agents.retain(|agent| kept.contains(&agent.agent));
    lacking.pair_verdicts.retain(|pair_verdict| !is_reported(pair_verdict));
    lacking
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Agents with their roots and where they are along it; pairs that were looked at.
    fn found(agents: &[(&str, &str, f64)], pairs: &[[&str; 2]]) -> MergeResults {
        let agent = |&(agent, root, x): &(&str, &str, f64)| PlacedAgent {
            agent: agent.into(),
            name: agent.into(),
            keyframes: 3,
            whole: false,
            root: root.into(),
            root_from_agent: [x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
        };
        let pair_verdict = |pair: &[&str; 2]| PairVerdict {
            names: pair.map(str::to_owned),
            agents: pair.map(str::to_owned),
            verdict: "accepted".into(),
            why: None,
            pending: false,
        };
        MergeResults {
            agents: agents.iter().map(agent).collect(),
            pair_verdicts: pairs.iter().map(pair_verdict).collect(),
        }
    }

    fn agents(found: &MergeResults) -> Vec<(&str, &str, f64)> {
        let mut all: Vec<_> =
            found.agents.iter().map(|a| (&*a.agent, &*a.root, a.root_from_agent[0])).collect();
        all.sort_by(|a, b| a.0.cmp(b.0));
        all
    }

    #[test]
    fn while_more_is_to_be_looked_at_nobody_is_refused() {
        let verdicts = ["accepted", "undecided", "refused"];
        assert_eq!(
            verdicts.map(|verdict| reported_verdict(verdict, true)),
            ["accepted", "not yet", "not yet"]
        );
        assert_eq!(verdicts.map(|verdict| reported_verdict(verdict, false)), verdicts);
    }

    #[test]
    fn places_by_parts_are_kept_until_whole_maps_have_them() {
        let parts = found(
            &[("a", "a", 0.0), ("b", "a", 1.0), ("c", "a", 2.0), ("d", "a", 3.0), ("e", "e", 0.0)],
            &[["a", "b"], ["b", "c"], ["c", "d"]],
        );
        // Of a and b whole maps say it, c is looked at and alone so far, of d and e nothing is known.
        let whole = found(&[("a", "b", -1.0), ("b", "b", 0.0), ("c", "c", 0.0)], &[["b", "a"]]);
        let left = lacking(parts.clone(), &whole);
        assert_eq!(agents(&left).into_iter().map(|agent| agent.0).collect::<Vec<_>>(), ["a", "c", "d", "e"]);
        assert_eq!(left.pair_verdicts.len(), 2);
        let all = left.overlaid_by(&whole);
        assert_eq!(
            agents(&all),
            [("a", "b", -1.0), ("b", "b", 0.0), ("c", "b", 1.0), ("d", "b", 2.0), ("e", "e", 0.0)]
        );
        assert_eq!(agents(&all), agents(&parts.clone().overlaid_by(&whole)));
        // Once whole maps say all of it nothing is left, and while they say nothing all is.
        let whole = found(&["a", "b", "c", "d", "e"].map(|agent| (agent, "a", 0.0)), &[["a", "b"]]);
        assert!(lacking(parts.clone(), &whole).agents.is_empty());
        assert_eq!(lacking(parts.clone(), &MergeResults::default()), parts);
    }
}
