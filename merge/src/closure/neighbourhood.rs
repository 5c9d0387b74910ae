//! A closure from the keyframes around a place together, where no pair of them has matches enough alone.

use super::steps::{self, Chosen};
use super::{Closure, ClosureParams, ClosureRefusal, Pooled, Start, finish};
use crate::generalised_pose::{
    GeneralisedPose, GeneralisedPoseParams, Located, Match, Pool, Sighting, View, find_inliers,
    generalised_pose,
};
use crate::matching::match_features;
use crate::optimal_scale::{Basis, OptimalScale};
use crate::overlap::Glimpse;
use crate::pair::{Place, view_pair};
use crate::prepared::{PreparedKeyframe, PreparedMap};
use geometry::Sim3;
use map::KeyframeId;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the keyframes around a place are taken together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NeighbourhoodParams {
    /// Keyframes before and after the one of the place that are matched, in both maps. Default 2; at least 1. Every
    /// keyframe of the one with every one of the other: 25 pairs at 5 ms.
    pub radius: usize,
    /// The pose that all matches agree with.
    pub pose: GeneralisedPoseParams,
    /// Least share of the points of two keyframes that each must see of the other's, by that pose, to be aligned on their
    /// images. Default 0.2; 0 to 1.
    pub min_overlap: f64,
    /// Largest angle between the rays from both keyframes to a point that counts as seen, degrees. Default 60; 0 to 180. Smooth
    /// surfaces can be aligned from so far aside, and where they cannot the pair is left out.
    pub max_view_angle: f64,
}

impl Default for NeighbourhoodParams {
    fn default() -> Self {
        Self { radius: 2, pose: GeneralisedPoseParams::default(), min_overlap: 0.2, max_view_angle: 60.0 }
    }
}

/// How the keyframes around a place lie to each other by their matches.
#[derive(Clone, Debug, PartialEq)]
pub struct NeighbourhoodPose {
    /// The place.
    pub place: Place,
    /// The pose between its keyframes, target_from_source, with its evidence.
    pub pose: GeneralisedPose,
}

/// The pose that the keyframes around a place agree on.
///
/// # Errors
/// When too few matches agree with one, or a keyframe of the place is not in its map.
pub fn neighbourhood_pose(
    source: &PreparedMap,
    target: &PreparedMap,
    place: Place,
    params: &ClosureParams,
) -> Result<NeighbourhoodPose, ClosureRefusal> {
    let pool = pool(source, target, place, params).ok_or(ClosureRefusal::NoMotion)?;
    let pose = generalised_pose(&pool, &params.neighbourhood.pose)?;
    Ok(NeighbourhoodPose { place, pose })
}

/// Follows the pose of a neighbourhood through the steps after the first transform: the keyframes that see most of each
/// other by it are registered and aligned on their images.
///
/// # Errors
/// As [`close`](super::close), and when no two keyframes see enough of each other.
pub fn close_neighbourhood(
    source: &PreparedMap,
    target: &PreparedMap,
    found: &NeighbourhoodPose,
    params: &ClosureParams,
) -> Result<Closure, ClosureRefusal> {
    let NeighbourhoodPose { place, pose } = found;
    let worlds = source.world_from(place.source).zip(target.world_from(place.target));
    let (source_pose, target_pose) = worlds.ok_or(ClosureRefusal::NoMotion)?;
    let motion = target_pose * pose.estimate.a_from_b * source_pose.inverse();
    let best = overlapping(source, target, *place, &motion, &params.neighbourhood);
    let centre = *best.first().ok_or(ClosureRefusal::NoMotion)?;
    let views = [best.get(1), Some(&centre), best.get(2)].map(|pair| {
        let &(i, j) = pair?;
        Some((i, j, view_pair(source.get(i)?, target.get(j)?, &params.pair)))
    });
    let pairs = steps::measure(source, target, views, params);
    let (i, j) = centre;
    let (a, b) = source.world_from(i).zip(target.world_from(j)).ok_or(ClosureRefusal::NoMotion)?;
    let chosen = Chosen::at(source, target, centre, b.inverse() * motion * a, Vector3::zeros(), params)
        .ok_or(ClosureRefusal::NoMotion)?;
    let variance = pose.estimate.information.try_inverse().map_or(f64::INFINITY, |c| c[(6, 6)]);
    let scale = OptimalScale {
        scale: motion.scale,
        variance: variance * motion.scale * motion.scale,
        basis: Basis::Neighbourhood,
        used: [false; 3],
        scale_gap: 0.0,
        match_count: pose.distinct as f64,
    };
    let start = Start {
        keyframes: centre,
        travel: None,
        scales: steps::scales(source, target, &pairs),
        volume_ratio: steps::ratio_of_volumes(&chosen),
        pairs,
        index: 1,
        chosen,
        scale,
        pooled: Some(Pooled { matches: pose.distinct, ln_false_alarms: pose.ln_false_alarms }),
    };
    finish(source, target, start, params)
}

