//! Spreading a loop's drift over the keyframes.

use super::evidence::NoLoop;
use crate::local_map::LocalMap;
use crate::mapping::UnitChange;
use crate::posegraph::{self, KernelShape, PoseGraphParams, RobustKernel};
use geometry::Sim3;
use map::{Edge, EdgeKind, KeyframeId};
use std::collections::{BTreeMap, BTreeSet};

/// Optimises the keyframes' similarities under `edges`, the first one held, and moves the map there: poses
/// stay rigid, each keyframe's scale goes into the depths of its points. Refuses, and leaves the map as it was,
/// when the loops contradict each other.
pub(super) fn correct(
    map: &mut LocalMap,
    edges: &[Edge],
    params: &PoseGraphParams,
) -> Result<Vec<UnitChange>, NoLoop> {
    let mut nodes: BTreeMap<KeyframeId, Sim3> = map
        .keyframes
        .iter()
        .enumerate()
        .map(|(index, state)| (LocalMap::id(index), Sim3::from(state.camera_from_world.inverse())))
        .collect();
    let first = BTreeSet::from([LocalMap::id(0)]);
    let edges = believable(&nodes, edges, &first, params)?;
    let report = posegraph::optimise(&mut nodes, &edges, &first, params).map_err(NoLoop::Graph)?;
    let loses_a_loop = report.suppressed.iter().any(|&i| edges[i].kind == EdgeKind::Loop);
    if loses_a_loop || nodes.values().any(|node| !node.is_valid()) {
        return Err(NoLoop::Contradicted);
    }
    Ok(nodes.into_iter().map(|(id, world_from_keyframe)| place(map, id, &world_from_keyframe)).collect())
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
        let excess = report.final_cost / EXPECTED;
        if excess < 2.0 {
            break;
        }
        for edge in edges.iter_mut().filter(|e| e.kind != EdgeKind::Loop) {
            edge.information /= excess;
        }
    }
    Ok(edges)
}

/// Puts a keyframe where the graph wants it.
fn place(map: &mut LocalMap, id: KeyframeId, world_from_keyframe: &Sim3) -> UnitChange {
    let keyframe = id.0 as usize;
    let factor = world_from_keyframe.scale;
    let state = &mut map.keyframes[keyframe];
    state.camera_from_world = world_from_keyframe.rigid().inverse().renormalized();
    for point in &mut state.points {
        point.inverse_depth /= factor;
        point.variance /= factor * factor;
    }
    UnitChange { keyframe, factor }
}
