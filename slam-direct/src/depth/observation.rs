//! How certain one observation is (Engel, Sturm, Cremers, ICCV 2013, §2.2).

use super::search::COMPARED;

/// Variance of a disparity from the error of the epipolar line's position, pixels² (Eq. 8).
///
/// `line_error` is the standard deviation of that position, `alignment2` the squared cosine between the pixel's
/// gradient and the line: the flatter they meet, the further an error of the line moves the match.
#[inline(always)]
pub(super) fn geometric_variance(line_error: f32, alignment2: f32) -> f32 {
    line_error * line_error / alignment2
}

/// Variance of a disparity from image noise, pixels² (Eq. 10, for a template of several samples).
///
/// `noise` is the standard deviation of one intensity, `energy` the sum of squared gradients along the line.
/// Keyframe and reference contribute one half each.
#[inline(always)]
pub(super) fn photometric_variance(noise: f32, energy: f32) -> f32 {
    // Noise adds to the energy it is measured against: half its variance per sample.
    let noise2 = noise * noise;
    let energy = (energy - 0.5 * noise2 * COMPARED as f32).max(0.2 * energy);
    2.0 * noise2 / energy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variances_grow_with_noise_and_fall_with_gradient() {
        assert_eq!(geometric_variance(0.5, 1.0), 0.25);
        assert!(geometric_variance(0.5, 0.25) > geometric_variance(0.5, 1.0));
        // Five samples of gradient 10, noise 1: 2 / (500 − 2.5).
        assert!((photometric_variance(1.0, 500.0) - 2.0 / 497.5).abs() < 1e-6);
        assert!(photometric_variance(2.0, 500.0) > 4.0 * photometric_variance(1.0, 500.0));
        // All gradient may be noise: the variance stays finite.
        assert!(photometric_variance(10.0, 100.0).is_finite());
    }
}
