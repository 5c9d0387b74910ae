//! Clouds to register, and the cloud of a keyframe.

use crate::scale_filter::MeasuredPoint;
use geometry::{Pinhole, Sim3};
use map::{DEFAULT_MAX_RELATIVE_VARIANCE, SemiDense};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Points of one frame and unit, with how well each is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Positions.
    pub points: Vec<Vector3<f64>>,
    /// Covariance of each position, unit squared, symmetric and positive semi-definite; as many as points. `None`
    /// if they are not known: then all points are taken as equally good, and the residuals tell how good.
    pub covariances: Option<Vec<Matrix3<f64>>>,
}

impl Cloud {
    /// The cloud in another frame and unit.
    pub fn moved(&self, new_from_old: &Sim3) -> Self {
        let linear = new_from_old.rotation.to_rotation_matrix().into_inner() * new_from_old.scale;
        Self {
            points: self.points.iter().map(|&point| *new_from_old * point).collect(),
            covariances: self
                .covariances
                .as_ref()
                .map(|all| all.iter().map(|c| linear * c * linear.transpose()).collect()),
        }
    }

    /// Covariance of point `index`; the identity where none are known.
    pub(super) fn covariance(&self, index: usize) -> Matrix3<f64> {
        self.covariances.as_ref().map_or_else(Matrix3::identity, |all| all[index])
    }
}

impl From<Vec<Vector3<f64>>> for Cloud {
    fn from(points: Vec<Vector3<f64>>) -> Self {
        Self { points, covariances: None }
    }
}

/// Which points of a keyframe make its cloud.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeCloudParams {
    /// Largest variance of the inverse depth over its square. Default 0.01, a depth known to 10 %; above 0.
    /// Lower leaves fewer and better points.
    pub max_relative_variance: f32,
    /// Most points. Default 5000; at least 1. More make the registration better and slower.
    pub max_points: usize,
    /// Variance of a pixel's position, each coordinate, pixel². Default 0.25, half a pixel; above 0.
    pub pixel_variance: f64,
}

impl Default for KeyframeCloudParams {
    fn default() -> Self {
        Self { max_relative_variance: DEFAULT_MAX_RELATIVE_VARIANCE, max_points: 5000, pixel_variance: 0.25 }
    }
}

/// The filtered cloud of a keyframe, in its camera frame and unit, with covariances.
///
/// Pixels with a depth too uncertain are left out. What remains is thinned to one pixel, the one known best, in
/// each square of the image, the squares as small as `max_points` allows. Squares of the image keep the near and
/// the far in balance where boxes in space would keep mostly the far, which is known least.
pub fn keyframe_cloud(semi_dense: &SemiDense, camera: &Pinhole, params: &KeyframeCloudParams) -> Cloud {
    let pixels: Vec<_> = semi_dense
        .iter()
        .map(|(pixel, d, variance)| DepthPixel {
            x: pixel as usize % camera.width.max(1),
            y: pixel as usize / camera.width.max(1),
            inverse_depth: d,
            variance,
        })
        .filter(|pixel| pixel.relative_variance() <= params.max_relative_variance)
        .collect();
    let (points, covariances) = thinned(&pixels, params.max_points.max(1))
        .into_iter()
        .filter_map(|pixel| pixel.measured(camera, params.pixel_variance))
        .map(|measured| (measured.position, measured.covariance))
        .unzip();
    Cloud { points, covariances: Some(covariances) }
}

/// A pixel with a depth.
#[derive(Clone, Copy)]
struct DepthPixel {
    x: usize,
    y: usize,
    inverse_depth: f32,
    variance: f32,
}

impl DepthPixel {
    fn relative_variance(&self) -> f32 {
        self.variance / (self.inverse_depth * self.inverse_depth)
    }

    fn measured(&self, camera: &Pinhole, pixel_variance: f64) -> Option<MeasuredPoint> {
        let position = Vector2::new(self.x as f64, self.y as f64);
        let (inverse_depth, variance) = (f64::from(self.inverse_depth), f64::from(self.variance));
        MeasuredPoint::unproject(camera, position, inverse_depth, pixel_variance, variance)
    }
}

/// The best pixel of each square, the squares as small as leaves at most `max_points`.
fn thinned(pixels: &[DepthPixel], max_points: usize) -> Vec<DepthPixel> {
    if pixels.len() <= max_points {
        return pixels.to_vec();
    }
    // No smaller square can do: it holds at most `side²` pixels.
    let fewest = (pixels.len() as f64 / max_points as f64).sqrt().ceil() as usize;
    let mut side = fewest.max(1);
    let (width, height) = pixels.iter().fold((0, 0), |(w, h), p| (w.max(p.x + 1), h.max(p.y + 1)));
    loop {
        let across = width.div_ceil(side);
        let mut best: Vec<Option<DepthPixel>> = vec![None; across * height.div_ceil(side)];
        for &pixel in pixels {
            let kept = &mut best[pixel.y / side * across + pixel.x / side];
            if kept.is_none_or(|kept| pixel.relative_variance() < kept.relative_variance()) {
                *kept = Some(pixel);
            }
        }
        if best.iter().flatten().count() <= max_points {
            return best.into_iter().flatten().collect();
        }
        side += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 50.0, fy: 50.0, cx: 31.5, cy: 23.5 };

    fn semi_dense(variance: impl Fn(u32) -> f32) -> SemiDense {
        let pixel: Vec<u32> = (0..64 * 48).collect();
        let inverse_depth = vec![0.5; pixel.len()];
        let variance = pixel.iter().map(|&p| variance(p)).collect();
        SemiDense { pixel: pixel.into(), inverse_depth: inverse_depth.into(), variance }
    }

    #[test]
    fn uncertain_and_broken_depths_are_left_out() {
        let depth = semi_dense(|p| [1e-4, 1.0, f32::NAN, 0.0][p as usize % 4]);
        let cloud = keyframe_cloud(&depth, &CAMERA, &KeyframeCloudParams::default());
        assert_eq!(cloud.points.len(), 64 * 48 / 4);
        assert!(cloud.points.iter().all(|p| (p.z - 2.0).abs() < 1e-6));
    }

    #[test]
    fn thinning_is_even_and_keeps_the_best() {
        let depth = semi_dense(|p| if (p / 64) % 4 == 1 && p % 4 == 2 { 1e-5 } else { 1e-4 });
        let params = KeyframeCloudParams { max_points: 16 * 12, ..Default::default() };
        let cloud = keyframe_cloud(&depth, &CAMERA, &params);
        assert_eq!(cloud.points.len(), 16 * 12);
        // Each square of 4 × 4 pixels has one pixel known better; along the ray it shows.
        let variances = cloud.covariances.unwrap();
        assert!(variances.iter().all(|c| c[(2, 2)] < 2.0 * 1e-5 * 2f64.powi(4)));
    }

    #[test]
    fn a_moved_cloud_moves_its_covariances() {
        let cloud = Cloud {
            points: vec![Vector3::x()],
            covariances: Some(vec![Matrix3::from_diagonal(&Vector3::new(1.0, 4.0, 9.0))]),
        };
        let rotation = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2);
        let moved = cloud.moved(&Sim3::new(rotation, Vector3::zeros(), 2.0));
        assert!((moved.points[0] - Vector3::y() * 2.0).norm() < 1e-12);
        let expected = Matrix3::from_diagonal(&Vector3::new(16.0, 4.0, 36.0));
        assert!((moved.covariances.unwrap()[0] - expected).norm() < 1e-12);
    }
}
