//! The pinhole camera: what every image is undistorted to before tracking.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// An ideal pinhole camera, lengths in pixels, pixel centres at integers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pinhole {
    /// Image width.
    pub width: usize,
    /// Image height.
    pub height: usize,
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
}

impl Pinhole {
    /// Projects a point of the camera frame to pixels; meaningful for z > 0.
    #[inline]
    pub fn project(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let iz = 1.0 / point.z;
        Vector2::new(self.fx * point.x * iz + self.cx, self.fy * point.y * iz + self.cy)
    }

    /// The ray through a pixel, scaled to z = 1.
    #[inline]
    pub fn unproject(&self, x: f64, y: f64) -> Vector3<f64> {
        Vector3::new((x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0)
    }

    /// The camera of pyramid level `level`, where a pixel averages `2^level × 2^level` of level 0.
    pub fn at_level(&self, level: usize) -> Self {
        let s = 1.0 / (1u64 << level) as f64;
        Self {
            width: self.width >> level,
            height: self.height >> level,
            fx: self.fx * s,
            fy: self.fy * s,
            cx: (self.cx + 0.5) * s - 0.5,
            cy: (self.cy + 0.5) * s - 0.5,
        }
    }
}
