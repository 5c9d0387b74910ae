//! The edges of closures: which is nearest, what they know of a motion elsewhere, what drift takes from them.

use crate::estimate::Estimate;
use crate::overlap::Glimpse;
use crate::prepared::PreparedMap;
use geometry::Sim3;
use map::{Edge, EdgeKind, KeyframeId};
use nalgebra::{SMatrix, SVector};

/// Of edges the one whose keyframe is named nearest to this one, of equals the earlier: an agent's keyframes are numbered as it takes
/// them, and of two as near in time the maps drift least.
pub(super) fn nearest(
    edges: &[Edge],
    keyframe: impl Fn(&Edge) -> KeyframeId,
    to: KeyframeId,
) -> Option<&Edge> {
    edges.iter().min_by_key(|edge| (keyframe(edge).0.abs_diff(to.0), keyframe(edge)))
}

/// target_world_from_source_world by the edge whose keyframes are named nearest to those of a pair.
pub(super) fn nearest_motion(
    source: &PreparedMap,
    target: &PreparedMap,
    edges: &[Edge],
    (i, j): (KeyframeId, KeyframeId),
) -> Option<Sim3> {
    let apart = |edge: &&Edge| edge.to.0.abs_diff(i.0).min(edge.from.0.abs_diff(j.0));
    motion_by(source, target, edges.iter().min_by_key(apart)?)
}

/// target_world_from_source_world as an edge has it.
pub(super) fn motion_by(source: &PreparedMap, target: &PreparedMap, edge: &Edge) -> Option<Sim3> {
    Some(target.world_from(edge.from)? * edge.from_from_to * source.world_from(edge.to)?.inverse())
}

/// What edges know together of a motion where one keyframe of the target is; `from_edge` leads there from the keyframe of an
/// edge, of which it gives nothing where that has no pose.
pub(super) fn information_at(
    edges: &[&Edge],
    from_edge: impl Fn(&Edge) -> Option<Sim3>,
) -> SMatrix<f64, 7, 7> {
    let carried = |edge: &&Edge| {
        let known = Estimate { a_from_b: edge.from_from_to, information: edge.information };
        Some(known.carried(&from_edge(edge)?, &Sim3::identity())?.information)
    };
    edges.iter().filter_map(carried).sum()
}

/// The edge of an aligned pair, from the target's keyframe.
pub(super) fn edge(source: KeyframeId, target: KeyframeId, target_from_source: Estimate) -> Edge {
    Edge {
        from: target,
        to: source,
        from_from_to: target_from_source.a_from_b,
        information: target_from_source.information,
        kind: EdgeKind::Merge,
    }
}

/// Adds to the uncertainty of an edge what [`FurtherParams::drift`] allows.
pub(super) fn allow(edge: &mut Edge, target: &PreparedMap, drift: &[f64; 3]) {
    let Some(covariance) = edge.information.try_inverse() else { return };
    let reach = reach(target, edge.from).unwrap_or(0.0);
    let [translation, rotation, scale] =
        [drift[0] * reach, drift[1], drift[2]].map(|deviation| deviation.powi(2));
    let allowed = SVector::from([translation, translation, translation, rotation, rotation, rotation, scale]);
    let information = (covariance + SMatrix::from_diagonal(&allowed)).try_inverse();
    edge.information = information.map_or(edge.information, |found| (found + found.transpose()) * 0.5);
}

/// The median distance of what a keyframe sees, its unit.
pub(super) fn reach(map: &PreparedMap, id: KeyframeId) -> Option<f64> {
    let mut distances: Vec<f64> =
        Glimpse::of(map.map(), id)?.points.iter().map(|point| point.norm()).collect();
    distances.sort_by(f64::total_cmp);
    distances.get(distances.len() / 2).copied()
}
