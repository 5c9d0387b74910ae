//! How far apart two keyframes may have drifted within their map.

use super::{ConsistencyParams, MapGraph};
use geometry::Sim3;
use map::KeyframeId;
use nalgebra::{SMatrix, SVector};
use std::collections::{BTreeMap, VecDeque};

/// The shortest way between two keyframes along the edges of their map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShortestPath {
    /// Edges on it; as few as there can be.
    pub edges: usize,
    /// Its length, map units; the least of the ways of so few edges.
    pub length: f64,
}

/// Which keyframes each keyframe shares an edge with.
pub(super) struct Neighbours(BTreeMap<KeyframeId, Vec<KeyframeId>>);

impl Neighbours {
    pub(super) fn new(graph: &MapGraph) -> Self {
        let mut neighbours: BTreeMap<KeyframeId, Vec<KeyframeId>> = BTreeMap::new();
        for edge in graph.edges {
            neighbours.entry(edge.from).or_default().push(edge.to);
            neighbours.entry(edge.to).or_default().push(edge.from);
        }
        Self(neighbours)
    }

    /// The ways from `start` to every keyframe that it hangs together with.
    pub(super) fn shortest_paths(
        &self,
        nodes: &BTreeMap<KeyframeId, Sim3>,
        start: KeyframeId,
    ) -> BTreeMap<KeyframeId, ShortestPath> {
        let mut shortest_paths = BTreeMap::from([(start, ShortestPath { edges: 0, length: 0.0 })]);
        let mut queue = VecDeque::from([start]);
        // Breadth first: the keyframes n edges away all have their least length before any n + 1 away is taken.
        while let Some(here) = queue.pop_front() {
            let path = shortest_paths[&here];
            for next in self.0.get(&here).into_iter().flatten() {
                let (Some(from), Some(to)) = (nodes.get(&here), nodes.get(next)) else { continue };
                let edges = path.edges + 1;
                let length = path.length + (from.translation - to.translation).norm();
                match shortest_paths.get_mut(next) {
                    None => {
                        shortest_paths.insert(*next, ShortestPath { edges, length });
                        queue.push_back(*next);
                    }
                    Some(known) if known.edges == edges => known.length = known.length.min(length),
                    Some(_) => {}
                }
            }
        }
        shortest_paths
    }
}

impl ShortestPath {
    /// Covariance of the left perturbation of `here_from_there` by what the map may have drifted on the way, in
    /// the frame and unit of the keyframe `here`; `scale` is that of its `world_from_keyframe`.
    pub(super) fn covariance(&self, scale: f64, params: &ConsistencyParams) -> SMatrix<f64, 7, 7> {
        let translation = params.drift_translation * self.length / scale;
        let rotation = params.drift_rotation.to_radians().powi(2) * self.edges as f64;
        let log_scale = params.drift_scale.powi(2) * self.edges as f64;
        let t = translation * translation;
        SMatrix::from_diagonal(&SVector::from([t, t, t, rotation, rotation, rotation, log_scale]))
    }
}
