//! Which agents hang together, by what was found.

use fleet::merge_results::MergeResults;
use map::Identity;
use std::collections::BTreeMap;

/// The groups of agents that hang together.
#[derive(Clone, Debug, Default)]
pub(super) struct Components {
    /// Of every agent that is in a component the root of its group.
    roots: BTreeMap<String, String>,
}

impl Components {
    /// As it was found.
    pub fn of(found: &MergeResults) -> Self {
        let mut sizes = BTreeMap::<&String, usize>::new();
        found.agents.iter().for_each(|agent| *sizes.entry(&agent.root).or_default() += 1);
        let joined = found.agents.iter().filter(|agent| sizes[&agent.root] > 1);
        Self { roots: joined.map(|agent| (agent.agent.clone(), agent.root.clone())).collect() }
    }

    /// One group of these agents.
    #[cfg(test)]
    pub fn of_one(agents: &[Identity]) -> Self {
        Self { roots: agents.iter().map(|agent| (agent.to_string(), agents[0].to_string())).collect() }
    }

    /// The root of an agent's group; nothing of one that is alone.
    fn root(&self, agent: &Identity) -> Option<&String> {
        self.roots.get(&agent.to_string())
    }

    /// Of every one of these agents the first of them in its group, be it itself.
    pub fn firsts(&self, agents: &[Identity]) -> Vec<usize> {
        let mut firsts = BTreeMap::new();
        let first = |(number, agent): (usize, &Identity)| match self.root(agent) {
            Some(root) => *firsts.entry(root).or_insert(number),
            None => number,
        };
        agents.iter().enumerate().map(first).collect()
    }

    /// Whether two agents hang together.
    pub fn are_connected(&self, [one, other]: &[Identity; 2]) -> bool {
        self.root(one).is_some_and(|root| self.root(other) == Some(root))
    }

    /// Whether an agent hangs together with any other.
    pub fn is_joined(&self, agent: &Identity) -> bool {
        self.root(agent).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fleet::merge_results::PlacedAgent;
    use map::Uuid;

    fn agent(number: u128) -> Identity {
        Identity { uuid: Uuid::from_u128(number), epoch: 0 }
    }

    #[test]
    fn who_stands_in_one_frame_hangs_together() {
        let found = |(number, root): (u128, u128)| PlacedAgent {
            agent: agent(number).to_string(),
            name: String::new(),
            keyframes: 9,
            whole: true,
            root: agent(root).to_string(),
            root_from_agent: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
        };
        let agents = [(1, 1), (2, 2), (3, 1), (4, 2), (5, 5)].map(found).into();
        let components = Components::of(&MergeResults { agents, pair_verdicts: Vec::new() });
        assert_eq!(components.firsts(&[5, 4, 3, 2, 1, 6].map(agent)), [0, 1, 2, 1, 2, 5]);
        assert!(
            components.are_connected(&[3, 1].map(agent)) && !components.are_connected(&[5, 6].map(agent))
        );
        assert!(
            components.is_joined(&agent(3))
                && !components.is_joined(&agent(5))
                && !components.is_joined(&agent(6))
        );
    }
}
