//! Observing the pixels of a keyframe in one reference frame.

use super::epipolar::{EpipolarGeometry, Line, Ray};
use super::observation::disparity_variance;
use super::search::{COMPARED, Match, Miss, Task, Template};
use super::{DepthParams, Hypothesis, StereoFrame};
use geometry::{GrayImage, Pinhole};

/// Steps between keyframe and reference along the line beyond which the views differ too much in scale.
const STEP_RANGE: std::ops::Range<f32> = 0.6..1.7;
/// Disparity error of sub-pixel interpolation, as tolerated residual per gradient, pixels.
const INTERPOLATION_ERROR: f32 = 0.15;

/// Matches needed to learn the noise.
const LEAST_RESIDUALS: usize = 100;
/// Median of a sum of squares of [`COMPARED`] residuals of unit variance, of which one is spent on the match.
const CHI2_MEDIAN: f32 = 3.36;

/// What one reference told about a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Outcome {
    /// Nothing was to be learnt: out of sight, no gradient along the line, or no gain in certainty.
    Skipped,
    /// No single place fits.
    Failed,
    /// A match.
    Observed {
        /// Inverse depth.
        inverse_depth: f32,
        /// Its variance.
        variance: f32,
        /// The part of it that more observations of this baseline do not average out.
        floor: f32,
        /// Sum of squared residuals beyond what interpolation explains.
        residual: f32,
    },
}

/// A keyframe and a reference, with what all pixels share.
#[derive(Clone)]
pub(super) struct Observer<'a> {
    image: &'a GrayImage,
    reference: &'a StereoFrame<'a>,
    geometry: EpipolarGeometry,
    gain: f32,
    /// Standard deviation of one intensity of this pair, grey levels.
    noise: f32,
    params: &'a DepthParams,
}

/// The stretch of the epipolar line to look at.
struct Segment {
    line: Line,
    /// Length in template samples.
    length: f32,
    /// Inverse depth per template sample, absolute.
    depth_per_sample: f32,
}

impl<'a> Observer<'a> {
    /// Prepares the observation of keyframe `image` in `reference`.
    pub fn new(
        image: &'a GrayImage,
        reference: &'a StereoFrame<'a>,
        camera: &Pinhole,
        params: &'a DepthParams,
    ) -> Self {
        let geometry = EpipolarGeometry::new(camera, &reference.frame_from_keyframe);
        Self { image, reference, geometry, gain: reference.brightness.0.exp(), noise: params.image_noise, params }
    }

    /// The same observer for noise four times as large: it refuses little.
    pub fn tolerant(&self) -> Self {
        Self { noise: 4.0 * self.noise, ..self.clone() }
    }

    /// Sets the noise from residuals: the median of matches' mean squared residuals beyond what interpolation
    /// explains, not below `params.image_noise` and not above four times that. Few matches change nothing.
    pub fn learn_noise(&mut self, residuals: &mut [f32]) {
        if residuals.len() < LEAST_RESIDUALS {
            return;
        }
        let middle = residuals.len() / 2;
        let (_, &mut median, _) = residuals.select_nth_unstable_by(middle, f32::total_cmp);
        let least = self.params.image_noise;
        self.noise = (0.5 * median.max(0.0) / CHI2_MEDIAN).sqrt().clamp(least, 4.0 * least);
    }

