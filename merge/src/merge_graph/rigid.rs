//! Maps whose scale is known, LiDARs', in one frame (EMR-FLOAM, §4, map-merge graph): the merges of the maximum spanning tree for the
//! start, all of them for the result.

use super::{Merge, MergeGraph};
use crate::estimate::Estimate;
use backend::posegraph::{PoseGraphParams, evaluate_edge, optimise_with_known_scales};
use geometry::{Se3, Sim3};
use map::{AgentId, Edge, EdgeKind, KeyframeId};
use nalgebra::{SMatrix, SVector};
use std::collections::{BTreeMap, BTreeSet};

/// An accepted merge of two maps in metres.
#[derive(Clone, Copy, Debug)]
pub struct RigidMerge {
    /// The one map, by index.
    pub from: usize,
    /// The other map.
    pub to: usize,
    /// Maps points of `to`'s world into `from`'s, metres.
    pub from_from_to: Se3,
    /// How far it is trusted against other merges, > 0.
    pub trust: f64,
}

/// Where maps lie.
#[derive(Clone, Debug)]
pub struct Joined {
    /// The map whose frame each is in: the first of those that merges connect.
    pub root: Vec<usize>,
    /// `root_from_map` of each, metres.
    pub root_from_map: Vec<Se3>,
    /// Each merge's weight in the result, 0–1: one that the others contradict ends near 0.
    pub weights: Vec<f64>,
}

/// What a merge errs by, standard deviations in metres and radians: odometry's drift over the maps.
pub const DEVIATION: (f64, f64) = (0.02, 0.002);

/// Joins `count` maps, 65,535 at most, by merges between them; a merge of maps out of range, of one map with itself, or without a finite pose or a
/// positive trust does not count.
pub fn joined(count: usize, merges: &[RigidMerge]) -> Joined {
    let (graph, is_accepted) = graph_of(count, merges);
    let (mut root, mut nodes) = ((0..count).collect::<Vec<_>>(), BTreeMap::new());
    for component in graph.components() {
        for (agent, placement) in component.agents {
            root[usize::from(agent.0)] = component.root.0.into();
            nodes.insert(node(agent), placement.root_from_agent);
        }
    }
    let edges: Vec<Edge> = graph.merges().map(|(_, merge)| edge(merge)).collect();
    let fixed = root.iter().map(|&root| node(agent(root))).collect();
    let known_scale: BTreeSet<KeyframeId> = nodes.keys().copied().collect();
    let params = PoseGraphParams::default();
    // Where it cannot be optimised the maps stay where the tree puts them.
    let _ = optimise_with_known_scales(&mut nodes, &edges, &fixed, &known_scale, &params);
    let weight = |(merge, is_accepted): (&RigidMerge, &bool)| {
        if !is_accepted {
            return 1.0;
        }
        let edge = edge(&in_graph(merge));
        let [from, to] = [edge.from, edge.to].map(|id| nodes[&id].inverse());
        let residual = evaluate_edge(&from, &to, &edge.from_from_to).residual;
        params.merge.weight(residual.dot(&(edge.information * residual)))
    };
    let weights = merges.iter().zip(&is_accepted).map(weight).collect();
    Joined { root, root_from_map: nodes.values().map(Sim3::rigid).collect(), weights }
}

/// The graph of maps and merges, and which of these may stand in it.
fn graph_of(count: usize, merges: &[RigidMerge]) -> (MergeGraph, Vec<bool>) {
    let mut graph = MergeGraph::new();
    for map in 0..count {
        graph.add_agent(agent(map));
    }
    let is_accepted = merges.iter().map(|merge| graph.add_merge(in_graph(merge)).is_ok()).collect();
    (graph, is_accepted)
}

fn agent(map: usize) -> AgentId {
    AgentId(u16::try_from(map).unwrap_or(u16::MAX))
}

fn node(agent: AgentId) -> KeyframeId {
    KeyframeId(agent.0.into())
}

