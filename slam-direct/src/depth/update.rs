//! Observing the pixels of a keyframe in one reference frame.

use super::epipolar::{COMPARED, EpipolarGeometry, Line, Ray, Search, search};
use super::observation::{Match, Template, disparity_variance};
use super::{DepthParams, Hypothesis, StereoFrame};
use geometry::{GrayImage, Pinhole};

/// Steps between keyframe and reference along the line beyond which the views differ too much in scale.
const STEP_RANGE: std::ops::Range<f32> = 0.6..1.7;
/// A range no longer than this is refined from its middle without a search, template samples.
const NO_SEARCH: f32 = 1.6;
/// Disparity error of sub-pixel interpolation, as tolerated residual per gradient, pixels.
const INTERPOLATION_ERROR: f32 = 0.15;

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
    },
}

/// A keyframe and a reference, with what all pixels share.
pub(super) struct Observer<'a> {
    image: &'a GrayImage,
    reference: &'a StereoFrame<'a>,
    geometry: EpipolarGeometry,
    gain: f32,
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
        Self { image, reference, geometry, gain: reference.brightness.0.exp(), params }
    }

    /// Observes the pixel `(x, y)` with `gradient`, given what is known of it.
    pub fn observe(&self, x: f32, y: f32, gradient: [f32; 2], known: &Hypothesis) -> Outcome {
        let Some(direction) = self.geometry.direction(x, y) else {
            return Outcome::Skipped;
        };
        let along = gradient[0] * direction[0] + gradient[1] * direction[1];
        let alignment = along.abs() / (gradient[0] * gradient[0] + gradient[1] * gradient[1]).sqrt();
        if alignment < self.params.min_alignment {
            return Outcome::Skipped;
        }
        let ray = self.geometry.ray(x, y, direction);
        let Some(segment) = self.segment(&ray, known) else {
            return Outcome::Skipped;
        };
        let alpha2 = segment.depth_per_sample * segment.depth_per_sample;
        let expected = alpha2 * self.variance(alignment, along * along * COMPARED as f32);
        if known.is_observed() && expected > self.params.worthwhile * known.variance {
            return Outcome::Skipped;
        }
        let own_line = Line { origin: [x, y], step: direction };
        let template = Template::new(self.image, &own_line, self.gain, self.reference.brightness.1);
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
                    variance: alpha2 * (self.variance(alignment, template.energy) + systematic * systematic),
                    floor: alpha2 * systematic * systematic,
                }
            }
        }
    }

    /// Disparity variance for this reference, template samples².
    fn variance(&self, alignment: f32, energy: f32) -> f32 {
        disparity_variance(alignment, energy, self.params.image_noise, self.reference.pose_sigma_px)
    }

    /// The stretch of the line in the reference that the hypothesis allows.
    #[inline]
    fn segment(&self, ray: &Ray, known: &Hypothesis) -> Option<Segment> {
        let [low, high] = known.range(self.params.search_sigmas);
        let middle = 0.5 * (low + high);
        let geometry = &self.geometry;
        let (near, far) = (geometry.project(ray, high)?, geometry.project(ray, low)?);
        let centre = geometry.project(ray, middle)?;
        let step = geometry.step(ray, centre, middle);
        let step2 = step[0] * step[0] + step[1] * step[1];
        if !(STEP_RANGE.start * STEP_RANGE.start..STEP_RANGE.end * STEP_RANGE.end).contains(&step2) {
            return None;
        }
        // The step may point to growing or to falling inverse depth.
        let signed = ((near[0] - far[0]) * step[0] + (near[1] - far[1]) * step[1]) / step2;
        let origin = if signed >= 0.0 { far } else { near };
        let velocity = geometry.velocity(ray, centre, middle);
        let speed2 = velocity[0] * velocity[0] + velocity[1] * velocity[1];
        let depth_per_sample = (step2 / speed2).sqrt();
        depth_per_sample.is_finite().then_some(Segment {
            line: Line { origin, step },
            length: signed.abs(),
            depth_per_sample,
        })
    }

    /// Searches, refines and tests the match.
    #[inline]
    fn find(&self, segment: &Segment, template: &Template) -> Result<Match, Outcome> {
        let params = self.params;
        let image = self.reference.image;
        let noise2 = COMPARED as f32 * 2.0 * params.image_noise * params.image_noise;
        let start = if segment.length <= NO_SEARCH {
            0.5 * segment.length
        } else if segment.length > params.max_search {
            return Err(Outcome::Skipped);
        } else {
            let floor = 0.5 * noise2;
            match search(image, &segment.line, segment.length, &template.values, params.uniqueness, floor) {
                Search::Found(mu) => mu,
                Search::Outside | Search::TooLong => return Err(Outcome::Skipped),
                Search::Ambiguous => return Err(Outcome::Failed),
            }
        };
        let found = template.refine(image, &segment.line, start).ok_or(Outcome::Failed)?;
        let interpolation2 = INTERPOLATION_ERROR * INTERPOLATION_ERROR * template.energy;
        if found.residual > params.max_residual * (noise2 + interpolation2) {
            return Err(Outcome::Failed);
        }
        Ok(found)
    }
}
