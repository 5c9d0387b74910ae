//! Spreads the drift of a loop over the keyframes.

use super::edges;
use super::evidence::NoLoop;
use crate::local_map::LocalMap;
use crate::mapping::ScaleChange;
use backend::posegraph::{self, KernelShape, PoseGraphParams, RobustKernel};
use geometry::Sim3;
use map::{Edge, EdgeKind, KeyframeId};
use std::collections::{BTreeMap, BTreeSet};

/// The pose graph of a loop, owned, so that it can be solved beside the tracking.
pub(super) struct GraphJob {
    nodes: BTreeMap<KeyframeId, Sim3>,
    edges: Vec<Edge>,
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
        Self { nodes, edges, first: LocalMap::id(first), params: params.clone() }
    }

    /// Optimises the keyframes' similarities. Refuses when the loops contradict each other.
    pub fn solve(self) -> Result<Correction, NoLoop> {
        let fixed = self.nodes.range(..self.first.max(LocalMap::id(1))).map(|(id, _)| *id).collect();
        let edges = believable(&self.nodes, &self.edges, &fixed, &self.params)?;
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
}

impl Correction {
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

/// The edges with what those of the map claim lowered until the newest loop is credible.
///
/// The map's edges sit at the optimum, so the cost of a least-squares graph is the loop's squared Mahalanobis
/// distance from what they say, 7 on average. Errors that all points share (calibration, rolling shutter) are
/// in no residual, yet they are what drift is made of: a larger distance means that the edges know less than
/// they claim.
fn believable(
    nodes: &BTreeMap<KeyframeId, Sim3>,
    edges: &[Edge],
    fixed: &BTreeSet<KeyframeId>,
    params: &PoseGraphParams,
) -> Result<Vec<Edge>, NoLoop> {
    const ROUNDS: usize = 5;
    const EXPECTED: f64 = 7.0;
    let kernel = RobustKernel { shape: KernelShape::Quadratic, width: 1.0 };
    let least_squares = PoseGraphParams {
        odometry: kernel,
        covisibility: kernel,
        loop_closure: kernel,
        merge: kernel,
        ..params.clone()
    };
    let mut edges = edges.to_vec();
    for _ in 0..ROUNDS {
        let report =
            posegraph::optimise(&mut nodes.clone(), &edges, fixed, &least_squares).map_err(NoLoop::Graph)?;
        let residual_scale = report.final_cost / EXPECTED;
        if residual_scale < 2.0 {
            break;
        }
        for edge in edges.iter_mut().filter(|e| e.kind != EdgeKind::Loop) {
            edge.information /= residual_scale;
        }
    }
    Ok(edges)
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
