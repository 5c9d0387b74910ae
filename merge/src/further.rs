//! More closures between two maps whose motion is known from a first one.
//!
//! One closure is a hypothesis of how the maps lie to each other. It says which other keyframes see the same, so no
//! place recognition is needed to test it: they are aligned on their images from where it puts them, and pairwise
//! consistency (Mangelson et al. 2018) keeps those that agree with each other. A right hypothesis gains closures all
//! along both maps, a wrong one fails nearly everywhere but where it came from: what became of the pairs is evidence
//! for [`acceptance`](crate::acceptance), and so is what the keyframes see that they should not see, or miss.

mod edges;
mod view_pairs;

pub use view_pairs::worth_trying;
use view_pairs::{overlapping, spread};

use crate::closure::Closure;
use crate::direct::refine_directly;
use crate::place_verdict::{PlaceParams, PlaceVerdict, place_verdict};
use crate::prepared::PreparedMap;
use backend::posegraph::{ConsistencyParams, MapGraph, PoseGraphError, consistent_set};
use backend::sim3_align::{
    CompareParams, Comparison, PatchComparison, PatchParams, Sim3AlignParams, compare, compare_patches,
};
use edges::{allow, edge, information_at, motion_by, nearest, nearest_motion};
use geometry::Sim3;
use map::{Edge, KeyframeId};
use nalgebra::SMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// How further closures are looked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FurtherParams {
    /// Most further closures that are tried, spread evenly over the source's keyframes that qualify. Default 8; 0 or
    /// more, 0 for none. More make the joint map better where the maps drift, at some 30 ms each.
    pub max_closures: usize,
    /// Least share of a keyframe's points that the other keyframe must see, by the motion. Default 0.5; 0 to 1.
    pub min_overlap: f64,
    /// Largest angle between the rays from both keyframes to a point that still counts as seen, degrees. Default 40;
    /// 0 to 180. From farther aside a surface looks different, so that images of the same place cannot be aligned either
    /// (half of what detectors find is lost there: Mikolajczyk et al., "A Comparison of Affine Region Detectors", IJCV
    /// 2005, §4), and from behind it is another one.
    pub max_view_angle: f64,
    /// Alignment of the images.
    pub direct: Sim3AlignParams,
    /// What keyframes see at a given motion.
    pub compare: CompareParams,
    /// What of each keyframe is not in the other, patch by patch.
    pub patches: PatchParams,
    /// Whether what both saw of the surface is of one place.
    pub place: PlaceParams,
    /// How far right closures may be off beyond their stated uncertainty, because keyframes share the errors of their
    /// depths with their neighbours: translation in parts of the keyframe's median distance, rotation in radians, scale
    /// in parts. Default 0.01, 0.005 and 0.01, as within one closure; above 0.
    pub drift: [f64; 3],
    /// Which of the closures agree.
    pub consistency: ConsistencyParams,
}

impl Default for FurtherParams {
    fn default() -> Self {
        Self {
            max_closures: 8,
            min_overlap: 0.5,
            max_view_angle: 40.0,
            direct: Sim3AlignParams {
                coarsest_level: 3,
                // As for the first closure.
                max_reciprocal_error: 12.0,
                max_points: 3000,
                ..Sim3AlignParams::default()
            },
            compare: CompareParams::default(),
            patches: PatchParams::default(),
            place: PlaceParams::default(),
            drift: [0.01, 0.005, 0.01],
            consistency: ConsistencyParams::default(),
        }
    }
}

