//! Whether two keyframes show one place: tests from the cheapest to the surest.

use super::drift::{self, Drift, Trajectory};
use super::join::{SideMatch, match_side};
use super::{ClosingParams, FoundLoop};
use crate::align::{AlignmentReference, Brightness};
use crate::local_map::LocalMap;
use crate::loops::{self, LoopCandidate, LoopRefusal};
use crate::params::Params;
use crate::publish;
use crate::track;
use backend::posegraph::PoseGraphError;
use backend::sim3_align::KeyframeView;
use geometry::{Pyramid, Se3, Sim3, median};
use map::{Rectified, SemiDense};
use thiserror::Error;

/// A loop to be tested.
pub(super) struct Proposal {
    /// The newer keyframe.
    pub keyframe: usize,
    /// The older one.
    pub candidate: LoopCandidate,
}

/// Why a proposed loop was not closed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum NoLoop {
    /// Too few of the old side's points are found in the keyframe.
    #[error("{found} of {searched} points of the old place are found")]
    FewMatches {
        /// Matches that agree with one pose.
        found: usize,
        /// Points sought.
        searched: usize,
    },
    /// Too few points have a depth on both sides.
    #[error("too few points have a depth on both sides to compare the scales")]
    NoScale,
    /// The neighbours of the keyframe do not see the old place where they should.
    #[error("the keyframe's neighbours do not see the old place")]
    Unconfirmed,
    /// The reciprocal alignment failed.
    #[error(transparent)]
    Refused(#[from] LoopRefusal),
    /// More drift than the path can explain.
    #[error(transparent)]
    TooFar(#[from] Drift),
    /// The pose graph cannot be optimised.
    #[error("the pose graph cannot be optimised: {0}")]
    Graph(PoseGraphError),
    /// The joint optimisation gave up what the loop had joined.
    #[error("{left} of {joined} observations across the loop agree with the rest of the map")]
    TakenBack {
        /// Observations across when the loop was closed.
        joined: usize,
        /// Those left after the joint optimisation.
        left: usize,
    },
    /// The rest of the map speaks against the loop.
    #[error("the rest of the map speaks against the loop")]
    Contradicted,
}

/// Puts a proposal to the test.
pub(super) fn test(local: &LocalMap, proposal: &Proposal, params: &Params) -> Result<FoundLoop, NoLoop> {
    let p = &params.closing;
    let current = proposal.keyframe;
    let old = proposal.candidate.keyframe.0 as usize;
    let (new_side, old_side) = (side(local, current, old, p.side), side(local, old, current, p.side));

    let guess = align(local, current, old, &proposal.candidate, params);
    let seen = match_side(local, &old_side, current, guess, &params.track);
    if !seen.is_good(p.min_matched, p.min_share) {
        return Err(NoLoop::FewMatches { found: seen.inliers().count(), searched: seen.searched.len() });
    }
    let [current_scale, old_scale] = [current, old].map(|k| local.keyframes[k].scale);
    let scale =
        current_scale * scale(local, &seen, &local.keyframes[current].semi_dense).ok_or(NoLoop::NoScale)?;
    let relative = seen.camera_from_world * local.keyframes[old].camera_from_world.inverse();
    let start = Sim3::new(
        relative.rotation,
        relative.translation * scale / current_scale,
        scale * old_scale / current_scale,
    );
    let trajectory = Trajectory::until(local, current);
    let path_length =
        trajectory.between(LocalMap::id(old), LocalMap::id(current)).map_or(0.0, |[_, path]| path);
    let poses = [old, current].map(|k| local.world_from_keyframe(k));
    let drift_check =
        |current_from_old: &Sim3| drift::check(poses, &current_from_old.inverse(), path_length, p);
    drift_check(&start)?;
    if !is_confirmed(local, &new_side, &old_side, &seen.camera_from_world, scale, params) {
        return Err(NoLoop::Unconfirmed);
    }
    let candidate = LoopCandidate { current_from_old: vec![start], ..proposal.candidate.clone() };
    let edge = reciprocal(local, [current, old], &candidate, p)?;
    drift_check(&edge.from_from_to)?;
    Ok(FoundLoop { edge, new_side, old_side })
}

/// A keyframe and those that see the same, as far as they are nearer in time to it than to the `other` end.
pub(super) fn side(local: &LocalMap, keyframe: usize, other: usize, count: usize) -> Vec<usize> {
    let mut side = vec![keyframe];
    let near = local.covisible(keyframe).into_iter().map(|c| c.0);
    side.extend(near.filter(|k| k.abs_diff(keyframe) < k.abs_diff(other)).take(count.saturating_sub(1)));
    side
}

/// The current keyframe's pose were it to see the old place, in the scale of the old side: direct alignment
/// with the old keyframe's points.
fn align(local: &LocalMap, current: usize, old: usize, candidate: &LoopCandidate, params: &Params) -> Se3 {
    let state = &local.keyframes[old];
    let points = local.reference_points(old);
    let reference = AlignmentReference::new(&state.pyramid, &local.camera, &points, &params.align);
    let in_old_scale = |guess: &Sim3| {
        let guess = drift::in_world_units(local, current, old, guess);
        Se3::new(guess.rotation, guess.translation / guess.scale)
    };
    let guesses: Vec<Se3> = candidate.current_from_old.iter().map(in_old_scale).collect();
    let aligned = track::align_from_guesses(
        &reference,
        &local.keyframes[current].pyramid,
        &guesses,
        Brightness::default(),
        params.relocalise.min_inlier_share,
    );
    aligned.frame_from_reference * state.camera_from_world
}

/// Units of the keyframe that has the `depth` per unit of the world at the old side: the median ratio of the depths of
/// the points both know.
fn scale(local: &LocalMap, seen: &SideMatch, depth: &SemiDense) -> Option<f64> {
    const MIN_POINTS: usize = 12;
    let mut ratios: Vec<f32> = seen
        .inliers()
        .filter_map(|m| {
            let point = local.point(m.at);
            let relative = seen.camera_from_world * local.keyframes[m.at.host].camera_from_world.inverse();
            let x = relative.rotation * point.ray + relative.translation * point.inverse_depth;
            let old_depth = (x.z / point.inverse_depth) as f32;
            Some(1.0 / (inverse_depth_near(depth, m.pixel, local.camera.width)? * old_depth))
        })
        .filter(|ratio| ratio.is_finite() && *ratio > 0.0)
        .collect();
    (ratios.len() >= MIN_POINTS).then(|| median(&mut ratios).map(f64::from)).flatten()
}

/// The surest inverse depth of the 5 × 5 pixels around a position.
fn inverse_depth_near(depth: &SemiDense, pixel: [f32; 2], width: usize) -> Option<f32> {
    let [x, y] = pixel.map(|v| v.round() as i64);
    let around = (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (x + dx, y + dy)));
    around
        .filter(|&(x, y)| x >= 0 && y >= 0 && x < width as i64)
        .filter_map(|(x, y)| depth.pixel.binary_search(&((y * width as i64 + x) as u32)).ok())
        .min_by(|&a, &b| depth.variance[a].total_cmp(&depth.variance[b]))
        .map(|i| depth.inverse_depth[i])
}

