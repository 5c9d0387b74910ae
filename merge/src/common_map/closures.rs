//! Which closures between two agents agree with each other.
//!
//! Those of one meeting do. Agents that go on and meet again, or maps merged before, bring more, and the maps they
//! were measured in move on: so all are compared (pairwise consistency, Mangelson et al. 2018) whenever a map is made
//! of them. One that contradicts the others would pull the mean that places the agent.

use super::{CommonMap, FusionError, FusionParams, Link};
use backend::posegraph::{MapGraph, PoseGraphError, consistent_set};
use geometry::Sim3;
use map::{AgentId, Edge, EdgeKind, KeyframeId, Map};
use std::collections::BTreeMap;

/// The closures of a common map by what they say of each other.
pub(super) struct Closures {
    /// By the two agents, the smaller id first: the closures that agree, from the smaller one's keyframes.
    pub coherent: BTreeMap<(AgentId, AgentId), Vec<Link>>,
    /// The others, as they are in the common map.
    pub contradicting: Vec<Link>,
}

impl Closures {
    /// Whether a closure of the common map agrees with the others.
    pub(super) fn believes(&self, link: &Link) -> bool {
        !self.contradicting.iter().any(|other| (other.from, other.to) == (link.from, link.to))
    }
}

impl CommonMap {
    /// The closures between every two agents, as far as they agree. Where two sets contradict each other and the
    /// smaller is nearly as large, nothing says which is right, and none of either is believed.
    pub(super) fn consistent(&self, params: &FusionParams) -> Result<Closures, FusionError> {
        let mut closures = Closures { coherent: BTreeMap::new(), contradicting: Vec::new() };
        for (a, b) in self.merged() {
            let (Some(of_a), Some(of_b)) = (self.agents.get(&a), self.agents.get(&b)) else { continue };
            let mut links: Vec<&Link> = self.links.iter().filter(|link| link.agents() == (a, b)).collect();
            let upright = |link: &Link| if link.from.agent == a { *link } else { link.swapped() };
            // In whatever order they came.
            links.sort_by_key(|link| (upright(link).from, upright(link).to));
            let edges: Vec<Edge> = links.iter().map(|link| edge(&upright(link))).collect();
            let selected = select(&edges, of_a, of_b, params)
                .map_err(|source| FusionError::Closures { agents: (a, b), source })?;
            let good = |index: &usize| selected.binary_search(index).is_ok();
            let wrong = links.iter().enumerate().filter(|(index, _)| !good(index));
            closures.contradicting.extend(wrong.map(|(_, link)| **link));
            if !selected.is_empty() {
                closures
                    .coherent
                    .insert((a, b), selected.iter().map(|&index| upright(links[index])).collect());
            }
        }
        Ok(closures)
    }
}

/// The indices, ascending, of the closures that agree with each other; none where a rival is nearly as large.
fn select(edges: &[Edge], from: &Map, to: &Map, params: &FusionParams) -> Result<Vec<usize>, PoseGraphError> {
    let nodes = |map: &Map| -> BTreeMap<KeyframeId, Sim3> {
        map.keyframes.iter().map(|(id, keyframe)| (*id, keyframe.world_from_keyframe)).collect()
    };
    let (from_nodes, to_nodes) = (nodes(from), nodes(to));
    let from = MapGraph { nodes: &from_nodes, edges: &from.edges };
    let to = MapGraph { nodes: &to_nodes, edges: &to.edges };
    let found = consistent_set(edges, from, to, &params.consistency)?;
    let undecided = found.rival as f64 > params.max_rival_share * found.selected.len() as f64;
    Ok(if undecided { Vec::new() } else { found.selected })
}

/// A closure as an edge between the own maps.
fn edge(link: &Link) -> Edge {
    Edge {
        from: link.from.keyframe,
        to: link.to.keyframe,
        from_from_to: link.from_from_to.a_from_b,
        information: link.from_from_to.information,
        kind: EdgeKind::Merge,
    }
}