/// All closures between two maps that agree with each other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Joined {
    /// Merge edges from keyframes of the target to keyframes of the source.
    pub edges: Vec<Edge>,
    /// Edges that do not agree with the others.
    pub rejected: Vec<Edge>,
    /// Further pairs that were tried: of those that should overlap, at most
    /// [`max_closures`](FurtherParams::max_closures).
    #[serde(rename = "tried")]
    pub tested: usize,
    /// Of these, the pairs that could not be aligned.
    pub failed: usize,
    /// Of these, the pairs that were aligned and agree with the others.
    pub confirmed: usize,
    /// The size of the largest set among the rejected ones whose members agree with each other.
    pub rival: usize,
    /// What the keyframes of the first closure and of all pairs tried see of each other, both ways: those that agree
    /// at their own alignment, the others at the motion of the first closure.
    pub seen: Comparison,
    /// The same patch by patch, of those that agree.
    pub patches: PatchComparison,
    /// What those that agree saw of the surface; nothing where that was not asked.
    pub place: Option<PlaceVerdict>,
    /// What the further pairs that agree know of the closure's motion where its keyframes are: information that adds to that of
    /// [`Closure::at_keyframes`].
    pub information: SMatrix<f64, 7, 7>,
}

/// The edges of a first closure and of further ones along the maps, as far as they agree.
///
/// # Errors
/// When a pose of a map is no number, or its keyframes make no graph.
pub fn join(
    source: &PreparedMap,
    target: &PreparedMap,
    first: &Closure,
    params: &FurtherParams,
) -> Result<Joined, PoseGraphError> {
    let motion = &first.motion.a_from_b;
    let mut edges: Vec<Edge> = first
        .consistent_pairs()
        .filter_map(|pair| {
            let direct =
                pair.direct.as_ref().and_then(|direct| direct.as_ref().ok()).map(|direct| direct.estimate);
            let measured = pair.measured.as_ref().ok().map(|pair| pair.estimate());
            Some(edge(pair.source, pair.target, direct.or(measured)?))
        })
        .collect();
    let pairs = worth_trying(source.glimpses(), target.glimpses(), motion, &edges, params);
    let own = edges.iter().map(|edge| (edge.to, edge.from));
    let looked_at: Vec<(KeyframeId, KeyframeId)> = own.chain(pairs.iter().copied()).collect();
    let found = align(source, target, motion, &pairs, params);
    edges.iter_mut().for_each(|edge| allow(edge, target, &params.drift));
    let joined = Joined { edges, ..Joined::nothing() };
    add(source, target, first, joined, TestedPairs { pairs, found, looked_at }, params)
}

/// What a closure joins once maps have grown: to the edges of `before`, which hold as long as their keyframes' depths are as they were,
/// come those of keyframes that were not there, `fresh` ones of the source and of the target; so a keyframe costs an alignment or two,
/// however long the maps are. They are sought from where the nearest edge puts them, at most
/// [`max_closures`](FurtherParams::max_closures) at a time.
///
/// # Errors
/// As [`join`].
pub fn extend(
    source: &PreparedMap,
    target: &PreparedMap,
    first: &Closure,
    before: &Joined,
    fresh: [&BTreeSet<KeyframeId>; 2],
    params: &FurtherParams,
) -> Result<Joined, PoseGraphError> {
    let pairs = fresh_pairs(source, target, before, fresh, params);
    let aligned = |&pair: &(KeyframeId, KeyframeId)| {
        let motion = nearest_motion(source, target, &before.edges, pair)?;
        aligned(source, target, &motion, pair, params)
    };
    let found = pairs.par_iter().map(aligned).collect();
    let tested = TestedPairs { looked_at: pairs.clone(), pairs, found };
    add(source, target, first, before.clone(), tested, params)
}

/// Pairs of keyframes that were tried.
struct TestedPairs {
    /// They, of the source and of the target.
    pairs: Vec<(KeyframeId, KeyframeId)>,
    /// The edge of each, where it could be aligned.
    found: Vec<Option<Edge>>,
    /// Those of which it is looked at what they see of each other, which those of the first closure are among once.
    looked_at: Vec<(KeyframeId, KeyframeId)>,
}

