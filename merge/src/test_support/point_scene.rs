//! Points that two cameras see, measured with noise.

use super::Numbers;
use crate::scale_filter::{MeasuredPoint, PointMatch};
use geometry::{Pinhole, Sim3};
use nalgebra::{Vector2, Vector3};

pub(crate) const CAMERA: Pinhole =
    Pinhole { width: 640, height: 480, fx: 500.0, fy: 505.0, cx: 319.5, cy: 239.5 };
/// Standard deviations of a pixel coordinate, and of an inverse depth relative to itself.
const PIXEL: f64 = 0.7;
const RELATIVE: f64 = 0.03;

/// Matched points of two cameras.
pub(crate) struct Scene {
    /// How the two cameras stand to each other.
    pub target_from_source: Sim3,
    /// The matches.
    pub matches: Vec<PointMatch>,
}

/// The point as measured, with noise times `noise`.
pub(crate) fn measure(point: &Vector3<f64>, noise: f64, numbers: &mut Numbers) -> MeasuredPoint {
    measure_to(RELATIVE, point, noise, numbers)
}

/// The same with the inverse depth known to the share `relative` of itself.
fn measure_to(relative: f64, point: &Vector3<f64>, noise: f64, numbers: &mut Numbers) -> MeasuredPoint {
    let pixel = CAMERA.project(point) + Vector2::from_fn(|_, _| numbers.normal()) * (noise * PIXEL);
    let deviation = relative / point.z;
    let inverse_depth = 1.0 / point.z + noise * deviation * numbers.normal();
    MeasuredPoint::unproject(&CAMERA, pixel, inverse_depth, PIXEL * PIXEL, deviation * deviation).unwrap()
}

/// A point that the source camera sees, depth 2 to 8.
pub(crate) fn visible(numbers: &mut Numbers) -> Vector3<f64> {
    CAMERA.unproject(numbers.uniform(0.0, 640.0), numbers.uniform(0.0, 480.0)) * numbers.uniform(2.0, 8.0)
}

/// `count` matches, the share `wrong` of them between unrelated points.
pub(crate) fn scene(seed: u64, count: usize, wrong: f64, noise: f64) -> Scene {
    scene_to(RELATIVE, seed, count, wrong, noise)
}

/// The same with inverse depths known to the share `relative`.
pub(crate) fn scene_to(relative: f64, seed: u64, count: usize, wrong: f64, noise: f64) -> Scene {
    let numbers = &mut Numbers::new(seed);
    let rotation = numbers.rotation(0.15);
    let scale = numbers.uniform(-1.0, 1.0).exp();
    let translation = numbers.vector(0.4) * scale;
    let mut point_match = |i: usize| {
        let source = visible(numbers);
        let moved = if (i as f64 + 0.5) / (count as f64) < wrong { visible(numbers) } else { source };
        let target = rotation * moved * scale + translation;
        PointMatch {
            source: measure_to(relative, &source, noise, numbers),
            target: measure_to(relative, &target, noise, numbers),
        }
    };
    let matches = (0..count).map(&mut point_match).collect();
    Scene { target_from_source: Sim3::new(rotation, translation, scale), matches }
}
