//! Agents' own maps and closures into one map for each group of agents that hang together.

use super::closures::Closures;
use super::{CommonMap, FusionParams, Link};
use crate::alignment;
use crate::estimate::{Estimate, mean};
use crate::merge_graph::{Component, Merge, MergeGraph, MergeGraphError, confidence};
use backend::posegraph::{PoseGraphError, PoseGraphReport, optimise_with_known_scales};
use geometry::{Sim3, median};
use map::{AgentId, Edge, EdgeKind, Keyframe, KeyframeId, Map, MapError, Sensor};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// The common map of agents that hang together.
#[derive(Clone, Debug)]
pub struct Fused {
    /// The map. Of one agent alone it is its own; else united, in the world of the first agent.
    pub map: Map,
    /// The agents, by their ids in the [`CommonMap`], in the order of their ids in `map`.
    pub agents: Vec<AgentId>,
    /// Where the spanning tree puts them.
    pub component: Component,
    /// What the joint pose graph did; nothing where it was not optimised.
    pub report: Option<PoseGraphReport>,
    /// Closures that are not believed: they do not agree with the others between the same agents, or the joint pose
    /// graph came to disbelieve them.
    pub suppressed: Vec<Link>,
}

/// Why the maps were not fused.
#[derive(Debug, thiserror::Error)]
pub enum FusionError {
    /// The maps cannot be in one.
    #[error("{0}")]
    Map(#[from] MapError),
    /// A merge is none.
    #[error("{0}")]
    Graph(#[from] MergeGraphError),
    /// The joint pose graph failed.
    #[error("{0}")]
    PoseGraph(#[from] PoseGraphError),
    /// The closures between two agents cannot be compared.
    #[error("the closures between agents {} and {} cannot be used: {source}", .agents.0.0, .agents.1.0)]
    Closures {
        /// The agents; keyframes and edges are those of their own maps and of the closures between them.
        agents: (AgentId, AgentId),
        /// What is wrong.
        source: PoseGraphError,
    },
    /// No closure between two agents says how they lie to each other.
    #[error("no closure between agents {} and {} has keyframes with depth in both maps and a finite information", .0.0, .1.0)]
    NoClosure(AgentId, AgentId),
    /// Closures between two agents have no mean.
    #[error("the closures between agents {} and {} have no mean: their informations are singular", .0.0, .1.0)]
    NoMean(AgentId, AgentId),
    /// How well the closures between two agents place them is no number.
    #[error("how well the closures between agents {} and {} place them is no number", .0.0, .1.0)]
    NoConfidence(AgentId, AgentId),
}

impl CommonMap {
    /// Makes one map for each group of agents that hang together, by ascending first agent.
    ///
    /// # Errors
    /// When the maps or the closures between them cannot make one map; the message says which.
    pub fn fuse(&self, params: &FusionParams) -> Result<Vec<Fused>, FusionError> {
        let closures = self.consistent(params)?;
        let components = self.graph_of(&closures)?.components();
        components.into_iter().map(|component| self.fuse_component(component, &closures, params)).collect()
    }

    /// The graph of merges: one for every two agents with closures, of those closures that agree with each other.
    ///
    /// # Errors
    /// As [`fuse`](Self::fuse).
    pub fn graph(&self, params: &FusionParams) -> Result<MergeGraph, FusionError> {
        self.graph_of(&self.consistent(params)?)
    }

    fn graph_of(&self, closures: &Closures) -> Result<MergeGraph, FusionError> {
        let mut graph = MergeGraph::new();
        for agent in self.agents.keys() {
            graph.add_agent(*agent);
        }
        for (&(a, b), links) in &closures.coherent {
            graph.add_merge(self.merge(a, b, links)?)?;
        }
        Ok(graph)
    }

    /// Closures from agent `a` to `b` as one merge of their worlds. One whose keyframe has no depth, or whose information is
    /// singular, says nothing here and leaves what the others say as it is.
    fn merge(&self, a: AgentId, b: AgentId, links: &[Link]) -> Result<Merge, FusionError> {
        let motions: Vec<(Estimate, Vector3<f64>, f64)> =
            links.iter().filter_map(|link| self.motion_by(a, b, link)).collect();
        if motions.is_empty() {
            return Err(FusionError::NoClosure(a, b));
        }
        let count = motions.len() as f64;
        let centre = motions.iter().map(|(_, centre, _)| centre / count).sum::<Vector3<f64>>();
        let extent = motions.iter().map(|(.., extent)| extent / count).sum();
        let estimates: Vec<Estimate> = motions.into_iter().map(|(estimate, ..)| estimate).collect();
        let joint = mean(&estimates).ok_or(FusionError::NoMean(a, b))?;
        // Closures of neighbouring keyframes are not independent: together they place the worlds as well as one good one; of two
        // merges that do so as well, more closures make the one that is trusted.
        let from_from_to = Estimate { information: joint.information / count, ..joint };
        let confidence =
            confidence(&from_from_to, &centre, extent).ok_or(FusionError::NoConfidence(a, b))? * count.sqrt();
        Ok(Merge { from: a, to: b, from_from_to, confidence })
    }

    /// What a closure says of the worlds of two agents, and where it looks and how far, in the first one's.
    fn motion_by(&self, a: AgentId, b: AgentId, link: &Link) -> Option<(Estimate, Vector3<f64>, f64)> {
        let of_a = self.agents.get(&a)?.keyframes.get(&link.from.keyframe)?;
        let of_b = self.agents.get(&b)?.keyframes.get(&link.to.keyframe)?;
        let (a_pose, b_pose) = (of_a.world_from_keyframe, of_b.world_from_keyframe);
        let estimate = link.from_from_to.carried(&a_pose, &b_pose.inverse())?;
        let (ahead, depth) = seen_by(of_a)?;
        let depth = depth * a_pose.scale;
        Some((estimate, a_pose.translation + a_pose.rotation * ahead * depth, depth))
    }

    /// One component's map.
    fn fuse_component(
        &self,
        mut component: Component,
        closures: &Closures,
        params: &FusionParams,
    ) -> Result<Fused, FusionError> {
        let agents: Vec<AgentId> = component.agents.keys().copied().collect();
        if let ([agent], Some(map)) = (&agents[..], self.agents.get(&component.root)) {
            let (agents, map) = (vec![*agent], alone(map.clone()));
            return Ok(Fused { map, agents, component, report: None, suppressed: Vec::new() });
        }
        let mut map = united(agents.iter().filter_map(|agent| self.agents.get(agent).cloned()))?;
        // Metres are metres, whatever the merges on the way say of it.
        if map.is_metric() {
            for (agent, info) in agents.iter().zip(map.agents.values()) {
                let placement = component.agents.get_mut(agent).filter(|_| info.sensor == Sensor::Lidar);
                placement.into_iter().for_each(|placement| placement.root_from_agent.scale = 1.0);
            }
        }
        place(&mut map, &agents, &component);
        let is_here = |link: &&Link| agents.contains(&link.from.agent);
        let suppressed = closures.contradicting.iter().filter(is_here).copied().collect();
        let links = add_edges(&mut map, &agents, self.links.iter().filter(|link| closures.believes(link)));
        let mut fused = Fused { map, agents, component, report: None, suppressed };
        if params.optimise {
            fused.optimise(&links, params)?;
        }
        Ok(fused)
    }
}

impl Fused {
    /// Moves all keyframes to the minimum of the joint pose graph; the first keyframe of the root stays.
    fn optimise(&mut self, links: &BTreeMap<usize, Link>, params: &FusionParams) -> Result<(), FusionError> {
        let known_scale = keyframes_of_known_scale(&self.map);
        let keyframes = &mut self.map.keyframes;
        let mut nodes: BTreeMap<KeyframeId, Sim3> =
            keyframes.iter().map(|(id, keyframe)| (*id, keyframe.world_from_keyframe)).collect();
        let fixed: BTreeSet<KeyframeId> = nodes.keys().next().copied().into_iter().collect();
        let edges = &self.map.edges;
        let report = optimise_with_known_scales(&mut nodes, edges, &fixed, &known_scale, &params.pose_graph)?;
        for (id, world_from_keyframe) in nodes {
            if let Some(keyframe) = keyframes.get_mut(&id) {
                keyframe.world_from_keyframe = world_from_keyframe;
            }
        }
        self.suppressed.extend(report.suppressed.iter().filter_map(|index| links.get(index).copied()));
        self.report = Some(report);
        Ok(())
    }
}

/// The common map of one agent alone: its own.
pub(super) fn alone(mut own: Map) -> Map {
    // Only common maps are searched by them.
    own.keyframes.values_mut().for_each(|keyframe| keyframe.words = None);
    own
}

/// Agents' own maps in one, before they are moved: their poses are remembered as the own ones.
pub(super) fn united(own: impl IntoIterator<Item = Map>) -> Result<Map, MapError> {
    let apart = own.into_iter().map(|mut own| {
        own.agents.values_mut().for_each(|info| info.own = None);
        own
    });
    Map::unite(apart.collect())
}

impl Link {
    /// The same link seen from the other side.
    pub(super) fn swapped(&self) -> Self {
        Self { from: self.to, to: self.from, from_from_to: self.from_from_to.inverse() }
    }
}

/// Adds the closures among `agents` to their united map as edges; returns them by the edges' indices.
fn add_edges<'a>(
    map: &mut Map,
    agents: &[AgentId],
    links: impl Iterator<Item = &'a Link>,
) -> BTreeMap<usize, Link> {
    let united = |address: &super::Address| {
        let position = agents.iter().position(|agent| *agent == address.agent)?;
        let own = map.agents.values().nth(position)?.own.as_ref()?;
        Some(KeyframeId(own.first_keyframe + address.keyframe.0))
    };
    let edge = |link: &Link| {
        let Estimate { a_from_b, information } = link.from_from_to;
        let (from, to) = (united(&link.from)?, united(&link.to)?);
        Some((Edge { from, to, from_from_to: a_from_b, information, kind: EdgeKind::Merge }, *link))
    };
    let edges: Vec<(Edge, Link)> = links.filter_map(edge).collect();
    let mut links = BTreeMap::new();
    for (edge, link) in edges {
        links.insert(map.edges.len(), link);
        map.edges.push(edge);
    }
    links
}

/// Towards where a keyframe sees, nowhere for a LiDAR, which sees all around itself; and how far it sees (median), keyframe
/// units. `None` where there is no depth.
fn seen_by(keyframe: &Keyframe) -> Option<(Vector3<f64>, f64)> {
    if let Some(depth) = keyframe.semi_dense.median_depth() {
        return Some((Vector3::z(), depth));
    }
    let points = keyframe.scan.iter().flat_map(|scan| scan.points());
    let mut ranges: Vec<f32> = points.map(|[x, y, z]| (x * x + y * y + z * z).sqrt()).collect();
    let range = f64::from(median(&mut ranges)?);
    (range > 0.0).then_some((Vector3::zeros(), range))
}

/// The keyframes of a common map whose scale is known: those of LiDARs, where the common world is in metres. Of a camera
/// whose map is in metres each keyframe has a unit of its own, which drifts.
fn keyframes_of_known_scale(map: &Map) -> BTreeSet<KeyframeId> {
    let is_metric = map.is_metric();
    let of_lidar = |keyframe: &&Keyframe| {
        map.agents.get(&keyframe.agent).is_some_and(|info| info.sensor == Sensor::Lidar)
    };
    map.keyframes.values().filter(|_| is_metric).filter(of_lidar).map(|keyframe| keyframe.id).collect()
}

/// Moves every agent of a united map to its place in the root's world (§IV-E).
fn place(map: &mut Map, agents: &[AgentId], component: &Component) {
    let motions: BTreeMap<AgentId, Sim3> = map
        .agents
        .keys()
        .zip(agents)
        .filter_map(|(united, agent)| Some((*united, component.agents.get(agent)?.root_from_agent)))
        .collect();
    alignment::apply(map, &motions);
}
