//! One observation: sub-pixel disparity along the epipolar line, and how certain it is.

use super::epipolar::{COMPARED, Line, TEMPLATE};
use geometry::GrayImage;

/// Gauss–Newton steps along the line at most.
const MAX_STEPS: usize = 4;
/// A step shorter than this ends the refinement, template samples.
const CONVERGED_STEP: f32 = 0.02;
/// A refinement that moves further than this has left the minimum it was started in, template samples.
const MAX_MOVE: f32 = 1.5;

/// A refined match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Match {
    /// Position on the line, template samples.
    pub mu: f32,
    /// Sum of squared residuals of the [`COMPARED`] samples.
    pub residual: f32,
}

/// The keyframe's samples along the epipolar line through a pixel, with what the refinement needs of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Template {
    /// Intensities in the reference's brightness.
    pub values: [f32; TEMPLATE],
    /// Central differences of the inner samples.
    gradients: [f32; COMPARED],
    /// Sum of squared gradients.
    pub energy: f32,
}

impl Template {
    /// Samples `image` along `line` (centred at μ = 0) and applies the brightness `gain · I + bias`.
    #[inline]
    pub fn new(image: &GrayImage, line: &Line, gain: f32, bias: f32) -> Self {
        let mut values = [0.0; TEMPLATE];
        line.sample(image, -((TEMPLATE / 2) as f32), &mut values);
        values.iter_mut().for_each(|v| *v = gain * *v + bias);
        let gradients = std::array::from_fn(|j| 0.5 * (values[j + 2] - values[j]));
        let energy = gradients.iter().map(|g| g * g).sum();
        Self { values, gradients, energy }
    }

    /// Refines a match by Gauss–Newton along `line` from `mu`; `None` when it leaves its minimum or the image.
    #[inline]
    pub fn refine(&self, image: &GrayImage, line: &Line, start: f32) -> Option<Match> {
        let half = (COMPARED / 2) as f32;
        let mut mu = start;
        let mut samples = [0.0f32; COMPARED];
        for _ in 0..MAX_STEPS {
            if !line.inside(image, mu - half, mu + half) {
                return None;
            }
            line.sample(image, mu - half, &mut samples);
            let (mut gradient, mut residual) = (0.0, 0.0);
            for j in 0..COMPARED {
                let r = samples[j] - self.values[j + 1];
                gradient += self.gradients[j] * r;
                residual += r * r;
            }
            let step = gradient / self.energy;
            mu -= step;
            if (mu - start).abs() > MAX_MOVE {
                return None;
            }
            if step.abs() < CONVERGED_STEP {
                return Some(Match { mu, residual });
            }
        }
        None
    }
}

/// Variance of a disparity measured along the line, pixels².
///
/// `alignment` is the cosine between gradient and line, `energy` the sum of squared gradients along the line
/// per pixel², `noise` the standard deviation of one intensity, `line_error` that of the line's position.
/// The geometric and photometric parts of Engel, Sturm and Cremers, ICCV 2013, Eq. 8 and 10, the latter for a
/// template of several samples.
#[inline]
pub(super) fn disparity_variance(alignment: f32, energy: f32, noise: f32, line_error: f32) -> f32 {
    // Noise adds to the energy it is measured against: half its variance per sample.
    let noise2 = noise * noise;
    let energy = (energy - 0.5 * noise2 * COMPARED as f32).max(0.2 * energy);
    line_error * line_error / (alignment * alignment) + 2.0 * noise2 / energy
}
