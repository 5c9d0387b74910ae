//! 3-D points with the covariance of how they were measured.

use geometry::Pinhole;
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A 3-D point of a camera's frame with its covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPoint {
    /// Position in the camera frame, keyframe units.
    pub position: Vector3<f64>,
    /// Covariance of the position, keyframe units squared; symmetric and positive definite.
    pub covariance: Matrix3<f64>,
}

impl MeasuredPoint {
    /// The point at `pixel` with inverse depth `inverse_depth` (1/z, 1/keyframe unit), and its covariance to
    /// first order: `J diag(σ_p², σ_p², σ_d²) Jᵀ` with J the derivative of `ray(pixel) / inverse_depth`.
    ///
    /// `pixel_variance` σ_p² is that of each coordinate, pixel²; `inverse_depth_variance` is σ_d². Pixel and
    /// inverse depth are taken as independent. `None` if the inverse depth or a variance is not positive, or
    /// a number not finite.
    pub fn unproject(
        camera: &Pinhole,
        pixel: Vector2<f64>,
        inverse_depth: f64,
        pixel_variance: f64,
        inverse_depth_variance: f64,
    ) -> Option<Self> {
        if !(inverse_depth > 0.0 && pixel_variance > 0.0 && inverse_depth_variance > 0.0) {
            return None;
        }
        let depth = inverse_depth.recip();
        let position = camera.unproject(pixel.x, pixel.y) * depth;
        let along_ray = position * depth;
        let lateral = Vector3::new(depth / camera.fx, depth / camera.fy, 0.0);
        let covariance = Matrix3::from_diagonal(&lateral.component_mul(&lateral)) * pixel_variance
            + along_ray * along_ray.transpose() * inverse_depth_variance;
        Some(Self { position, covariance }).filter(Self::is_valid)
    }

    /// Whether the numbers are finite, the point is not the camera's centre and the covariance is positive
    /// definite.
    pub(super) fn is_valid(&self) -> bool {
        let finite = self.position.iter().chain(self.covariance.iter()).all(|v| v.is_finite());
        finite && self.position.norm() > 0.0 && self.covariance.cholesky().is_some()
    }
}

/// One scene point measured from both keyframes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointMatch {
    /// In the source keyframe's camera frame and unit.
    pub source: MeasuredPoint,
    /// In the target keyframe's camera frame and unit.
    pub target: MeasuredPoint,
}
