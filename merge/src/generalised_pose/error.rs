//! How far a sighting is from where a similarity has it.

use super::{GeneralisedPoseParams, Match, Pool};
use geometry::{Pinhole, Sim3};
use nalgebra::{Vector2, Vector3};

/// A keyframe among those of its side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Its pose and unit in the side's frame.
    pub side_from_view: Sim3,
    /// The inverse of that.
    pub view_from_side: Sim3,
    /// Focal lengths, pixels.
    pub focal_length: [f64; 2],
    /// Pixels of its image.
    pub pixels: f64,
}

impl View {
    /// A keyframe of a camera, with its pose and unit in its side's frame.
    pub fn new(side_from_view: Sim3, camera: &Pinhole) -> Self {
        Self {
            side_from_view,
            view_from_side: side_from_view.inverse(),
            focal_length: [camera.fx, camera.fy],
            pixels: (camera.width * camera.height) as f64,
        }
    }
}

/// A key point of one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Index of its keyframe among the side's views.
    pub view: usize,
    /// Its index among the keyframe's features.
    pub feature: u32,
    /// Its ray in the camera frame, z = 1.
    pub ray: Vector3<f64>,
    /// Where it is and how well its depth is known.
    pub point: Option<Located>,
}

/// A point with depth, in its side's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Where it is.
    pub position: Vector3<f64>,
    /// Where it would be with a depth larger by a standard deviation, less the position.
    pub depth_deviation: Vector3<f64>,
}

/// A point in the image of the other side: how far from its sighting, in standard deviations of a key point.
pub(super) struct Projected {
    /// Predicted less measured.
    pub error: Vector2<f64>,
    /// By how much a standard deviation of the depth moves it.
    pub depth: Vector2<f64>,
    /// Derivatives of the pixel by the point in the camera's frame, as rows.
    pub rows: [Vector3<f64>; 2],
}

impl Projected {
    /// Squared Mahalanobis distance: unit variance and that of the depth along its line.
    pub fn squared(&self) -> f64 {
        self.error.norm_squared() - self.error.dot(&self.depth).powi(2) / (1.0 + self.depth.norm_squared())
    }
}

/// The view of a point of side `1 - to` from side `to`, moved by `to_from`; `None` behind the camera, and without depth.
pub(super) fn projected(
    pool: &Pool,
    m: &Match,
    to: usize,
    to_from: &Sim3,
    params: &GeneralisedPoseParams,
) -> Option<Projected> {
    let point = m.sides[1 - to].point?;
    let (sighting, view) = (&m.sides[to], &pool.views[to][m.sides[to].view]);
    let view_from = view.view_from_side * *to_from;
    let local = view_from * point.position;
    if local.z <= 0.0 {
        return None;
    }
    let [fx, fy] = view.focal_length.map(|f| f / params.pixel_deviation);
    let (u, v) = (local.x / local.z, local.y / local.z);
    let error = Vector2::new(fx * (u - sighting.ray.x), fy * (v - sighting.ray.y));
    let rows = [Vector3::new(fx, 0.0, -fx * u) / local.z, Vector3::new(0.0, fy, -fy * v) / local.z];
    let along = view_from.rotation * point.depth_deviation * view_from.scale;
    let depth = Vector2::new(rows[0].dot(&along), rows[1].dot(&along));
    Some(Projected { error, depth, rows })
}

/// Squared Mahalanobis distance of a match, the larger of both ways; infinite where a point is behind its camera, and
/// for a match without depth.
pub(super) fn squared(pool: &Pool, m: &Match, motions: &[Sim3; 2], params: &GeneralisedPoseParams) -> f64 {
    let mut worst = None;
    for (to, motion) in motions.iter().enumerate() {
        if m.sides[1 - to].point.is_some() {
            let squared = projected(pool, m, to, motion, params).map_or(f64::INFINITY, |p| p.squared());
            worst = Some(worst.map_or(squared, |worst: f64| worst.max(squared)));
        }
    }
    worst.unwrap_or(f64::INFINITY)
}

/// The similarity to either side: `[source_from_target, target_from_source]`.
pub(super) fn both_directions(target_from_source: &Sim3) -> [Sim3; 2] {
    [target_from_source.inverse(), *target_from_source]
}

/// The mean probability that a wrong match agrees: the area in which it does over that of the image.
pub(super) fn chance(pool: &Pool, target_from_source: &Sim3, params: &GeneralisedPoseParams) -> f64 {
    let motions = both_directions(target_from_source);
    let mut areas = Vec::new();
    for m in &pool.matches {
        for (to, motion) in motions.iter().enumerate() {
            let Some(seen) = projected(pool, m, to, motion, params) else { continue };
            let ellipse = std::f64::consts::PI
                * params.gate
                * (1.0 + seen.depth.norm_squared()).sqrt()
                * params.pixel_deviation.powi(2);
            areas.push((ellipse / pool.views[to][m.sides[to].view].pixels).min(1.0));
        }
    }
    areas.iter().sum::<f64>() / areas.len().max(1) as f64
}
