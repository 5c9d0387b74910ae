//! The drift that a loop may reveal: a place that is far away by the map is not one to come back to.

use super::ClosingParams;
use crate::local_map::LocalMap;
use geometry::{Sim3, median};
use map::{KeyframeId, Map};
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

/// Compares one end of a loop as measured from the other, `a_from_b`, with where the map has it, `path_length` away; refuses
/// more drift than the path explains.
pub(super) fn check(
    [world_from_a, world_from_b]: [Sim3; 2],
    a_from_b: &Sim3,
    path_length: f64,
    params: &ClosingParams,
) -> Result<(), Drift> {
    let by_loop = world_from_a * *a_from_b;
    let drift = Drift {
        translation: (by_loop.translation - world_from_b.translation).norm(),
        path_length,
        rotation_drift: by_loop.rotation.angle_to(&world_from_b.rotation).to_degrees(),
        scale: by_loop.scale / world_from_b.scale,
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

/// Where each keyframe of a map is, and the length of the path to it from the first, world units.
pub struct Trajectory(Vec<(KeyframeId, Vector3<f64>, f64)>);

impl Trajectory {
    /// That of keyframes with their centres, in order of their numbers.
    fn of(centres: impl Iterator<Item = (KeyframeId, Vector3<f64>)>) -> Self {
        let (mut length, mut before) = (0.0, None);
        let at = |(id, centre): (KeyframeId, Vector3<f64>)| {
            length += before.replace(centre).map_or(0.0, |before: Vector3<f64>| (centre - before).norm());
            (id, centre, length)
        };
        Self(centres.map(at).collect())
    }

    /// That of a finished map.
    pub fn of_map(map: &Map) -> Self {
        Self::of(map.keyframes.values().map(|k| (k.id, k.world_from_keyframe.translation)))
    }

    /// That of the keyframes up to one.
    pub(super) fn until(map: &LocalMap, last: usize) -> Self {
        let centre = |k: usize| map.keyframes[k].camera_from_world.inverse().translation;
        Self::of((0..=last).map(|k| (LocalMap::id(k), centre(k))))
    }

    fn at(&self, keyframe: KeyframeId) -> Option<(Vector3<f64>, f64)> {
        let index = self.0.binary_search_by_key(&keyframe, |(id, ..)| *id).ok()?;
        let (_, centre, length) = self.0[index];
        Some((centre, length))
    }

    /// How far apart two keyframes are, and how long the path between them is; nothing of a keyframe that is not in the map.
    pub fn between(&self, old: KeyframeId, new: KeyframeId) -> Option<[f64; 2]> {
        let ((from, begun), (to, ended)) = (self.at(old)?, self.at(new)?);
        Some([(to - from).norm(), ended - begun])
    }

    /// Whether an old keyframe may show what a newer one sees, which is `distance` away: they lie no farther apart than that and the drift.
    pub fn may_meet(&self, old: KeyframeId, new: KeyframeId, distance: f64, max_drift: f64) -> bool {
        self.between(old, new).is_some_and(|[apart, path]| apart <= distance + max_drift * path)
    }
}

/// Where a keyframe might be in truth, for all that its drift allows.
pub(super) struct Reach {
    keyframe: usize,
    /// How far apart two keyframes may be that see one place, map units.
    view: f64,
    trajectory: Trajectory,
}

impl Reach {
    /// The reach of a keyframe; `None` without points.
    pub fn of(map: &LocalMap, keyframe: usize, params: &ClosingParams) -> Option<Self> {
        let points = map.reference_points(keyframe);
        let mut depths: Vec<f32> = points.iter().map(|p| 1.0 / p.inverse_depth).collect();
        let depth = median(&mut depths).filter(|d| d.is_finite() && *d > 0.0)?;
        let view = params.search.max_distance * f64::from(depth);
        Some(Self { keyframe, view, trajectory: Trajectory::until(map, keyframe) })
    }

    /// Whether an old keyframe lies within it.
    pub fn contains(&self, map: &LocalMap, old: usize, params: &ClosingParams) -> bool {
        let [old_id, id] = [old, self.keyframe].map(LocalMap::id);
        // A turn in the image plane is part of the drift's bound only.
        let rotation_drift = || {
            let [old, new] = [old, self.keyframe].map(|k| map.keyframes[k].camera_from_world.rotation);
            (old * new.inverse()).angle()
        };
        self.trajectory.may_meet(old_id, id, self.view, params.max_drift)
            && rotation_drift().to_degrees() <= params.search.max_view_angle + params.max_rotation
    }
}
