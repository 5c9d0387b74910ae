//! How certain one observation is.

use super::search::COMPARED;

/// Variance of a disparity measured along the line, pixels².
///
/// `alignment2` is the squared cosine between gradient and line, `energy` the sum of squared gradients along the line
/// per pixel², `noise` the standard deviation of one intensity, `line_error` that of the line's position.
/// The geometric and photometric parts of Engel, Sturm and Cremers, ICCV 2013, Eq. 8 and 10, the latter for a
/// template of several samples.
#[inline(always)]
pub(super) fn disparity_variance(alignment2: f32, energy: f32, noise: f32, line_error: f32) -> f32 {
    // Noise adds to the energy it is measured against: half its variance per sample.
    let noise2 = noise * noise;
    let energy = (energy - 0.5 * noise2 * COMPARED as f32).max(0.2 * energy);
    line_error * line_error / alignment2 + 2.0 * noise2 / energy
}