fn in_graph(merge: &RigidMerge) -> Merge {
    let a_from_b = Sim3::from(merge.from_from_to);
    let (t, r) = (DEVIATION.0.powi(-2), DEVIATION.1.powi(-2));
    // Scale is known; its row only keeps the matrix regular.
    let at_map = SMatrix::from_diagonal(&SVector::from([t, t, t, r, r, r, t]));
    // The error is a right increment, in the frame of the other map: T exp(ε) = exp(Ad_T ε) T.
    let back = a_from_b.inverse().adjoint();
    let information = back.transpose() * at_map * back;
    let from_from_to = Estimate { a_from_b, information: (information + information.transpose()) * 0.5 };
    Merge { from: agent(merge.from), to: agent(merge.to), from_from_to, confidence: merge.trust }
}

fn edge(merge: &Merge) -> Edge {
    Edge {
        from: node(merge.from),
        to: node(merge.to),
        from_from_to: merge.from_from_to.a_from_b,
        information: merge.from_from_to.information,
        kind: EdgeKind::Merge,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    fn pose(i: usize) -> Se3 {
        let i = i as f64;
        Se3::exp(&Vector6::new(3.0 * i, -i * i, 0.1 * i, 0.01 * i, -0.02, 0.7 * i))
    }

    fn exact(from: usize, to: usize, trust: f64) -> RigidMerge {
        RigidMerge { from, to, from_from_to: pose(from).inverse() * pose(to), trust }
    }

    /// Merges of the spanning tree.
    fn tree(count: usize, merges: &[RigidMerge]) -> usize {
        graph_of(count, merges).0.components().iter().map(|component| component.tree.len()).sum()
    }

    #[test]
    fn a_trusted_but_wrong_merge_is_outvoted_by_the_cycles() {
        let mut merges: Vec<RigidMerge> =
            [(0, 1), (1, 2), (0, 2), (2, 3), (1, 3)].map(|(i, j)| exact(i, j, 1.0)).into();
        let wrong = Se3::exp(&Vector6::new(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)) * exact(3, 0, 1.0).from_from_to;
        merges.push(RigidMerge { from: 3, to: 0, from_from_to: wrong, trust: 9.0 });
        let found = joined(5, &merges);
        assert_eq!(tree(5, &merges), 3);
        assert_eq!(found.root, [0, 0, 0, 0, 4]);
        for map in 0..4 {
            let error = (pose(0).inverse() * pose(map)).inverse() * found.root_from_map[map];
            assert!(error.log().norm() < 0.02, "map {map}: {error:?}");
        }
        let weights = &found.weights;
        assert!(weights[5] < 0.1 && weights[..5].iter().all(|w| *w > 0.9), "{weights:?}");
    }

    /// An error is one of the other map's frame: how far apart the worlds lie does not count.
    #[test]
    fn errors_count_the_same_wherever_the_maps_lie() {
        let slightly = Se3::exp(&Vector6::new(0.01, 0.0, 0.0, 0.0, 0.0, 0.002));
        let weights = [1.0, 1000.0].map(|apart| {
            let away = Se3::exp(&Vector6::new(apart, 0.0, 0.0, 0.0, 0.0, 0.0));
            let merge = |from_from_to| RigidMerge { from: 0, to: 1, from_from_to, trust: 1.0 };
            joined(2, &[merge(away), merge(away * slightly)]).weights
        });
        for (near, far) in weights[0].iter().zip(&weights[1]) {
            assert!((near - far).abs() < 1e-3 && *near > 0.9, "{weights:?}");
        }
    }

    #[test]
    fn merges_that_name_no_map_are_left_out() {
        let merges = [exact(0, 7, 1.0), exact(1, 1, 1.0), exact(0, 1, f64::NAN)];
        let found = joined(2, &merges);
        assert_eq!((found.root, found.weights), (vec![0, 1], vec![1.0; 3]));
        assert_eq!(tree(2, &merges), 0);
    }
}