/// How many key points of two keyframes match and lie where a similarity target_from_source has them; 0 where one is not in
/// its map.
pub fn matches_at(
    source: &PreparedMap,
    target: &PreparedMap,
    place: Place,
    target_from_source: &Sim3,
    params: &ClosureParams,
) -> usize {
    let alone = ClosureParams {
        neighbourhood: NeighbourhoodParams { radius: 0, ..params.neighbourhood.clone() },
        ..params.clone()
    };
    let pool = pool(source, target, place, &alone);
    pool.map_or(0, |pool| find_inliers(&pool, target_from_source, &params.neighbourhood.pose).len())
}

/// All matches of the keyframes around a place, in the frames of its two keyframes.
fn pool(source: &PreparedMap, target: &PreparedMap, place: Place, params: &ClosureParams) -> Option<Pool> {
    let radius = params.neighbourhood.radius;
    let ids = [source.around(place.source, radius), target.around(place.target, radius)];
    let views = [views(source, place.source, &ids[0])?, views(target, place.target, &ids[1])?];
    let [of_source, of_target] = &ids;
    let all: Vec<(usize, usize)> =
        (0..of_source.len()).flat_map(|s| (0..of_target.len()).map(move |t| (s, t))).collect();
    let min_deviation = params.neighbourhood.pose.min_depth_deviation;
    let matches: Vec<Vec<Match>> = all
        .par_iter()
        .map(|&(s, t)| {
            let (Some(a), Some(b)) = (source.get(of_source[s]), target.get(of_target[t])) else {
                return Vec::new();
            };
            let found = match_features(&a.features, &b.features, &params.pair.matching);
            let pair = found.iter().map(|m| Match {
                sides: [
                    sighting(a, m.source, s, &views[0][s].side_from_view, min_deviation),
                    sighting(b, m.target, t, &views[1][t].side_from_view, min_deviation),
                ],
            });
            pair.filter(|m| m.sides.iter().any(|side| side.point.is_some())).collect()
        })
        .collect();
    Some(Pool { views, matches: matches.concat() })
}

/// Keyframes of a map in the frame of one of them.
fn views(map: &PreparedMap, centre: KeyframeId, ids: &[KeyframeId]) -> Option<Vec<View>> {
    let side_from_world = map.world_from(centre)?.inverse();
    let view =
        |id: &KeyframeId| Some(View::new(side_from_world * map.world_from(*id)?, map.get(*id)?.camera));
    ids.iter().map(view).collect()
}

/// What a keyframe knows of one of its features.
fn sighting(
    keyframe: &PreparedKeyframe,
    feature: u32,
    view: usize,
    side_from_view: &Sim3,
    min_deviation: f64,
) -> Sighting {
    let bearing = keyframe.bearings()[feature as usize];
    let located = |point: &crate::scale_filter::MeasuredPoint| {
        let relative = (point.covariance[(2, 2)].sqrt() / point.position.z).max(min_deviation);
        Located {
            position: *side_from_view * point.position,
            depth_deviation: side_from_view.rotation * point.position * (side_from_view.scale * relative),
        }
    };
    let point = keyframe.points()[feature as usize].as_ref().map(located);
    Sighting { view, feature, ray: bearing / bearing.z, point }
}

/// At most three pairs of the keyframes around a place that see most of each other by a motion of the worlds, each
/// keyframe once, most first.
fn overlapping(
    source: &PreparedMap,
    target: &PreparedMap,
    place: Place,
    target_world_from_source_world: &Sim3,
    params: &NeighbourhoodParams,
) -> Vec<(KeyframeId, KeyframeId)> {
    let (sources, targets) =
        (glimpses(source, place.source, params.radius), glimpses(target, place.target, params.radius));
    let min_cosine = params.max_view_angle.to_radians().cos();
    let mut seen: Vec<(f64, KeyframeId, KeyframeId)> = Vec::new();
    for i in &sources {
        for j in &targets {
            let share = i.overlap(j, target_world_from_source_world, min_cosine, params.min_overlap);
            seen.extend(share.map(|share| (share, i.id, j.id)));
        }
    }
    seen.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut best: Vec<(KeyframeId, KeyframeId)> = Vec::new();
    for (_, i, j) in seen {
        if best.len() < 3 && best.iter().all(|&(a, b)| a != i && b != j) {
            best.push((i, j));
        }
    }
    best
}

/// The keyframes around one that have depth.
fn glimpses<'a>(map: &PreparedMap<'a>, id: KeyframeId, radius: usize) -> Vec<Glimpse<'a>> {
    map.around(id, radius).iter().filter_map(|&id| Glimpse::of(map.map(), id)).collect()
}