/// Whether a neighbour of the keyframe sees the old place too, where the loop and the map put it. A second
/// view from elsewhere tells a place from its look-alike, and a right scale from a wrong one.
fn is_confirmed(
    local: &LocalMap,
    new_side: &[usize],
    old_side: &[usize],
    current_from_world: &Se3,
    scale: f64,
    params: &Params,
) -> bool {
    let p = &params.closing;
    let current = &local.keyframes[new_side[0]].camera_from_world;
    new_side[1..].iter().take(3).any(|&neighbour| {
        let relative = local.keyframes[neighbour].camera_from_world * current.inverse();
        let in_old_scale = Se3::new(relative.rotation, relative.translation / scale);
        let seen = match_side(local, old_side, neighbour, in_old_scale * *current_from_world, &params.track);
        seen.is_good(p.min_matched / 2, p.min_share)
    })
}

/// The alignment of the two keyframes' images and depths both ways.
fn reciprocal(
    local: &LocalMap,
    [current, old]: [usize; 2],
    candidate: &LoopCandidate,
    params: &ClosingParams,
) -> Result<map::Edge, NoLoop> {
    let view = |keyframe: usize| {
        let state = &local.keyframes[keyframe];
        match map::rectified(&publish::keyframe(local, keyframe), &local.sensor, &state.motion) {
            None => KeyframeView::new(&state.pyramid, &state.semi_dense, &local.camera),
            Some(Rectified { keyframe, .. }) => {
                let pyramid = Pyramid::of(keyframe.image, state.pyramid.len());
                KeyframeView::new(&pyramid, &keyframe.semi_dense, &local.camera)
            }
        }
    };
    let (current_view, old_view) = (view(current), view(old));
    let closed = loops::close((LocalMap::id(current), &current_view), &old_view, candidate, &params.search)?;
    Ok(closed.edge)
}
