//! The common map of several agents (§IV-E, §V-D): their own maps, the closures between them, and what follows.
//!
//! Agents' own maps are kept as they are, each in its world and unit, with the closures between their keyframes. The
//! common map is *made* of these by [`fuse`](CommonMap::fuse): where the agents stand to each other comes from the
//! maximum spanning tree of the merges, then all keyframes move to the minimum of the joint pose graph. So a merge
//! can be undone ([`separate`](CommonMap::separate)), an agent can go on and hand in its map again
//! ([`update`](CommonMap::update)), and nothing of an earlier fusion stays behind.

mod arrangement;
mod closures;
mod fuse;
mod params;
mod rejection;
mod rescaled;
#[cfg(test)]
mod tests;

pub use arrangement::{Arrangement, AssemblyError, Closure, MovedKeyframe, Numbers, Placed};
pub use fuse::{Fused, FusionError};
pub use params::FusionParams;
pub use rejection::TakenBack;

use crate::estimate::Estimate;
use map::{AgentId, Edge, EdgeKind, KeyframeId, Map, MapError};
use std::collections::{BTreeMap, BTreeSet};

/// A keyframe of an agent's own map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Address {
    /// The agent in the common map.
    pub agent: AgentId,
    /// The keyframe's id in the agent's own map.
    pub keyframe: KeyframeId,
}

impl Address {
    /// Whether there is such a keyframe.
    fn is_in(&self, agents: &BTreeMap<AgentId, Map>) -> bool {
        agents.get(&self.agent).is_some_and(|map| map.keyframes.contains_key(&self.keyframe))
    }
}

/// Two agents' keyframes that see the same, and how they stand to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Frame a of the estimate.
    pub from: Address,
    /// Frame b of the estimate.
    pub to: Address,
    /// Maps points of `to`'s camera frame and unit into `from`'s.
    pub from_from_to: Estimate,
}

impl Link {
    /// The two agents, the smaller id first.
    pub fn agents(&self) -> (AgentId, AgentId) {
        let (a, b) = (self.from.agent, self.to.agent);
        (a.min(b), a.max(b))
    }
}

/// Agents' own maps and the closures between them.
#[derive(Clone, Debug, Default)]
pub struct CommonMap {
    agents: BTreeMap<AgentId, Map>,
    links: Vec<Link>,
}

/// Where the keyframes of a map that was handed in are now.
#[derive(Clone, Debug, PartialEq)]
pub struct Addresses {
    /// For each agent of the map: the first id of its keyframes there, and the agent here.
    agents: BTreeMap<AgentId, (u32, AgentId)>,
}

impl Addresses {
    /// The address of keyframe `id` of the map, which is `agent`'s there.
    pub fn of(&self, agent: AgentId, id: KeyframeId) -> Option<Address> {
        let (first, agent) = *self.agents.get(&agent)?;
        Some(Address { agent, keyframe: KeyframeId(id.0.checked_sub(first)?) })
    }

    /// The agents, as they are called here.
    pub fn agents(&self) -> impl Iterator<Item = AgentId> + '_ {
        self.agents.values().map(|(_, agent)| *agent)
    }
}

impl CommonMap {
    /// A common map of nobody.
    pub fn new() -> Self {
        Self::default()
    }

    /// Hands in maps, of one agent each or merged before: merged ones come with the closures between their agents.
    ///
    /// # Errors
    /// [`MapError::SameMapTwice`] when two are of one run, [`MapError::Union`] when a map contradicts itself.
    pub fn from_maps(maps: &[&Map]) -> Result<(Self, Vec<Addresses>), MapError> {
        Map::can_unite(maps)?;
        let mut common = Self::new();
        let addresses = maps.iter().map(|map| common.add(map)).collect();
        Ok((common, addresses))
    }

    /// Adds the agents of a map.
    fn add(&mut self, map: &Map) -> Addresses {
        let mut agents = BTreeMap::new();
        for (old, (first, own)) in map.agents.keys().zip(Self::own_maps(map)) {
            let new = AgentId(self.agents.keys().next_back().map_or(0, |last| last.0 + 1));
            agents.insert(*old, (first, new));
            self.agents.insert(new, own);
        }
        let addresses = Addresses { agents };
        let address = |id: KeyframeId| addresses.of(map.keyframes.get(&id)?.agent, id);
        for edge in map.edges.iter().filter(|edge| edge.kind == EdgeKind::Merge) {
            if let (Some(from), Some(to)) = (address(edge.from), address(edge.to)) {
                self.link(Link { from, to, from_from_to: estimate(edge) });
            }
        }
        addresses
    }

    /// The own maps of a map's agents with the words of their keyframes, each with the first id of these in the map.
    fn own_maps(map: &Map) -> impl Iterator<Item = (u32, Map)> {
        map.agents.values().zip(map.split()).map(|(info, mut own)| {
            let first = info.own.as_ref().map_or(0, |own| own.first_keyframe);
            for keyframe in own.keyframes.values_mut() {
                let here = map.keyframes.get(&KeyframeId(keyframe.id.0 + first));
                keyframe.words = here.and_then(|here| here.words.clone());
            }
            (first, own)
        })
    }

    /// The agents' own maps.
    pub fn agents(&self) -> &BTreeMap<AgentId, Map> {
        &self.agents
    }

    /// The closures between agents.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Takes an agent's own map as it is by now, in place of the one it handed in before: it went on. Closures follow
    /// the units of its keyframes, which change with their depths where a loop was closed or depth refined. Those with
    /// keyframes that it no longer has are dropped; the others join its new keyframes to the common map. False when
    /// there is no such agent, or `own` is not the map of one.
    pub fn update(&mut self, agent: AgentId, own: Map) -> bool {
        let Some(map) = self.agents.get_mut(&agent).filter(|_| own.agents.len() == 1) else { return false };
        for link in &mut self.links {
            if link.from.agent == agent || link.to.agent == agent {
                *link = rescaled::follow(link, agent, map, &own);
            }
        }
        *map = own;
        let agents = &self.agents;
        self.links.retain(|link| link.from.is_in(agents) && link.to.is_in(agents));
        true
    }

    /// Adds a closure. It takes the place of an earlier one between the same two keyframes: the same images say
    /// nothing new when they are aligned again. False when one of its keyframes is not there, or both are of one
    /// agent.
    pub fn link(&mut self, link: Link) -> bool {
        let good =
            link.from.agent != link.to.agent && link.from.is_in(&self.agents) && link.to.is_in(&self.agents);
        if good {
            let ends = [link.from, link.to];
            self.links.retain(|known| !(ends.contains(&known.from) && ends.contains(&known.to)));
            self.links.push(link);
        }
        good
    }

    /// Undoes the merge of two agents: drops all closures between them. Returns how many they were.
    pub fn separate(&mut self, a: AgentId, b: AgentId) -> usize {
        let before = self.links.len();
        self.links.retain(|link| link.agents() != (a.min(b), a.max(b)));
        before - self.links.len()
    }

    /// The pairs of agents that have closures.
    pub fn merged(&self) -> BTreeSet<(AgentId, AgentId)> {
        self.links.iter().map(Link::agents).collect()
    }
}

/// The estimate of an edge.
fn estimate(edge: &Edge) -> Estimate {
    Estimate { a_from_b: edge.from_from_to, information: edge.information }
}
