//! Kannala–Brandt fisheye distortion (Kannala & Brandt 2006; OpenCV's `fisheye`, Kalibr's `equidistant`).

use super::roots::{first_sign_change, invert_increasing, polynomial};
use super::{CameraError, check_terms};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Fisheye distortion: a ray at angle θ from the axis lands at radius
/// `θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, so that fields of view above 180° are possible.
/// It is used only up to the angle where that radius stops growing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>", into = "Vec<f64>")]
pub struct KannalaBrandt {
    terms: [f64; 4],
    max_angle: f64,
}

impl KannalaBrandt {
    /// A distortion from its four terms `k1 k2 k3 k4`.
    ///
    /// # Errors
    /// On another number of terms, or a term that is not finite.
    pub fn new(terms: &[f64]) -> Result<Self, CameraError> {
        let (model, expected) = ("kb4", "4");
        let Ok(terms) = <[f64; 4]>::try_from(terms) else {
            return Err(CameraError::TermCount { model, expected, found: terms.len() });
        };
        check_terms(model, &terms)?;
        let [k1, k2, k3, k4] = terms;
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4];
        let max_angle = first_sign_change(&slope, PI * PI).map_or(PI, f64::sqrt);
        Ok(Self { terms, max_angle })
    }

    /// The terms `k1 k2 k3 k4`.
    pub fn terms(&self) -> [f64; 4] {
        self.terms
    }

    /// Largest angle from the optical axis, radians, at which the model is used; at most π.
    pub fn max_angle(&self) -> f64 {
        self.max_angle
    }

    /// Distorted plane coordinates of a point, with the derivative by the point.
    pub(super) fn distort(&self, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let (xy, z) = (point.xy(), point.z);
        let r = xy.norm();
        let squared = r * r + z * z;
        let theta = r.atan2(z);
        // Straight ahead the direction is arbitrary; straight behind there is none.
        if !(theta < self.max_angle && squared > 0.0) {
            return None;
        }
        let (radius, slope) = self.radius(theta);
        let (direction, ratio) = if r > 0.0 { (xy / r, radius / r) } else { (Vector2::x(), 1.0 / z) };
        let outer = direction * direction.transpose();
        let by_xy = (Matrix2::identity() - outer) * ratio + outer * (slope * z / squared);
        let by_z = direction * (-slope * r / squared);
        Some((xy * ratio, Matrix2x3::from_columns(&[by_xy.column(0), by_xy.column(1), by_z.column(0)])))
    }

    /// The unit ray that distorts to `bent`.
    pub(super) fn undistort(&self, bent: &Vector2<f64>) -> Option<Vector3<f64>> {
        let radius = bent.norm();
        if radius == 0.0 {
            return Some(Vector3::z());
        }
        let theta = invert_increasing(|theta| self.radius(theta), radius, self.max_angle)?;
        let (sin, cos) = theta.sin_cos();
        Some((bent * (sin / radius)).push(cos))
    }

    /// The radius of an angle and its derivative.
    fn radius(&self, theta: f64) -> (f64, f64) {
        let [k1, k2, k3, k4] = self.terms;
        let u = theta * theta;
        let value = theta * polynomial(&[1.0, k1, k2, k3, k4], u);
        (value, polynomial(&[1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4], u))
    }
}

impl TryFrom<Vec<f64>> for KannalaBrandt {
    type Error = CameraError;
    fn try_from(terms: Vec<f64>) -> Result<Self, CameraError> {
        Self::new(&terms)
    }
}

impl From<KannalaBrandt> for Vec<f64> {
    fn from(lens: KannalaBrandt) -> Self {
        lens.terms.to_vec()
    }
}