/// What was joined with the edges of further pairs, as far as all agree.
fn add(
    source: &PreparedMap,
    target: &PreparedMap,
    first: &Closure,
    before: Joined,
    TestedPairs { pairs, found, looked_at }: TestedPairs,
    params: &FurtherParams,
) -> Result<Joined, PoseGraphError> {
    let motion = &first.motion.a_from_b;
    let failed = before.failed + found.iter().filter(|edge| edge.is_none()).count();
    let mut edges = before.edges;
    edges.extend(before.rejected);
    let known = edges.len();
    edges.extend(found.into_iter().flatten());
    edges[known..].iter_mut().for_each(|edge| allow(edge, target, &params.drift));
    let (source_nodes, target_nodes) = (nodes(source), nodes(target));
    let from = MapGraph { nodes: &target_nodes, edges: &target.map().edges };
    let to = MapGraph { nodes: &source_nodes, edges: &source.map().edges };
    let consistent = consistent_set(&edges, from, to, &params.consistency)?;
    let pick = |indices: &[usize]| indices.iter().map(|&index| edges[index].clone()).collect();
    let selected: Vec<Edge> = pick(&consistent.selected);
    let seen = looked_at.par_iter().map(|&pair| {
        let edge = selected.iter().find(|edge| (edge.to, edge.from) == pair);
        let there =
            edge.map(|edge| edge.from_from_to).or_else(|| hypothesis(source, target, motion, pair))?;
        see(source, target, pair, &there, &params.compare)
    });
    let seen = seen.flatten().collect::<Vec<_>>().into_iter().fold(before.seen, Comparison::plus);
    let is_looked_at = |edge: &&Edge| looked_at.contains(&(edge.to, edge.from));
    let patches = selected.par_iter().filter(is_looked_at);
    let patches = patches.filter_map(|edge| see_patches(source, target, edge, params));
    let patches = patches.collect::<Vec<_>>().into_iter().fold(before.patches, PatchComparison::plus);
    let place = before.place.unwrap_or_else(|| place_verdict(source, target, &selected, &params.place));
    let is_own =
        |edge: &Edge| first.consistent_pairs().any(|pair| (pair.source, pair.target) == (edge.to, edge.from));
    let confirmed: Vec<&Edge> = selected.iter().filter(|edge| !is_own(edge)).collect();
    let target_from_world = first.poses.target_world_from_target.inverse();
    let from_edge = |edge: &Edge| Some(target_from_world * target.world_from(edge.from)?);
    Ok(Joined {
        rejected: pick(&consistent.rejected),
        tested: before.tested + pairs.len(),
        failed,
        confirmed: confirmed.len(),
        rival: consistent.rival,
        seen,
        patches,
        place: Some(place),
        information: information_at(&confirmed, from_edge),
        edges: selected,
    })
}

impl Joined {
    /// No edge, and nothing looked at.
    pub(crate) fn nothing() -> Self {
        Self {
            edges: Vec::new(),
            rejected: Vec::new(),
            tested: 0,
            failed: 0,
            confirmed: 0,
            rival: 0,
            seen: Comparison::default(),
            patches: PatchComparison::default(),
            place: None,
            information: SMatrix::zeros(),
        }
    }
}

/// Pairs of keyframes that were not there with those of the other map that see most of the same, where that is enough.
fn fresh_pairs(
    source: &PreparedMap,
    target: &PreparedMap,
    before: &Joined,
    [of_source, of_target]: [&BTreeSet<KeyframeId>; 2],
    params: &FurtherParams,
) -> Vec<(KeyframeId, KeyframeId)> {
    let from_source = source.glimpses().iter().filter(|glimpse| of_source.contains(&glimpse.id));
    let from_source = from_source.filter_map(|glimpse| {
        let motion = motion_by(source, target, nearest(&before.edges, |edge| edge.to, glimpse.id)?)?;
        overlapping(std::slice::from_ref(glimpse), target.glimpses(), &motion, params).pop()
    });
    let from_target = target.glimpses().iter().filter(|glimpse| of_target.contains(&glimpse.id));
    let from_target = from_target.filter_map(|glimpse| {
        let motion = motion_by(source, target, nearest(&before.edges, |edge| edge.from, glimpse.id)?)?;
        let found = overlapping(std::slice::from_ref(glimpse), source.glimpses(), &motion.inverse(), params);
        found.last().map(|&(target, source)| (source, target))
    });
    let mut pairs: Vec<(KeyframeId, KeyframeId)> = from_source.chain(from_target).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let known: Vec<Edge> = before.edges.iter().chain(&before.rejected).cloned().collect();
    spread(pairs, params.max_closures, &known)
}

