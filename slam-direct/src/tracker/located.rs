//! A frame found in the map: at its predicted pose, or among the keyframes that look like it.

use super::NEAR;
use crate::align::{Alignment, AlignmentReference, Brightness, ReferencePoint};
use crate::local_map::{LocalMap, Matched, PointRef};
use crate::params::Params;
use crate::relocalise::relocalise;
use crate::rival::{Agreement, agreement};
use crate::track::{self, Near, View};
use geometry::sensor::Twist;
use geometry::{Pyramid, Se3, median};
use map::PlaceIndex;
use nalgebra::Matrix6;
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviations by which more points agree with a pose than do by chance, of counts that are nearly Poisson's.
const SIGNIFICANT: f32 = 3.0;

/// Share of the points of known depth from which on a pose is not theirs: more of them disagree with it than agree, by the information that they
/// were found with, which [`refine_pose`](track::refine_pose) lowers to what the frame shows. Of frames that are right 0.4 do at the most.
const MOST: f32 = 0.5;

/// Columns and rows of the parts that an image is divided into to tell how much of it shows points.
const PARTS: (usize, usize) = (8, 6);

/// A frame's pose with the matches it rests on.
pub(crate) struct Located {
    pub camera_from_world: Se3,
    pub matched: Vec<Matched>,
    pub searched: Vec<PointRef>,
    pub inliers: usize,
    /// Inliers whose depth is known: they determine the scale of a motion.
    pub known: usize,
    /// Parts of the image (see [`PARTS`]) in which a point agrees with the pose.
    pub covered: usize,
    /// Median of the squared residuals over the assumed one.
    pub residual_scale: f64,
    /// How its points of known depth agree with the pose, which may be that of either of two motions, or between them.
    pub(super) agreement: Agreement,
    pub(super) brightness: Brightness,
    pub(super) hosts: Vec<usize>,
    /// Motion of the camera, in map units.
    pub motion: Twist,
    /// Its mean motion since the frame before.
    pub mean_motion: Twist,
    /// Whether it took a wide search: the camera was not at its predicted pose, or little of the view is known.
    pub(super) wide_search: bool,
}

impl Located {
    /// Whether more points agree with the pose than do by chance, and enough of them carry the scale.
    pub(super) fn is_good(&self, params: &Params) -> bool {
        let chance = by_chance(params) * self.searched.len() as f32;
        self.carries_scale(params) && self.inliers as f32 >= chance + SIGNIFICANT * chance.sqrt()
    }

    /// Whether enough points agree for a frame that was not at its predicted pose. A wrongly placed frame spoils the
    /// map, and points that are searched in many places agree with one of them by chance sooner than with one pose.
    pub(super) fn is_found_again(&self, params: &Params) -> bool {
        let p = &params.keyframes;
        self.inliers >= 2 * p.min_matched
            && self.inlier_share() >= p.found_again
            && self.carries_scale(params)
            && self.is_of_most()
    }

    /// Whether the pose is that of most points of known depth. Between two motions nearly all agree with it to what the frame shows, and most
    /// disagree by what they were found with. Where motion led to the frame, a jolt that bends its rows does the same.
    pub fn is_of_most(&self) -> bool {
        self.agreement.against < MOST
    }

    /// Whether enough points of known depth agree. The others determine only the rotation; continuing with them would
    /// invent the length of the motion, and of all that is mapped from there.
    pub(super) fn carries_scale(&self, params: &Params) -> bool {
        self.known >= params.keyframes.min_matched
    }

    /// Share of the searched points that agree with the pose.
    pub fn inlier_share(&self) -> f32 {
        self.inliers as f32 / self.searched.len().max(1) as f32
    }

    /// Covariance of the pose (see [`track::pose_covariance`]).
    pub fn covariance(&self, map: &LocalMap) -> Option<Matrix6<f64>> {
        track::pose_covariance(map, &self.camera_from_world, &self.motion, &self.matched)
    }