    /// Observes the pixel `(x, y)` with `gradient`, given what is known of it.
    pub fn observe(&self, x: f32, y: f32, gradient: [f32; 2], known: &Hypothesis) -> Outcome {
        let [lx, ly] = self.geometry.direction(x, y);
        let [gx, gy] = gradient;
        let (dot, norm2) = (gx * lx + gy * ly, lx * lx + ly * ly);
        let least = self.params.min_alignment * self.params.min_alignment;
        let gradient2 = gx * gx + gy * gy;
        // Also refuses the epipole, where the direction vanishes.
        if dot * dot <= least * gradient2 * norm2 {
            return Outcome::Skipped;
        }
        let inverse_norm = 1.0 / norm2.sqrt();
        let direction = [lx * inverse_norm, ly * inverse_norm];
        let along = dot * inverse_norm;
        let alignment2 = along * along / gradient2;
        let ray = self.geometry.ray(x, y, direction);
        let Some(segment) = self.segment(&ray, known) else {
            return Outcome::Skipped;
        };
        let alpha2 = segment.depth_per_sample * segment.depth_per_sample;
        let expected = alpha2 * self.variance(alignment2, along * along * COMPARED as f32);
        if known.is_observed() && expected > self.params.worthwhile * known.variance {
            return Outcome::Skipped;
        }
        let own_line = Line { origin: [x, y], step: direction };
        let bias = self.reference.brightness.1;
        let Some(template) = Template::new(self.image, &own_line, self.gain, bias) else {
            return Outcome::Skipped;
        };
        if template.energy < COMPARED as f32 * 0.25 * self.params.min_gradient * self.params.min_gradient {
            return Outcome::Skipped;
        }
        match self.find(&segment, &template) {
            Err(outcome) => outcome,
            Ok(found) => {
                let d = self.geometry.inverse_depth(&ray, segment.line.at(found.mu));
                if !(d > 0.0 && d.is_finite()) {
                    return Outcome::Failed;
                }
                let systematic = self.params.systematic_error;
                Outcome::Observed {
                    inverse_depth: d,
                    variance: alpha2 * (self.variance(alignment2, template.energy) + systematic * systematic),
                    floor: alpha2 * systematic * systematic,
                    residual: found.residual - interpolation2(&template),
                }
            }
        }
    }

    /// Disparity variance for this reference, template samples².
    fn variance(&self, alignment2: f32, energy: f32) -> f32 {
        disparity_variance(alignment2, energy, self.noise, self.reference.pose_sigma_px)
    }

    /// The stretch of the line in the reference that the hypothesis allows.
    #[inline]
    fn segment(&self, ray: &Ray, known: &Hypothesis) -> Option<Segment> {
        let geometry = &self.geometry;
        let [low, high] = known.range(self.params.search_sigmas);
        let middle = 0.5 * (low + high);
        let centre = geometry.project(ray, middle)?;
        let step = geometry.step(ray, &centre);
        let step2 = step[0] * step[0] + step[1] * step[1];
        if !(STEP_RANGE.start * STEP_RANGE.start..STEP_RANGE.end * STEP_RANGE.end).contains(&step2) {
            return None;
        }
        let velocity = geometry.velocity(&centre);
        // Template samples per inverse depth; negative when the step points to falling inverse depth.
        let rate = (velocity[0] * step[0] + velocity[1] * step[1]) / step2;
        let (origin, length) = if known.is_observed() {
            let half = 0.5 * rate.abs() * (high - low);
            ([centre.u[0] - half * step[0], centre.u[1] - half * step[1]], 2.0 * half)
        } else {
            let (near, far) = (geometry.project(ray, high)?.u, geometry.project(ray, low)?.u);
            let signed = ((near[0] - far[0]) * step[0] + (near[1] - far[1]) * step[1]) / step2;
            (if signed >= 0.0 { far } else { near }, signed.abs())
        };
        let depth_per_sample = 1.0 / rate.abs();
        depth_per_sample.is_finite().then_some(Segment { line: Line { origin, step }, length, depth_per_sample })
    }

    /// Searches, refines and tests the match.
    #[inline]
    fn find(&self, segment: &Segment, template: &Template) -> Result<Match, Outcome> {
        let params = self.params;
        if segment.length > params.max_search {
            return Err(Outcome::Skipped);
        }
        let noise2 = COMPARED as f32 * 2.0 * self.noise * self.noise;
        let task = Task {
            image: self.reference.image,
            line: &segment.line,
            length: segment.length,
            uniqueness: params.uniqueness,
            floor: 0.5 * noise2,
        };
        let found = template
            .search(&task)
            .map_err(|miss| match miss {
                Miss::Outside | Miss::TooLong => Outcome::Skipped,
                Miss::Ambiguous | Miss::NoMinimum => Outcome::Failed,
            })?;
        if found.residual > params.max_residual * (noise2 + interpolation2(template)) {
            return Err(Outcome::Failed);
        }
        Ok(found)
    }
}

/// Squared residuals expected from interpolation.
#[inline]
fn interpolation2(template: &Template) -> f32 {
    INTERPOLATION_ERROR * INTERPOLATION_ERROR * template.energy
}
