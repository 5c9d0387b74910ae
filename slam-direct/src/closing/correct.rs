//! Spreads the drift of a loop over the keyframes.

use super::edges;
use super::evidence::NoLoop;
use crate::local_map::LocalMap;
use crate::mapping::ScaleChange;
use backend::posegraph::{self, KernelShape, PoseGraphParams, RobustKernel};
use geometry::Sim3;
use map::{Edge, EdgeKind, KeyframeId, Map};
use std::collections::{BTreeMap, BTreeSet};

/// The pose graph of a loop, owned, so that it can be solved beside the tracking.
pub(super) struct GraphJob {
    nodes: BTreeMap<KeyframeId, Sim3>,
    edges: Vec<Edge>,
    /// How many of the edges are new.
    new: usize,
    /// Those before it stay where they are.
    first: KeyframeId,
    params: PoseGraphParams,
}

/// How the world moves at each keyframe that does: `corrected world from world before`.
pub(super) struct Correction(BTreeMap<KeyframeId, Sim3>);

impl GraphJob {
    /// The map's keyframes under the edges that its points make, its `closed` loops and a new one. Those before `first`
    /// stay where they are, and so does the very first; they are in it as far as later ones have edges with them.
    pub fn new(map: &LocalMap, first: usize, closed: &[Edge], new: Edge, params: &PoseGraphParams) -> Self {
        let mut edges = edges::since(map, first, closed);
        edges.push(new);
        let ends = edges.iter().flat_map(|edge| [edge.from, edge.to]).map(|id| id.0 as usize);
        let indices: BTreeSet<usize> = ends.chain(first..map.keyframes.len()).collect();
        let node = |index| (LocalMap::id(index), map.world_from_keyframe(index));
        let nodes = indices.into_iter().map(node).collect();
        Self { nodes, edges, new: 1, first: LocalMap::id(first), params: params.clone() }
    }

    /// The keyframes of a finished map under its own edges and the new ones of a loop. The first keyframe stays where it is.
    pub fn of_map(map: &Map, new: Vec<Edge>, params: &PoseGraphParams) -> Self {
        let nodes: BTreeMap<_, _> = map.keyframes.values().map(|k| (k.id, k.world_from_keyframe)).collect();
        let first = nodes.keys().next().copied().unwrap_or(KeyframeId(0));
        let (mut edges, count) = (at_their_poses(map), new.len());
        edges.extend(new);
        Self { nodes, edges, new: count, first, params: params.clone() }
    }

    /// Optimises the keyframes' similarities. Refuses when the loops contradict each other.
    pub fn solve(self) -> Result<Correction, NoLoop> {
        let oldest = self.nodes.keys().next().copied();
        let older = self.nodes.range(..self.first).map(|(id, _)| *id);
        let fixed = older.chain(oldest).collect();
        let edges = self.believable(&fixed)?;
        let mut nodes = self.nodes.clone();
        let report = posegraph::optimise(&mut nodes, &edges, &fixed, &self.params).map_err(NoLoop::Graph)?;
        let loses_a_loop = report.suppressed.iter().any(|&i| edges[i].kind == EdgeKind::Loop);
        if loses_a_loop || nodes.values().any(|node| !node.is_valid()) {
            return Err(NoLoop::Contradicted);
        }
        let moved = nodes.into_iter().filter(|(id, _)| *id >= self.first);
        let correction = |(id, after): (KeyframeId, Sim3)| (id, after * self.nodes[&id].inverse());
        Ok(Correction(moved.map(correction).collect()))
    }

    /// The edges with what those of the map claim lowered until the new ones are credible.
    ///
    /// The map's edges sit at the optimum, so the cost of a least-squares graph is the loop's squared Mahalanobis
    /// distance from what they say, 7 on average for each new edge. Errors that all points share (calibration, rolling
    /// shutter) are in no residual, yet they are what drift is made of: a larger distance means that the edges know
    /// less than they claim.
    fn believable(&self, fixed: &BTreeSet<KeyframeId>) -> Result<Vec<Edge>, NoLoop> {
        const ROUNDS: usize = 5;
        const EXPECTED: f64 = 7.0;
        let kernel = RobustKernel { shape: KernelShape::Quadratic, width: 1.0 };
        let least_squares = PoseGraphParams {
            odometry: kernel,
            covisibility: kernel,
            loop_closure: kernel,
            merge: kernel,
            ..self.params.clone()
        };
        let mut edges = self.edges.clone();
        for _ in 0..ROUNDS {
            let report = posegraph::optimise(&mut self.nodes.clone(), &edges, fixed, &least_squares)
                .map_err(NoLoop::Graph)?;
            let residual_scale = report.final_cost / (EXPECTED * self.new as f64);
            if residual_scale < 2.0 {
                break;
            }
            for edge in edges.iter_mut().filter(|e| e.kind != EdgeKind::Loop) {
                edge.information /= residual_scale;
            }
        }
        Ok(edges)
    }
}

/// The edges of a map at the relative poses of its keyframes, as [`edges::all`] makes them.
fn at_their_poses(map: &Map) -> Vec<Edge> {
    edges::at_their_poses(map.edges.iter(), |id| Some(map.keyframes.get(&id)?.world_from_keyframe)).collect()
}

impl Correction {
    /// Moves the keyframes of a finished map; frames are relative to them. Its edges are those at the new poses.
    pub fn apply_to(&self, map: &mut Map) {
        for (id, correction) in &self.0 {
            if let Some(keyframe) = map.keyframes.get_mut(id) {
                keyframe.world_from_keyframe = *correction * keyframe.world_from_keyframe;
            }
        }
        map.edges = at_their_poses(map);
    }

    /// Moves the map: the correction of each keyframe goes into its pose, its scale and the depths of its points. Keyframes made since the graph was taken go along with the last one it knew.
    pub fn apply(&self, map: &mut LocalMap) -> Vec<ScaleChange> {
        let Some(first) = self.0.keys().next().map(|id| id.0 as usize) else { return Vec::new() };
        (first..map.keyframes.len())
            .filter_map(|keyframe| {
                let (_, correction) = self.0.range(..=LocalMap::id(keyframe)).next_back()?;
                let now = map.world_from_keyframe(keyframe);
                Some(place(map, keyframe, &(*correction * now)))
            })
            .collect()
    }
}

/// Puts a keyframe where the graph wants it.
fn place(map: &mut LocalMap, keyframe: usize, world_from_keyframe: &Sim3) -> ScaleChange {
    let state = &mut *map.keyframes[keyframe];
    let factor = world_from_keyframe.scale / state.scale;
    state.scale = world_from_keyframe.scale;
    state.camera_from_world = world_from_keyframe.rigid().inverse().renormalized();
    for point in &mut state.points {
        point.inverse_depth /= factor;
        point.variance /= factor * factor;
        point.doubt /= factor * factor;
    }
    ScaleChange { keyframe, factor }
}
