//! Which keyframes of two maps are worth comparing, by a motion between the maps.

use super::FurtherParams;
use crate::overlap::{Glimpse, Placed};
use geometry::Sim3;
use map::{Edge, KeyframeId};
use rayon::prelude::*;

/// Pairs of keyframes, of the source and of the target, that should overlap by a motion of the maps and are to be tried:
/// at most [`max_closures`](FurtherParams::max_closures) without those that `known` has.
pub fn worth_trying(
    sources: &[Glimpse],
    targets: &[Glimpse],
    target_world_from_source_world: &Sim3,
    known: &[Edge],
    params: &FurtherParams,
) -> Vec<(KeyframeId, KeyframeId)> {
    let pairs = overlapping(sources, targets, target_world_from_source_world, params);
    spread(pairs, params.max_closures, known)
}

/// For each keyframe of the source the one of the target that sees most of its points, both ways, where that is
/// enough.
pub(super) fn overlapping(
    sources: &[Glimpse],
    targets: &[Glimpse],
    target_world_from_source_world: &Sim3,
    params: &FurtherParams,
) -> Vec<(KeyframeId, KeyframeId)> {
    let min_cosine = params.max_view_angle.to_radians().cos();
    let placed: Vec<Placed> =
        targets.iter().map(|j| Placed::new(j, &Sim3::identity(), target_world_from_source_world)).collect();
    let best = |i: &Glimpse| -> Option<(KeyframeId, KeyframeId)> {
        let here = Placed::new(i, target_world_from_source_world, &Sim3::identity());
        let seen = |j: &Placed| -> Option<(f64, KeyframeId)> {
            let share = here.overlap(j, min_cosine, params.min_overlap)?;
            Some((share, j.glimpse.id))
        };
        // Of equals the first.
        let better = |a: (f64, KeyframeId), b: (f64, KeyframeId)| if b.0 > a.0 { b } else { a };
        placed.iter().filter_map(seen).reduce(better).map(|(_, j)| (i.id, j))
    };
    sources.par_iter().filter_map(best).collect()
}

/// At most `count` of the pairs, evenly spread, without those that have an edge already.
pub(super) fn spread(
    pairs: Vec<(KeyframeId, KeyframeId)>,
    count: usize,
    edges: &[Edge],
) -> Vec<(KeyframeId, KeyframeId)> {
    let known = |pair: &(KeyframeId, KeyframeId)| edges.iter().any(|edge| (edge.to, edge.from) == *pair);
    let fresh: Vec<_> = pairs.into_iter().filter(|pair| !known(pair)).collect();
    if fresh.len() <= count {
        return fresh;
    }
    // Both ends included: they hold the maps best.
    let last = count.saturating_sub(1).max(1);
    (0..count).map(|k| fresh[k * (fresh.len() - 1) / last]).collect()
}
