//! What keyframes of two maps see of each other by a motion between them, from a few of their points.

use geometry::{Pinhole, Sim3};
use map::{KeyframeId, Map};
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
    pub(crate) fn of(map: &'a Map, id: KeyframeId) -> Option<Self> {
        let keyframe = map.keyframes.get(&id)?;
        let step = keyframe.semi_dense.len().div_ceil(SAMPLES).max(1);
        let samples = keyframe.semi_dense.iter().step_by(step).map(|(pixel, d, _)| (pixel, d));
        Self::new(id, keyframe.world_from_keyframe, map.camera(keyframe), samples)
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
        self.overlap_by(other, &other_from_self, min_cosine, min_overlap)
    }

    fn overlap_by(
        &self,
        other: &Self,
        other_from_self: &Sim3,
        min_cosine: f64,
        min_overlap: f64,
    ) -> Option<f64> {
        let there = share_seen(&self.points, other_from_self, other.camera, min_cosine, min_overlap)?;
        let back =
            share_seen(&other.points, &other_from_self.inverse(), self.camera, min_cosine, min_overlap)?;
        Some(there.min(back))
    }
}

/// A keyframe among many that may see it, in the world of these.
pub(crate) struct Placed<'g, 'a> {
    /// The keyframe.
    pub glimpse: &'g Glimpse<'a>,
    /// A ball around its camera and its points.
    centre: Vector3<f64>,
    radius: f64,
    /// Maps the world that the others are compared from to the keyframe.
    from_other_world: Sim3,
}

impl<'g, 'a> Placed<'g, 'a> {
    /// A keyframe whose world is moved by `motion`, seen from a world that `world_from_other` moves to the common one.
    pub fn new(glimpse: &'g Glimpse<'a>, motion: &Sim3, world_from_other: &Sim3) -> Self {
        let pose = *motion * glimpse.world_from_keyframe;
        let all = || glimpse.points.iter().map(|point| pose * *point).chain([pose.translation]);
        let centre = all().sum::<Vector3<f64>>() / (glimpse.points.len() + 1) as f64;
        let radius = all().map(|point| (point - centre).norm()).fold(0.0, f64::max);
        let from_other_world = glimpse.world_from_keyframe.inverse() * *world_from_other;
        Self { glimpse, centre, radius, from_other_world }
    }

    /// As [`Glimpse::overlap`], of keyframes whose balls meet: of others the one sees nothing of what is in front of the
    /// other.
    pub fn overlap(&self, other: &Self, min_cosine: f64, min_overlap: f64) -> Option<f64> {
        let reach = self.radius + other.radius;
        // What is no number is compared.
        if (self.centre - other.centre).norm_squared() > reach * reach {
            return None;
        }
        let other_from_self = other.from_other_world * self.glimpse.world_from_keyframe;
        self.glimpse.overlap_by(other.glimpse, &other_from_self, min_cosine, min_overlap)
    }
}

/// Share of points, moved by `to_from`, that a keyframe with this camera has in its image, from a direction not too far
/// off that of the other keyframe, where it is `min_share` or more.
pub(crate) fn share_seen(
    points: &[Vector3<f64>],
    to_from: &Sim3,
    camera: &Pinhole,
    min_cosine: f64,
    min_share: f64,
) -> Option<f64> {
    let inside = |point: &Vector3<f64>| {
        let moved = *to_from * *point;
        let pixel = camera.project(&moved);
        let within = |v: f64, size: usize| v >= 0.0 && v <= size as f64 - 1.0;
        let other = moved - to_from.translation;
        let similar = moved.dot(&other) >= min_cosine * moved.norm() * other.norm();
        similar && moved.z > 0.0 && within(pixel.x, camera.width) && within(pixel.y, camera.height)
    };
    let mut seen = points.len();
    for point in points {
        seen -= usize::from(!inside(point));
        // Most see next to nothing of each other: no more of them is looked at than shows that.
        if (seen as f64 / points.len() as f64) < min_share {
            return None;
        }
    }
    Some(seen as f64 / points.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SVector, UnitQuaternion};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 210.0, fy: 210.0, cx: 159.5, cy: 119.5 };

    /// A keyframe on a circle of 10 m that looks outwards at a wall 4 m away.
    fn keyframe(id: u32) -> Glimpse<'static> {
        let rotation = UnitQuaternion::from_euler_angles(0.0, 0.1 * f64::from(id), 0.0);
        let pose = Sim3::new(rotation, rotation * Vector3::new(0.0, 0.0, 10.0), 1.5);
        let samples = (0..64u32).map(|i| ((i / 8 * 29 + 5) * 320 + i % 8 * 39 + 5, 0.375 + 0.001 * i as f32));
        Glimpse::new(KeyframeId(id), pose, &CAMERA, samples).unwrap()
    }

    #[test]
    fn placed_keyframes_overlap_as_they_do_one_by_one() {
        let motion = Sim3::exp(&SVector::from([3.0, -1.0, 2.0, 0.4, 0.2, -0.3, 0.5]));
        let sources: Vec<Glimpse> = (0..63).map(keyframe).collect();
        let targets: Vec<Glimpse> = sources
            .iter()
            .map(|glimpse| Glimpse {
                world_from_keyframe: motion * glimpse.world_from_keyframe,
                ..glimpse.clone()
            })
            .collect();
        let placed: Vec<Placed> =
            targets.iter().map(|target| Placed::new(target, &Sim3::identity(), &motion)).collect();
        let mut overlapping = 0;
        for source in &sources {
            let here = Placed::new(source, &motion, &Sim3::identity());
            for (target, there) in targets.iter().zip(&placed) {
                let expected = source.overlap(target, &motion, 0.7, 0.5);
                assert_eq!(here.overlap(there, 0.7, 0.5), expected);
                overlapping += usize::from(expected.is_some());
            }
        }
        assert!((63 * 3..63 * 20).contains(&overlapping), "{overlapping}");
    }
}
