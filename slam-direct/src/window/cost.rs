//! What observations predict, and what they cost.

use super::calibration::Calibration;
use super::pairs::{Pairs, Relative};
use super::problem::{Problem, WindowPoint};
use geometry::Pinhole;
use nalgebra::Vector3;

/// Weight of a squared normalised residual under the Cauchy kernel: `2/(1 + e²)`, one at one σ.
///
/// Patches err with heavy tails (leaves, blur, occlusion edges): the good half of them should decide.
pub(crate) fn robust_weight(squared: f64) -> f64 {
    2.0 / (1.0 + squared)
}

/// The cost that [`robust_weight`] belongs to: `2 log(1 + e²)`.
pub(crate) fn robust_cost(squared: f64) -> f64 {
    2.0 * squared.ln_1p()
}

/// The sum of many [`robust_cost`]s: the logarithm of a product is that of its factors, and one is taken of many.
struct RobustCosts {
    logarithms: f64,
    product: f64,
}

impl Default for RobustCosts {
    fn default() -> Self {
        Self { logarithms: 0.0, product: 1.0 }
    }
}

impl RobustCosts {
    /// Factors and products beyond are held: the next product must not overflow.
    const LARGE: f64 = 1e150;

    #[inline]
    fn add(&mut self, squared: f64) {
        self.product *= 1.0 + squared.min(Self::LARGE);
        if self.product > Self::LARGE {
            self.logarithms += self.product.ln();
            self.product = 1.0;
        }
    }

    fn sum(&self) -> f64 {
        2.0 * (self.logarithms + self.product.ln())
    }
}

/// A predicted observation: residual and derivatives in the relative frame.
pub(crate) struct Prediction {
    /// Predicted minus measured pixel.
    pub residual: [f64; 2],
    /// Derivative of the pixel by the left-multiplicative twist (υ, ω) of `frame_from_host`, two rows.
    pub by_twist: [[f64; 6]; 2],
    /// Derivative of the pixel by the inverse depth.
    pub by_inverse_depth: [f64; 2],
}

/// Projects `ray / inverse_depth` by `frame_from_host`; `None` behind the camera.
///
/// With `x = R·ray + ρ t` (homogeneous, so that points at infinity are fine): `dx = ρ υ + ω × x`.
#[inline]
pub(crate) fn predict(
    camera: &Pinhole,
    rotation: &nalgebra::Matrix3<f64>,
    translation: &Vector3<f64>,
    ray: &Vector3<f64>,
    inverse_depth: f64,
    measured: &[f64; 2],
) -> Option<Prediction> {
    let x = rotation * ray + translation * inverse_depth;
    if x.z < 1e-3 {
        return None;
    }
    let iz = 1.0 / x.z;
    let (px, py) = (x.x * iz, x.y * iz);
    let (fx, fy) = (camera.fx, camera.fy);
    let rho = inverse_depth * iz;
    let t = translation;
    Some(Prediction {
        residual: [fx * px + camera.cx - measured[0], fy * py + camera.cy - measured[1]],
        by_twist: [
            [fx * rho, 0.0, -fx * px * rho, -fx * px * py, fx * (1.0 + px * px), -fx * py],
            [0.0, fy * rho, -fy * py * rho, -fy * (1.0 + py * py), fy * px * py, fy * px],
        ],
        by_inverse_depth: [fx * iz * (t.x - px * t.z), fy * iz * (t.y - py * t.z)],
    })
}

/// Squared Mahalanobis length of a residual.
#[inline]
pub(crate) fn mahalanobis(residual: &[f64; 2], information: &[f64; 3]) -> f64 {
    let [x, y] = *residual;
    information[0] * x * x + 2.0 * information[1] * x * y + information[2] * y * y
}

impl Problem {
    /// Robust cost of all observations at the relative poses of its pairs; one that falls behind its camera costs as
    /// a large outlier.
    pub fn cost(&self, pairs: &Pairs, relative: &[Relative]) -> f64 {
        let mut seen = RobustCosts::default();
        for point in &self.points {
            for i in point.observations.clone() {
                seen.add(self.squared_residual(&relative[pairs.of(i)], point, i).unwrap_or(1e4));
            }
        }
        seen.sum() + self.calibration.as_ref().map_or(0.0, Calibration::prior_cost)
    }

    fn squared_residual(&self, relative: &Relative, point: &WindowPoint, observation: usize) -> Option<f64> {
        let seen = &self.observations[observation];
        let x = relative.transform(&point.ray, point.inverse_depth);
        if x.z < 1e-3 {
            return None;
        }
        let pixel = self.camera.project(&x);
        Some(mahalanobis(&[pixel.x - seen.pixel[0], pixel.y - seen.pixel[1]], &seen.information))
    }

    /// Squared normalised residual of each observation; infinite behind the camera.
    pub fn squared_residuals(&self) -> Vec<f64> {
        let pairs = Pairs::new(self);
        let relative = pairs.relative(&self.frames);
        let mut all = vec![f64::INFINITY; self.observations.len()];
        for point in &self.points {
            for i in point.observations.clone() {
                let value = self.squared_residual(&relative[pairs.of(i)], point, i);
                all[i] = value.unwrap_or(f64::INFINITY);
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Se3;
    use nalgebra::Vector6;

    #[test]
    fn costs_add_up() {
        let squares =
            (0..500).map(|i| f64::from(i % 17) * 1e3f64.powi(i % 5) * 1e-3).chain([1e300, 0.0, 1e-9]);
        let (mut costs, mut sum) = (RobustCosts::default(), 0.0);
        for squared in squares {
            costs.add(squared);
            sum += robust_cost(squared.min(RobustCosts::LARGE));
        }
        assert!((costs.sum() / sum - 1.0).abs() < 1e-12, "{} {sum}", costs.sum());
        costs.add(f64::NAN);
        assert!(costs.sum().is_finite(), "what is no number is as bad as can be");
    }

    #[test]
    fn jacobians_agree_with_differences() {
        let camera = Pinhole { width: 640, height: 480, fx: 500.0, fy: 480.0, cx: 320.0, cy: 240.0 };
        let pose = Se3::exp(&Vector6::new(0.3, -0.2, 0.1, 0.1, -0.2, 0.05));
        let ray = camera.unproject(120.0, 300.0);
        let at = |pose: &Se3, rho: f64| {
            predict(&camera, &pose.rotation_matrix(), &pose.translation, &ray, rho, &[0.0, 0.0]).unwrap()
        };
        let (rho, h) = (0.7, 1e-6);
        let analytic = at(&pose, rho);
        for k in 0..6 {
            let mut twist = Vector6::zeros();
            twist[k] = h;
            let (plus, minus) = (at(&(Se3::exp(&twist) * pose), rho), at(&(Se3::exp(&-twist) * pose), rho));
            for row in 0..2 {
                let numeric = (plus.residual[row] - minus.residual[row]) / (2.0 * h);
                assert!((numeric - analytic.by_twist[row][k]).abs() < 1e-4 * numeric.abs().max(1.0));
            }
        }
        let (plus, minus) = (at(&pose, rho + h), at(&pose, rho - h));
        for row in 0..2 {
            let numeric = (plus.residual[row] - minus.residual[row]) / (2.0 * h);
            assert!((numeric - analytic.by_inverse_depth[row]).abs() < 1e-4 * numeric.abs().max(1.0));
        }
    }
}
