//! What keyframes of two maps see of each other by a motion between them, from a few of their points.

use crate::prepared::PreparedMap;
use geometry::{Pinhole, Sim3};
use map::KeyframeId;
use nalgebra::Vector3;

/// Points of a keyframe that stand for its view.
const SAMPLES: usize = 64;

/// A keyframe by its place and some of its points: enough to see with which others it overlaps.
#[derive(Clone, Debug)]
pub struct Glimpse<'a> {
    /// The keyframe.
    pub id: KeyframeId,
    /// Its pose in its map's world.
    pub world_from_keyframe: Sim3,
    /// Its camera.
    pub camera: &'a Pinhole,
    /// Points spread over its view, in its camera frame and unit.
    pub points: Vec<Vector3<f64>>,
}

impl<'a> Glimpse<'a> {
    /// Of a keyframe with these pixels and their inverse depths, 1/keyframe unit; `None` without any.
    pub fn new(
        id: KeyframeId,
        world_from_keyframe: Sim3,
        camera: &'a Pinhole,
        samples: impl Iterator<Item = (u32, f32)>,
    ) -> Option<Self> {
        let point = |(pixel, inverse_depth): (u32, f32)| {
            let pixel = pixel as usize;
            let ray = camera.unproject((pixel % camera.width) as f64, (pixel / camera.width) as f64);
            ray / f64::from(inverse_depth)
        };
        let points: Vec<_> = samples.map(point).collect();
        (!points.is_empty()).then_some(Self { id, world_from_keyframe, camera, points })
    }

    /// Of a keyframe of a map; `None` when it has no depth.
    pub(crate) fn of(map: &PreparedMap<'a>, id: KeyframeId) -> Option<Self> {
        let keyframe = map.map().keyframes.get(&id)?;
        let step = keyframe.semi_dense.len().div_ceil(SAMPLES).max(1);
        let samples = keyframe.semi_dense.iter().step_by(step).map(|(pixel, d, _)| (pixel, d));
        Self::new(id, keyframe.world_from_keyframe, map.map().camera(keyframe), samples)
    }

    /// Of this keyframe's and another's points the share that the other has in its image, from directions of which the
    /// cosine is `min_cosine` at the least; the smaller of both shares, by the motion from this one's world to the
    /// other's, where it is `min_overlap` or more.
    pub(crate) fn overlap(
        &self,
        other: &Self,
        other_world_from_world: &Sim3,
        min_cosine: f64,
        min_overlap: f64,
    ) -> Option<f64> {
        let other_from_self =
            other.world_from_keyframe.inverse() * *other_world_from_world * self.world_from_keyframe;
        let there = share_seen(&self.points, &other_from_self, other.camera, min_cosine);
        if there < min_overlap {
            return None;
        }
        let back = share_seen(&other.points, &other_from_self.inverse(), self.camera, min_cosine);
        Some(there.min(back)).filter(|share| *share >= min_overlap)
    }
}

/// Share of points, moved by `to_from`, that a keyframe with this camera has in its image, from a direction not too far
/// off that of the other keyframe.
fn share_seen(points: &[Vector3<f64>], to_from: &Sim3, camera: &Pinhole, min_cosine: f64) -> f64 {
    let inside = |point: &&Vector3<f64>| {
        let moved = *to_from * **point;
        let pixel = camera.project(&moved);
        let within = |v: f64, size: usize| v >= 0.0 && v <= size as f64 - 1.0;
        let other = moved - to_from.translation;
        let alike = moved.dot(&other) >= min_cosine * moved.norm() * other.norm();
        alike && moved.z > 0.0 && within(pixel.x, camera.width) && within(pixel.y, camera.height)
    };
    points.iter().filter(inside).count() as f64 / points.len() as f64
}