    /// Standard deviation of the camera's position along its least certain axis, over the median depth of the points
    /// that agree.
    pub fn position_deviation(&self, map: &LocalMap) -> f64 {
        track::position_deviation(map, &self.camera_from_world, &self.motion, &self.matched)
    }

    /// Root mean square photometric residual of the agreeing points, grey levels.
    pub fn rmse(&self) -> f32 {
        let sum: f32 = self.matched.iter().filter(|m| m.inlier).map(|m| m.rmse * m.rmse).sum();
        (sum / self.inliers.max(1) as f32).sqrt()
    }
}

/// Keyframes that see points that agree with a frame, those with most of them first: `(keyframe, points)`.
pub(super) fn covisible(map: &LocalMap, located: &Located) -> Vec<(usize, usize)> {
    let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
    for at in located.matched.iter().filter(|m| m.inlier).map(|m| m.at) {
        let watchers = map.point(at).observations.iter().map(|seen| seen.keyframe);
        watchers.chain([at.host]).for_each(|keyframe| *shared.entry(keyframe).or_default() += 1);
    }
    let mut all: Vec<(usize, usize)> = shared.into_iter().collect();
    all.sort_by(|a, b| b.1.cmp(&a.1).then(b.0.cmp(&a.0)));
    all
}

/// Share of the searched points that agree with any pose. Where patches are placed to no better than a pixel, more of
/// them do, by chance or with a wrong map: twice as many as where they are exact.
fn by_chance(params: &Params) -> f32 {
    params.keyframes.chance * (1.0 + params.track.position_sigma)
}

/// Pose and matches of a frame that becomes a keyframe, whose observations stay in the map.
///
/// The points are searched once more although tracking has just found them. Tracking chose and warped them by the
/// pose of the direct alignment, here by the refined one. So other points are chosen, and patches are warped and
/// started where they belong. This gives other matches even with as many points per cell.
pub(crate) fn match_keyframe(
    map: &LocalMap,
    pyramid: &Pyramid,
    located: &Located,
    params: &Params,
) -> (Se3, Vec<Matched>) {
    let view = View { pyramid, camera_from_world: located.camera_from_world, motion: located.motion };
    let per_cell = params.track.keyframe_per_cell;
    let (mut matched, _) = track::match_points(map, &located.hosts, &view, &params.track, per_cell);
    let (camera_from_world, _) = track::refine_pose(map, &view, &mut matched);
    (camera_from_world, matched)
}

/// The median; 1 without points.
pub(super) fn median_inverse_depth(points: &[ReferencePoint]) -> f64 {
    let mut depths: Vec<f32> = points.iter().map(|p| p.inverse_depth).collect();
    median(&mut depths).unwrap_or(1.0).into()
}

/// The keyframes with about the same view as a keyframe, at this inverse depth.
pub(super) fn near(map: &LocalMap, keyframe: usize, inverse_depth: f64) -> Vec<Near> {
    let near = map.around(keyframe, 1.0 / inverse_depth, NEAR);
    near.into_iter().map(|keyframe| Near::of(map, keyframe)).collect()
}

/// The motion of a camera if it is not known.
fn unmoved(_: &Se3) -> (Twist, f64) {
    (Twist::zeros(), 0.0)
}

