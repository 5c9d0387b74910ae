//! Taking over the hypotheses of another keyframe.

use super::{DepthFilter, NO_CANDIDATE};
use geometry::Se3;
use nalgebra::Vector3;

/// Largest difference of intensity between a hypothesis and the pixel it falls on, grey levels.
const MAX_INTENSITY_DIFFERENCE: i32 = 30;
/// Prediction noise: standard deviation added to a propagated inverse depth, as a share of it.
const PREDICTION_NOISE: f32 = 0.02;

impl DepthFilter {
    /// Narrows the search around the converged hypotheses of `other`, moved by `self_from_other`.
    ///
    /// `d₁ = (1/d₀ + t_z)⁻¹` for the moved ray, `V₁ = (d₁/d₀)⁴ V₀ + σ_p²`; of two that fall on one pixel the
    /// nearer stays, as it hides the other (Engel, Sturm, Cremers, ICCV 2013, §2.3). A propagated depth is no
    /// observation: it only says where to look, so nothing is counted twice. Call it after
    /// [`DepthFilter::seed`] and before [`DepthFilter::update`].
    pub fn propagate_from(&mut self, other: &DepthFilter, self_from_other: &Se3) {
        let mut nearest = vec![0.0f32; self.len()];
        let width = self.camera.width;
        for i in (0..other.len()).filter(|&i| other.is_converged(i)) {
            let pixel = other.candidates.pixel[i] as usize;
            let (x, y) = ((pixel % other.camera.width) as f64, (pixel / other.camera.width) as f64);
            let d0 = other.inverse_depth[i];
            let ray = other.camera.unproject(x, y);
            let point: Vector3<f64> =
                self_from_other.rotation * ray + self_from_other.translation * d0 as f64;
            if point.z < 0.1 {
                continue;
            }
            let u = self.camera.project(&point);
            if !(u.x > -0.5 && u.y > -0.5) {
                continue;
            }
            let (ux, uy) = ((u.x + 0.5) as usize, (u.y + 0.5) as usize);
            if ux >= width || uy >= self.camera.height {
                continue;
            }
            let j = self.index[uy * width + ux];
            if j == NO_CANDIDATE {
                continue;
            }
            let j = j as usize;
            let difference = self.intensity[j] as i32 - other.intensity[i] as i32;
            let d1 = d0 / point.z as f32;
            if difference.abs() > MAX_INTENSITY_DIFFERENCE || d1 <= nearest[j] {
                continue;
            }
            nearest[j] = d1;
            let prediction = PREDICTION_NOISE * d1;
            let sigma = ((d1 / d0).powi(4) * other.variance[i] + prediction * prediction).sqrt();
            let reach = self.params.search_sigmas * sigma;
            self.prior[j] = [(d1 - reach).max(0.2 * d1), d1 + reach];
        }
    }
}
