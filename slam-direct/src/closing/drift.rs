//! The drift that a loop may reveal: a place that is far away by the map is not one to come back to.

use super::ClosingParams;
use super::evidence::NoLoop;
use crate::local_map::LocalMap;
use geometry::{Se3, Sim3, median};
use map::{Edge, KeyframeId, Map};
use nalgebra::Vector3;
use thiserror::Error;

/// What a loop says against the map's own opinion of where a keyframe is.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error(
    "the loop would reveal a drift of {translation} over a way of {path_length}, {rotation_drift}° and scale {scale}"
)]
pub struct Drift {
    /// Drift of the position, map units.
    pub translation: f64,
    /// Length of the way between the keyframes, map units.
    pub path_length: f64,
    /// Drift of the orientation, degrees.
    pub rotation_drift: f64,
    /// Drift of the scale, a factor.
    pub scale: f64,
}

/// A similarity between two keyframes in their own units as one of lengths in the world's.
pub(super) fn in_world_units(map: &LocalMap, to: usize, from: usize, to_from_from: &Sim3) -> Sim3 {
    let [to_scale, from_scale] = [to, from].map(|k| map.keyframes[k].scale);
    Sim3::new(
        to_from_from.rotation,
        to_from_from.translation * to_scale,
        to_from_from.scale * to_scale / from_scale,
    )
}

/// Compares a measured similarity with the map; refuses more drift than the path explains.
pub(super) fn check(
    map: &LocalMap,
    current: usize,
    old: usize,
    current_from_old: &Sim3,
    params: &ClosingParams,
) -> Result<(), Drift> {
    let by_map = map.keyframes[old].camera_from_world * map.keyframes[current].camera_from_world.inverse();
    let current_from_old = in_world_units(map, current, old, current_from_old);
    let by_loop = current_from_old.inverse();
    let drift = Drift {
        translation: (by_loop.translation - by_map.translation).norm(),
        path_length: path_length(map, old, current),
        rotation_drift: by_loop.rotation.angle_to(&by_map.rotation).to_degrees(),
        scale: current_from_old.scale,
    };
    drift.check(params)
}

impl Drift {
    /// Refuses more drift than the path explains.
    fn check(self, params: &ClosingParams) -> Result<(), Self> {
        let in_bounds = self.translation <= params.max_drift * self.path_length
            && self.rotation_drift <= params.max_rotation
            && self.scale.ln().abs() <= params.max_scale.ln();
        if in_bounds { Ok(()) } else { Err(self) }
    }
}

/// The same for a loop between two keyframes of a finished map.
pub(super) fn check_in(map: &Map, closed: &Edge, params: &ClosingParams) -> Result<(), NoLoop> {
    let pose = |id: KeyframeId| map.keyframes.get(&id).map(|keyframe| keyframe.world_from_keyframe);
    let (Some(from), Some(to)) = (pose(closed.from), pose(closed.to)) else { return Err(NoLoop::NoScale) };
    let by_loop = from * closed.from_from_to;
    let (first, last) = (closed.from.min(closed.to), closed.from.max(closed.to));
    let centres: Vec<Vector3<f64>> =
        map.keyframes.range(first..=last).map(|(_, k)| k.world_from_keyframe.translation).collect();
    let drift = Drift {
        translation: (by_loop.translation - to.translation).norm(),
        path_length: centres.windows(2).map(|step| (step[1] - step[0]).norm()).sum(),
        rotation_drift: by_loop.rotation.angle_to(&to.rotation).to_degrees(),
        scale: by_loop.scale / to.scale,
    };
    Ok(drift.check(params)?)
}

/// Length of the camera's way between two keyframes.
fn path_length(map: &LocalMap, from: usize, to: usize) -> f64 {
    path_lengths(map, from, to).last().map_or(0.0, |(_, path_length)| *path_length)
}

/// The camera's centre at each keyframe before `to`, the nearest first and `from` last, and the length of the way from there.
fn path_lengths(map: &LocalMap, from: usize, to: usize) -> Vec<(Vector3<f64>, f64)> {
    let centre = |k: usize| map.keyframes[k].camera_from_world.inverse().translation;
    let (mut length, mut next) = (0.0, centre(to));
    (from..to)
        .rev()
        .map(|k| {
            let here = centre(k);
            length += (next - here).norm();
            next = here;
            (here, length)
        })
        .collect()
}

/// Where a keyframe might be in truth, for all that its drift allows.
pub(super) struct Reach {
    world_from_camera: Se3,
    /// How far apart two keyframes may be that see one place, map units.
    view: f64,
    /// Of each keyframe before it, the nearest first: where it is, and the length of the way from there, summed up along it.
    before: Vec<(Vector3<f64>, f64)>,
}

impl Reach {
    /// The reach of a keyframe; `None` without points.
    pub fn of(map: &LocalMap, keyframe: usize, params: &ClosingParams) -> Option<Self> {
        let points = map.reference_points(keyframe);
        let mut depths: Vec<f32> = points.iter().map(|p| 1.0 / p.inverse_depth).collect();
        let depth = median(&mut depths).filter(|d| d.is_finite() && *d > 0.0)?;
        let view = params.search.max_distance * f64::from(depth);
        let world_from_camera = map.keyframes[keyframe].camera_from_world.inverse();
        Some(Self { world_from_camera, view, before: path_lengths(map, 0, keyframe) })
    }

    /// Whether an old keyframe lies within it.
    pub fn contains(&self, map: &LocalMap, old: usize, params: &ClosingParams) -> bool {
        let before = self.before.len().checked_sub(old + 1).and_then(|index| self.before.get(index));
        before.is_some_and(|(centre, path_length)| {
            let apart = (centre - self.world_from_camera.translation).norm();
            // A turn in the image plane is part of the drift's bound only.
            let rotation_drift =
                || (map.keyframes[old].camera_from_world.rotation * self.world_from_camera.rotation).angle();
            apart <= self.view + params.max_drift * path_length
                && rotation_drift().to_degrees() <= params.search.max_view_angle + params.max_rotation
        })
    }
}
