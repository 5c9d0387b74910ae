//! A frame found in the map: where it should be, or among the keyframes that look like it.

use super::NEAR;
use crate::align::{Alignment, AlignmentReference, Brightness, ReferencePoint};
use crate::local_map::{LocalMap, PointRef};
use crate::params::Params;
use crate::relocalise::relocalise;
use crate::track::{self, Matched, Near, View};
use geometry::sensor::Twist;
use geometry::{Pyramid, Se3, median};
use map::PlaceIndex;
use std::collections::{BTreeMap, BTreeSet};

/// Standard deviations by which more points agree with a pose than do by chance, of counts that are nearly Poisson's.
const SIGNIFICANT: f32 = 3.0;

/// Columns and rows of the parts that an image is divided into to tell how much of it shows points.
const PARTS: (usize, usize) = (8, 6);

/// A frame's pose with the matches it rests on.
pub(crate) struct Located {
    pub camera_from_world: Se3,
    pub matched: Vec<Matched>,
    pub searched: Vec<PointRef>,
    pub inliers: usize,
    /// Those of them whose depth is known: what tells the scale of a motion.
    pub known: usize,
    /// Parts of the image (see [`PARTS`]) in which a point agrees with the pose.
    pub covered: usize,
    /// Median of the squared residuals over what was assumed.
    pub residual_scale: f64,
    pub(super) brightness: Brightness,
    pub(super) hosts: Vec<usize>,
    /// How the camera moves, in map units.
    pub motion: Twist,
    /// Its mean motion since the frame before.
    pub mean_motion: Twist,
    /// Whether it took a wide search: the camera was not where it should have been, or looks at little that is known.
    pub(super) wide_search: bool,
}

impl Located {
    /// Whether more points agree with the pose than do by chance, and enough of them carry the scale.
    pub(super) fn is_good(&self, params: &Params) -> bool {
        let chance = by_chance(params) * self.searched.len() as f32;
        self.carries_scale(params) && self.inliers as f32 >= chance + SIGNIFICANT * chance.sqrt()
    }

    /// Whether enough agree for a frame that was not where it should be. A frame placed wrongly poisons the map, and what is
    /// sought in many places agrees with one of them by chance sooner than with one pose.
    pub(super) fn is_found_again(&self, params: &Params) -> bool {
        let p = &params.keyframes;
        self.inliers >= 2 * p.min_matched
            && self.inlier_share() >= p.found_again
            && self.carries_scale(params)
    }

    /// Whether enough points of known depth agree. The others tell how the camera turned; going on by them would make up the
    /// length of its way, and all that is mapped from there with it.
    pub(super) fn carries_scale(&self, params: &Params) -> bool {
        self.known >= params.keyframes.min_matched
    }

    /// Share of the sought points that agree with the pose.
    pub fn inlier_share(&self) -> f32 {
        self.inliers as f32 / self.searched.len().max(1) as f32
    }

    /// Standard deviation of the camera's position along the axis that is known least, over the median depth of the points that agree.
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

/// Share of the sought points that agree with any pose. Where patches proved to be placed to no better than a pixel, more of
/// them do, by chance or with a map that is wrong: twice as many as where they are exact.
fn by_chance(params: &Params) -> f32 {
    params.keyframes.chance * (1.0 + params.track.position_sigma)
}

/// Pose and matches of a frame that becomes a keyframe, whose observations stay in the map.
///
/// The points are sought once more although tracking has just found them: it chose and warped them by the pose of
/// the direct alignment, here by the refined one, so that other points are chosen and patches are warped and begun
/// where they belong. Other matches come of it even with as many points per cell.
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

/// The keyframes that look at about what a keyframe looks at, at this inverse depth.
pub(super) fn near(map: &LocalMap, keyframe: usize, inverse_depth: f64) -> Vec<Near> {
    let near = map.around(keyframe, 1.0 / inverse_depth, NEAR);
    near.into_iter().map(|keyframe| Near::of(map, keyframe)).collect()
}

/// The motion of a camera of which none is known.
fn unmoved(_: &Se3) -> (Twist, f64) {
    (Twist::zeros(), 0.0)
}

/// Finds a directly aligned frame's pose by the points of the map; `motion` tells how a camera moves that is at a pose now,
/// and how uncertain its turn is, radians a second.
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
    let found = if map.sensor.is_rolling() { matched.clone() } else { Vec::new() };
    let (mut camera_from_world, mut residual_scale) = track::refine_pose(map, view, &mut matched);
    let (mut better, rotation_sigma) = motion(&camera_from_world);
    if map.sensor.is_rolling() && better != view.motion {
        matched.clone_from(&found);
        let view = View { camera_from_world, motion: better, ..*view };
        (camera_from_world, residual_scale) = track::refine_pose(map, &view, &mut matched);
        if rotation_sigma > 0.0 {
            let view = View { camera_from_world, ..view };
            better = track::motion_by_rows(map, &view, &matched, rotation_sigma);
            matched = found;
            (camera_from_world, residual_scale) =
                track::refine_pose(map, &View { motion: better, ..view }, &mut matched);
        }
    }
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
    }
}

/// Agreeing matches with points of known depth. A map of two keyframes has no scale but that of its own depths, which all count
/// therefore: what is mapped after them may lose it.
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

/// Seeks a lost frame among the keyframes it was last near and those that look like it.
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
