//! What keyframes of two maps see of each other by a motion between them, from a few of their points.

use crate::prepared::PreparedMap;
use geometry::Sim3;
use map::KeyframeId;
use nalgebra::Vector3;

/// Points of a keyframe that stand for its view.
const SAMPLES: usize = 64;

/// A few points of a keyframe, in its camera frame and unit; `None` when it has no depth.
pub(crate) fn sample(map: &PreparedMap, id: KeyframeId) -> Option<Vec<Vector3<f64>>> {
    let keyframe = map.map().keyframes.get(&id)?;
    let camera = map.map().camera(keyframe);
    let step = keyframe.semi_dense.len().div_ceil(SAMPLES).max(1);
    let point = |(pixel, inverse_depth, _): (u32, f32, f32)| {
        let pixel = pixel as usize;
        let ray = camera.unproject((pixel % camera.width) as f64, (pixel / camera.width) as f64);
        ray / f64::from(inverse_depth)
    };
    let points: Vec<_> = keyframe.semi_dense.iter().step_by(step).map(point).collect();
    (!points.is_empty()).then_some(points)
}

/// Share of points, moved by `to_from`, that keyframe `id` has in its image, from a direction not too far off that of
/// the other keyframe.
pub(crate) fn share_seen(
    points: &[Vector3<f64>],
    to_from: &Sim3,
    map: &PreparedMap,
    id: KeyframeId,
    min_cosine: f64,
) -> Option<f64> {
    let camera = map.map().camera(map.map().keyframes.get(&id)?);
    let inside = |point: &&Vector3<f64>| {
        let moved = *to_from * **point;
        let pixel = camera.project(&moved);
        let within = |v: f64, size: usize| v >= 0.0 && v <= size as f64 - 1.0;
        let other = moved - to_from.translation;
        let alike = moved.dot(&other) >= min_cosine * moved.norm() * other.norm();
        alike && moved.z > 0.0 && within(pixel.x, camera.width) && within(pixel.y, camera.height)
    };
    Some(points.iter().filter(inside).count() as f64 / points.len() as f64)
}
