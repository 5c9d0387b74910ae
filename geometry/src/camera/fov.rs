//! The field-of-view distortion (Devernay & Faugeras 2001), known as ATAN from PTAM.

use super::{CameraError, check_terms};
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Field-of-view distortion of one angle `ω`: radius `r` becomes `atan(2 r tan(ω/2)) / ω`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>", into = "Vec<f64>")]
pub struct Fov {
    omega: f64,
}

impl Fov {
    /// A distortion from its one term, `ω` in radians, in (0, π).
    ///
    /// # Errors
    /// On another number of terms, or an angle outside (0, π).
    pub fn new(terms: &[f64]) -> Result<Self, CameraError> {
        let model = "fov";
        let &[omega] = terms else {
            return Err(CameraError::TermCount { model, expected: "1", found: terms.len() });
        };
        check_terms(model, terms)?;
        if omega <= 0.0 || omega >= PI {
            let expected = "the angle must lie between 0 and π";
            return Err(CameraError::Term { model, index: 0, value: omega, expected });
        }
        Ok(Self { omega })
    }

    /// The angle `ω`, radians.
    pub fn omega(&self) -> f64 {
        self.omega
    }

    /// Distorts a point of the normalised plane; with the derivative.
    pub(super) fn distort(&self, plane: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let a = 2.0 * (0.5 * self.omega).tan();
        let u = plane.norm_squared();
        let au = a * a * u;
        // factor = atan(a r) / (ω r); bend = (d factor / d r) / r, by series where the difference cancels.
        let (factor, bend) = if au < 1e-5 {
            let series = 1.0 - au / 3.0 + au * au / 5.0;
            (series, a * a * (-2.0 / 3.0 + au * (4.0 / 5.0 - au * 6.0 / 7.0)))
        } else {
            let ar = au.sqrt();
            let factor = ar.atan() / ar;
            (factor, (1.0 / (1.0 + au) - factor) / u)
        };
        let scale = a / self.omega;
        let jacobian = (Matrix2::identity() * factor + plane * plane.transpose() * bend) * scale;
        (plane * (factor * scale), jacobian)
    }

    /// The point of the normalised plane that distorts to `bent`.
    pub(super) fn undistort(&self, bent: &Vector2<f64>) -> Option<Vector2<f64>> {
        let radius = bent.norm();
        let angle = radius * self.omega;
        // A quarter turn is infinitely far; close to it the tangent is no longer meaningful.
        if angle >= FRAC_PI_2 - 1e-6 {
            return None;
        }
        let a = 2.0 * (0.5 * self.omega).tan();
        let ratio = if radius > 0.0 { angle.tan() / (a * radius) } else { self.omega / a };
        Some(bent * ratio)
    }
}

impl TryFrom<Vec<f64>> for Fov {
    type Error = CameraError;
    fn try_from(terms: Vec<f64>) -> Result<Self, CameraError> {
        Self::new(&terms)
    }
}

impl From<Fov> for Vec<f64> {
    fn from(lens: Fov) -> Self {
        vec![lens.omega]
    }
}
