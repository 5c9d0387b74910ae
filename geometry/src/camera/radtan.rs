//! Radial-tangential distortion (Brown 1966; OpenCV, "Camera Calibration and 3D Reconstruction").

use super::roots::{first_sign_change, invert_increasing, polynomial};
use super::{CameraError, check_terms};
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Rays further than this from the axis (tangent of the angle: 89.94°) are never accepted.
const MAX_RADIUS: f64 = 1e3;

/// Radial-tangential distortion of the normalised plane, terms in OpenCV's order
/// `k1 k2 p1 p2 [k3 [k4 k5 k6]]`.
///
/// With `u = x² + y²` and `f = (1 + k1 u + k2 u² + k3 u³) / (1 + k4 u + k5 u² + k6 u³)`:
/// `x' = x f + 2 p1 x y + p2 (u + 2x²)`, `y' = y f + p1 (u + 2y²) + 2 p2 x y`.
/// It is used only up to the radius where `x'` stops growing with `x`; beyond, the polynomial folds back.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>", into = "Vec<f64>")]
pub struct RadTan {
    numerator: [f64; 4],
    denominator: [f64; 4],
    tangential: Vector2<f64>,
    max_radius: f64,
}

impl RadTan {
    /// A distortion from 4, 5 or 8 terms in OpenCV's order.
    ///
    /// # Errors
    /// On another number of terms, or a term that is not finite.
    pub fn new(terms: &[f64]) -> Result<Self, CameraError> {
        let (model, expected) = ("radtan", "4, 5 or 8");
        if !matches!(terms.len(), 4 | 5 | 8) {
            return Err(CameraError::TermCount { model, expected, found: terms.len() });
        }
        check_terms(model, terms)?;
        let term = |i: usize| terms.get(i).copied().unwrap_or(0.0);
        let numerator = [1.0, term(0), term(1), term(4)];
        let denominator = [1.0, term(5), term(6), term(7)];
        let max_radius = increasing_radius(&numerator, &denominator);
        Ok(Self { numerator, denominator, tangential: Vector2::new(term(2), term(3)), max_radius })
    }

    /// The terms in OpenCV's order: 4, 5 or 8 of them, as few as keep every one that is not zero.
    pub fn terms(&self) -> Vec<f64> {
        let ([_, k1, k2, k3], [_, k4, k5, k6]) = (self.numerator, self.denominator);
        let mut terms = vec![k1, k2, self.tangential.x, self.tangential.y, k3, k4, k5, k6];
        if [k4, k5, k6] == [0.0; 3] {
            terms.truncate(if k3 == 0.0 { 4 } else { 5 });
        }
        terms
    }

    /// Largest radius on the normalised plane, before distortion, at which the model is used.
    pub fn max_radius(&self) -> f64 {
        self.max_radius
    }

    /// Distorts a point of the normalised plane; with the derivative. `None` where the mapping folds.
    pub(super) fn distort(&self, plane: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let (x, y) = (plane.x, plane.y);
        let (p1, p2) = (self.tangential.x, self.tangential.y);
        let u = plane.norm_squared();
        // False for NaN as well.
        let in_range = u < self.max_radius * self.max_radius;
        if !in_range {
            return None;
        }
        let (factor, factor_by_u) = self.factor(u);
        let bent = Vector2::new(
            x * factor + 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x),
            y * factor + p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let cross = 2.0 * factor_by_u * x * y + 2.0 * (p1 * x + p2 * y);
        let jacobian = Matrix2::new(
            factor + 2.0 * factor_by_u * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            factor + 2.0 * factor_by_u * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (jacobian.determinant() > 0.0).then_some((bent, jacobian))
    }

    /// The point of the normalised plane that distorts to `bent`.
    pub(super) fn undistort(&self, bent: &Vector2<f64>) -> Option<Vector2<f64>> {
        let radius = bent.norm();
        if radius == 0.0 && self.tangential == Vector2::zeros() {
            return Some(*bent);
        }
        // The radial part alone has a safe inverse; the small tangential part is left to Newton.
        let radial = |r: f64| {
            let (factor, factor_by_u) = self.factor(r * r);
            (r * factor, factor + 2.0 * factor_by_u * r * r)
        };
        let start = invert_increasing(radial, radius, self.max_radius).unwrap_or(self.max_radius);
        let start = start.min(0.999 * self.max_radius);
        let mut plane = if radius > 0.0 { bent * (start / radius) } else { *bent };
        let (mut value, mut jacobian) = self.distort(&plane)?;
        let mut error = (value - bent).norm();
        for _ in 0..50 {
            if error <= 1e-15 * (1.0 + radius) {
                break;
            }
            let step = jacobian.try_inverse()? * (value - bent);
            let improved = (0..12).find_map(|halving| {
                let candidate = plane - step * 0.5f64.powi(halving);
                let (value, jacobian) = self.distort(&candidate)?;
                let smaller = (value - bent).norm();
                (smaller < error).then_some((candidate, value, jacobian, smaller))
            });
            let Some(better) = improved else { break };
            (plane, value, jacobian, error) = better;
        }
        (error <= 1e-10 * (1.0 + radius)).then_some(plane)
    }

    /// The radial factor and its derivative by the squared radius.
    fn factor(&self, u: f64) -> (f64, f64) {
        let ([_, k1, k2, k3], [_, k4, k5, k6]) = (self.numerator, self.denominator);
        let n = 1.0 + u * (k1 + u * (k2 + u * k3));
        let d = 1.0 + u * (k4 + u * (k5 + u * k6));
        let n_by_u = k1 + u * (2.0 * k2 + 3.0 * u * k3);
        let d_by_u = k4 + u * (2.0 * k5 + 3.0 * u * k6);
        let factor = n / d;
        (factor, (n_by_u - factor * d_by_u) / d)
    }
}

/// The radius up to which `r N(r²) / D(r²)` grows: the first zero of `N D + 2u (N' D − N D')` or of `D`.
fn increasing_radius(numerator: &[f64; 4], denominator: &[f64; 4]) -> f64 {
    let mut slope = [0.0; 7];
    for (i, n) in numerator.iter().enumerate() {
        for (j, d) in denominator.iter().enumerate() {
            slope[i + j] += n * d * (1.0 + 2.0 * (i as f64 - j as f64));
        }
    }
    debug_assert_eq!(polynomial(&slope, 0.0), 1.0);
    let end = MAX_RADIUS * MAX_RADIUS;
    let limit = [first_sign_change(&slope, end), first_sign_change(denominator, end)];
    limit.into_iter().flatten().fold(end, f64::min).sqrt()
}

impl TryFrom<Vec<f64>> for RadTan {
    type Error = CameraError;
    fn try_from(terms: Vec<f64>) -> Result<Self, CameraError> {
        Self::new(&terms)
    }
}

impl From<RadTan> for Vec<f64> {
    fn from(lens: RadTan) -> Self {
        lens.terms()
    }
}