/// The edges of pairs that can be aligned from where the motion of the maps puts them; of those that cannot, from where
/// the nearest one that could puts them. Maps drift: far from the first closure its motion is no start.
fn align(
    source: &PreparedMap,
    target: &PreparedMap,
    motion: &Sim3,
    pairs: &[(KeyframeId, KeyframeId)],
    params: &FurtherParams,
) -> Vec<Option<Edge>> {
    let align = |motion: &Sim3, pair| aligned(source, target, motion, pair, params);
    let first: Vec<Option<Edge>> = pairs.par_iter().map(|&pair| align(motion, pair)).collect();
    let nearest = |index: usize| {
        let found = first
            .iter()
            .enumerate()
            .filter_map(|(other, edge)| Some((other.abs_diff(index), edge.as_ref()?)));
        // Of two as near the earlier.
        let (_, edge) = found.reduce(|best, next| if next.0 < best.0 { next } else { best })?;
        motion_by(source, target, edge)
    };
    let again = |(index, edge): (usize, &Option<Edge>)| {
        edge.clone().or_else(|| align(&nearest(index)?, pairs[index]))
    };
    first.par_iter().enumerate().map(again).collect()
}

/// The edge of a pair, aligned from where a motion of the maps puts it.
fn aligned(
    source: &PreparedMap,
    target: &PreparedMap,
    motion: &Sim3,
    (i, j): (KeyframeId, KeyframeId),
    params: &FurtherParams,
) -> Option<Edge> {
    let start = hypothesis(source, target, motion, (i, j))?;
    let found = refine_directly(source.get(i)?, target.get(j)?, &[start], &params.direct).ok()?;
    Some(edge(i, j, found.estimate))
}

/// target_from_source of two keyframes by the motion of the maps.
fn hypothesis(
    source: &PreparedMap,
    target: &PreparedMap,
    target_world_from_source_world: &Sim3,
    (i, j): (KeyframeId, KeyframeId),
) -> Option<Sim3> {
    Some(target.world_from(j)?.inverse() * *target_world_from_source_world * source.world_from(i)?)
}

/// What two keyframes see of each other, both ways.
fn see(
    source: &PreparedMap,
    target: &PreparedMap,
    (i, j): (KeyframeId, KeyframeId),
    target_from_source: &Sim3,
    params: &CompareParams,
) -> Option<Comparison> {
    let (a, b) = (source.get(i)?.view(), target.get(j)?.view());
    let there = compare(a, b, target_from_source, params);
    Some(there.plus(compare(b, a, &target_from_source.inverse(), params)))
}

/// What of the keyframes of an edge is not in the other, both ways.
fn see_patches(
    source: &PreparedMap,
    target: &PreparedMap,
    edge: &Edge,
    params: &FurtherParams,
) -> Option<PatchComparison> {
    let (a, b) = (source.get(edge.to)?.view(), target.get(edge.from)?.view());
    let (there, back) = (edge.from_from_to, edge.from_from_to.inverse());
    let found = compare_patches(a, b, &there, &params.compare, &params.patches);
    Some(found.plus(compare_patches(b, a, &back, &params.compare, &params.patches)))
}

fn nodes(map: &PreparedMap) -> BTreeMap<KeyframeId, Sim3> {
    map.map().keyframes.iter().map(|(id, keyframe)| (*id, keyframe.world_from_keyframe)).collect()
}

#[cfg(test)]
mod tests;