/// Finds the pose of a directly aligned frame by the points of the map. `motion` gives the camera's motion at a pose,
/// and the standard deviation of its rotation, radians a second.
pub(super) fn locate(
    map: &LocalMap,
    near: &[Near],
    view: &View,
    motion: impl Fn(&Se3) -> (Twist, f64),
    brightness: Brightness,
    reference: usize,
    params: &Params,
) -> Located {
    let p = &params.track;
    let hosts = track::choose_hosts(map, near, &view.camera_from_world, reference, p.max_hosts);
    let (mut matched, searched) = track::match_points(map, &hosts, view, p, p.per_cell);
    let found = matched.clone();
    let (mut camera_from_world, mut residual_scale) = track::refine_pose(map, view, &mut matched);
    let (mut better, rotation_sigma) = motion(&camera_from_world);
    if map.sensor.is_rolling() && better != view.motion {
        matched.clone_from(&found);
        let view = View { camera_from_world, motion: better, ..*view };
        (camera_from_world, residual_scale) = track::refine_pose(map, &view, &mut matched);
        if rotation_sigma > 0.0 {
            let view = View { camera_from_world, ..view };
            better = track::motion_by_rows(map, &view, &matched, rotation_sigma);
            matched.clone_from(&found);
            (camera_from_world, residual_scale) =
                track::refine_pose(map, &View { motion: better, ..view }, &mut matched);
        }
    }
    let moved = View { camera_from_world, motion: better, ..*view };
    let agreement = agreement(map, &moved, &found, params);
    let inliers = matched.iter().filter(|m| m.inlier).count();
    let known = known_depths(map, &matched);
    let covered = covered(map, &matched);
    Located {
        camera_from_world,
        brightness,
        hosts,
        motion: better,
        mean_motion: Twist::zeros(),
        wide_search: false,
        matched,
        searched,
        inliers,
        known,
        covered,
        residual_scale,
        agreement,
    }
}

/// Number of agreeing matches with points of known depth. A map of two keyframes has only the scale of its own
/// depths, so all of them count; what is mapped after them may lose it.
fn known_depths(map: &LocalMap, matched: &[Matched]) -> usize {
    let is_first = map.keyframes.len() <= 2;
    matched.iter().filter(|m| m.inlier && (is_first || map.point(m.at).is_known())).count()
}

/// Parts of the image that hold an agreeing match.
fn covered(map: &LocalMap, matched: &[Matched]) -> usize {
    let (width, height) = (map.camera.width as f32, map.camera.height as f32);
    let mut parts = [false; PARTS.0 * PARTS.1];
    for m in matched.iter().filter(|m| m.inlier) {
        let column = (m.pixel[0].max(0.0) / width * PARTS.0 as f32) as usize;
        let row = (m.pixel[1].max(0.0) / height * PARTS.1 as f32) as usize;
        parts[row.min(PARTS.1 - 1) * PARTS.0 + column.min(PARTS.0 - 1)] = true;
    }
    parts.iter().filter(|part| **part).count()
}

/// Searches a lost frame among the keyframes it was last near and those that look like it.
pub(super) fn relocate(
    map: &LocalMap,
    places: &dyn PlaceIndex,
    pyramid: &Pyramid,
    reference: usize,
    params: &Params,
) -> Option<(usize, Located)> {
    let neighbours = map.covisible(reference).into_iter().map(|c| c.0).take(2);
    let similar = places.query(pyramid.base(), 4).into_iter().map(|c| c.keyframe.0 as usize);
    let mut tested = BTreeSet::new();
    [reference].into_iter().chain(similar).chain(neighbours).filter(|&k| tested.insert(k)).find_map(
        |candidate| {
            let points = map.reference_points(candidate);
            let near_candidate = near(map, candidate, median_inverse_depth(&points));
            let pyramid_there = &map.keyframes[candidate].pyramid;
            let alignment = AlignmentReference::new(pyramid_there, &map.camera, &points, &params.align);
            let found =
                relocalise(pyramid, [(LocalMap::id(candidate), &alignment)], &params.relocalise).ok()?;
            let Alignment { frame_from_reference, brightness, .. } = found.alignment;
            let camera_from_world = frame_from_reference * map.keyframes[candidate].camera_from_world;
            let view = View { pyramid, camera_from_world, motion: Twist::zeros() };
            let located = locate(map, &near_candidate, &view, unmoved, brightness, candidate, params);
            located.is_found_again(params).then_some((candidate, located))
        },
    )
}
