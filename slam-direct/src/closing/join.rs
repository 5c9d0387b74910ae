//! Finding the points of one side of a loop in the keyframes of the other.

use crate::local_map::{LocalMap, Matched, PointRef};
use crate::mapping;
use crate::track::{self, TrackParams, View};
use geometry::Se3;

/// Points of some keyframes found in another, and the pose that agrees best with them.
pub(crate) struct SideMatch {
    pub camera_from_world: Se3,
    pub matched: Vec<Matched>,
    pub searched: Vec<PointRef>,
}

impl SideMatch {
    /// Matches that agree with the pose.
    pub fn inliers(&self) -> impl Iterator<Item = &Matched> {
        self.matched.iter().filter(|m| m.inlier)
    }

    /// Whether enough was found.
    pub fn is_good(&self, min_matched: usize, min_share: f32) -> bool {
        let inliers = self.inliers().count();
        inliers >= min_matched && inliers as f32 >= min_share * self.searched.len() as f32
    }
}

/// Seeks the points of `hosts` in a keyframe, were it at `camera_from_world`.
pub(crate) fn match_side(
    map: &LocalMap,
    hosts: &[usize],
    keyframe: usize,
    camera_from_world: Se3,
    params: &TrackParams,
) -> SideMatch {
    let state = &map.keyframes[keyframe];
    let view = View { pyramid: &state.pyramid, camera_from_world, motion: state.motion_in_world() };
    let (mut matched, searched) = track::match_points(map, hosts, &view, params, params.per_cell);
    let (camera_from_world, _) = track::refine_pose(map, &view, &mut matched);
    SideMatch { camera_from_world, matched, searched }
}

/// Lets the keyframes of each side observe the other side's points.
pub(super) fn join(map: &mut LocalMap, new: &[usize], old: &[usize], params: &TrackParams) {
    for (observers, hosts) in [(new, old), (old, new)] {
        for &keyframe in observers {
            let pose = map.keyframes[keyframe].camera_from_world;
            let side = match_side(map, hosts, keyframe, pose, params);
            mapping::add_observations(map, keyframe, &side.matched);
        }
    }
}

/// Observations of each side's living points by keyframes of the other.
pub(super) fn across(map: &LocalMap, new: &[usize], old: &[usize]) -> usize {
    let by = |observers: &[usize], hosts: &[usize]| -> usize {
        let seen = observers.iter().flat_map(|&keyframe| &map.keyframes[keyframe].seen);
        seen.filter(|at| hosts.contains(&at.host) && map.point(**at).alive).count()
    };
    by(new, old) + by(old, new)
}
