//! Who was joined with whom, and how well each agent's place is known.

use crate::merging::Merging;
use map::AgentId;
use merge::common_map::Fused;
use merge::merge_graph::{Merge, MergeGraph, MergeId, Placement};
use serde::Serialize;

/// The merge graph of the group shown.
#[derive(Serialize)]
pub struct Graph {
    agents: Vec<Placed>,
    merges: Vec<Joint>,
    /// The joint pose graph; nothing where it was not optimised.
    pose_graph: Option<PoseGraph>,
}

/// An agent of the group, in the order of the scene.
#[derive(Serialize)]
struct Placed {
    keyframes: usize,
    /// The agents on the way from the first one to this one, indices into the scene's; both ends included.
    #[serde(rename = "way")]
    route: Vec<usize>,
    /// Units of the first agent's map per unit of the agent's own.
    scale: f64,
    /// Standard deviations along the way, of the largest axis: map units at the first agent's world origin, degrees
    /// and parts of the scale.
    deviation: Deviation,
    /// The smallest confidence on the way; nothing for the first agent.
    confidence: Option<f64>,
}

#[derive(Serialize)]
struct Deviation {
    position: f64,
    rotation: f64,
    scale: f64,
}

/// Two agents that closures join.
#[derive(Serialize)]
struct Joint {
    agents: [usize; 2],
    closures: usize,
    confidence: f64,
    /// Whether the agents' places rest on it.
    in_tree: bool,
}

#[derive(Serialize)]
struct PoseGraph {
    initial_cost: f64,
    final_cost: f64,
    iterations: usize,
    converged: bool,
    /// Closures that came to be disbelieved.
    suppressed: usize,
}

/// A group of agents that is not shown.
#[derive(Serialize)]
pub struct Group {
    names: Vec<String>,
    keyframes: usize,
}

impl Group {
    /// The group of a map.
    pub fn new(fused: &Fused) -> Self {
        let names = fused.map.agents.values().map(|agent| agent.name.clone()).collect();
        Self { names, keyframes: fused.map.keyframes.len() }
    }
}

impl Graph {
    /// The graph of the group `displayed`.
    pub fn new(merging: &Merging, displayed: &Fused) -> Self {
        let graph = &merging.graph;
        let index = |agent: AgentId| displayed.agents.iter().position(|other| *other == agent);
        let merges = graph.merges().filter_map(|(id, merge)| {
            let agents = [index(merge.from)?, index(merge.to)?];
            let (low, high) = (merge.from.min(merge.to), merge.from.max(merge.to));
            let closures = merging.common.links().iter().filter(|link| link.agents() == (low, high)).count();
            let in_tree = displayed.component.tree.contains(&id);
            Some(Joint { agents, closures, confidence: merge.confidence, in_tree })
        });
        let counts = displayed
            .map
            .agents
            .keys()
            .map(|id| displayed.map.keyframes.values().filter(|keyframe| keyframe.agent == *id).count());
        let agents = displayed.agents.iter().zip(counts).filter_map(|(agent, keyframes)| {
            let placement = displayed.component.agents.get(agent)?;
            let route = route(graph, displayed.component.root, &placement.path);
            Some(Placed::new(placement, keyframes, route.into_iter().filter_map(index).collect()))
        });
        let pose_graph = displayed.report.as_ref().map(|report| PoseGraph {
            initial_cost: report.initial_cost,
            final_cost: report.final_cost,
            iterations: report.iterations,
            converged: report.converged,
            suppressed: displayed.suppressed.len(),
        });
        Self { agents: agents.collect(), merges: merges.collect(), pose_graph }
    }
}

impl Placed {
    fn new(placement: &Placement, keyframes: usize, route: Vec<usize>) -> Self {
        let deviation = |range: std::ops::Range<usize>| {
            range.map(|i| placement.covariance[(i, i)]).fold(0.0, f64::max).sqrt()
        };
        Self {
            keyframes,
            route,
            scale: placement.root_from_agent.scale,
            deviation: Deviation {
                position: deviation(0..3),
                rotation: deviation(3..6).to_degrees(),
                scale: deviation(6..7),
            },
            confidence: Some(placement.confidence).filter(|confidence| confidence.is_finite()),
        }
    }
}

/// The agents along merges from `root` on.
fn route(graph: &MergeGraph, root: AgentId, path: &[MergeId]) -> Vec<AgentId> {
    let merge = |id: &MergeId| -> Option<&Merge> {
        graph.merges().find(|(other, _)| other == id).map(|(_, merge)| merge)
    };
    let mut route = vec![root];
    let mut at = root;
    for Merge { from, to, .. } in path.iter().filter_map(merge) {
        at = if *from == at { *to } else { *from };
        route.push(at);
    }
    route
}
