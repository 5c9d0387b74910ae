//! Observing the pixels of a keyframe in one reference frame.

use super::epipolar::{EpipolarGeometry, Line};
use super::observation::{geometric_variance, photometric_variance};
use super::search::{COMPARED, Miss, Task, Template};
use super::{DepthParams, Hypothesis, StereoFrame};
use geometry::sensor::Shift;
use geometry::{GrayImage, Pinhole, median};

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
    /// Nothing was to be learnt: out of sight.
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
    /// How far the keyframe is off an ideal camera's image.
    shift: Shift,
    reference: &'a StereoFrame<'a>,
    geometry: EpipolarGeometry,
    gain: f32,
    /// Standard deviation of one intensity of this pair, grey levels.
    noise: f32,
    params: &'a DepthParams,
}

/// Where to look for one pixel: the stretch of its epipolar line that the hypothesis allows.
///
/// Looks are prepared for many pixels before the images are read, so that the processor can work on several
/// pixels at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// The candidate.
    pub candidate: u32,
    /// The pixel in the keyframe and the direction of its epipolar line there, one pixel long.
    own: Line,
    /// The same pixel as an ideal camera sees it.
    ideal_own: [f32; 2],
    /// The line in the reference; μ = 0 is the one end of the stretch.
    line: Line,
    /// The line as an ideal camera sees it.
    ideal_line: Line,
    /// Length in template samples.
    length: f32,
    /// Squared inverse depth per template sample.
    alpha2: f32,
    /// Squared cosine between the pixel's gradient and its epipolar line.
    alignment2: f32,
}

impl Look {
    /// Fills buffers.
    pub const EMPTY: Self = Self {
        candidate: 0,
        own: Line { origin: [0.0; 2], step: [0.0; 2] },
        ideal_own: [0.0; 2],
        line: Line { origin: [0.0; 2], step: [0.0; 2] },
        ideal_line: Line { origin: [0.0; 2], step: [0.0; 2] },
        length: 0.0,
        alpha2: 0.0,
        alignment2: 0.0,
    };

    /// Numbers of a look, and those of them that [`LookBlock`] holds.
    const NUMBERS: usize = 17;

    #[inline(always)]
    fn to_numbers(self) -> [f32; Self::NUMBERS] {
        let Self { own, ideal_own, line, ideal_line, length, alpha2, alignment2, .. } = self;
        let ([a, b], [c, d], [e, f]) = (own.origin, own.step, ideal_own);
        let ([g, h], [i, j]) = (line.origin, line.step);
        let ([k, l], [m, n]) = (ideal_line.origin, ideal_line.step);
        [a, b, c, d, e, f, g, h, i, j, k, l, m, n, length, alpha2, alignment2]
    }

    #[inline(always)]
    fn from_numbers(candidate: u32, numbers: [f32; Self::NUMBERS]) -> Self {
        let [a, b, c, d, e, f, g, h, i, j, k, l, m, n, length, alpha2, alignment2] = numbers;
        Self {
            candidate,
            own: Line { origin: [a, b], step: [c, d] },
            ideal_own: [e, f],
            line: Line { origin: [g, h], step: [i, j] },
            ideal_line: Line { origin: [k, l], step: [m, n] },
            length,
            alpha2,
            alignment2,
        }
    }
}

/// Pixels that the processor can work on side by side.
pub(super) const LANES: usize = 8;

/// Some pixels and what is known of them, number by number.
#[derive(Default)]
pub(super) struct PixelBlock {
    position: [[f32; LANES]; 2],
    gradient: [[f32; LANES]; 2],
    inverse_depth: [f32; LANES],
    variance: [f32; LANES],
    prior: [[f32; LANES]; 2],
    successes: [u8; LANES],
}

impl PixelBlock {
    /// Puts a pixel at a place of the block.
    #[inline(always)]
    pub fn set(&mut self, lane: usize, position: [f32; 2], gradient: [f32; 2], known: &Hypothesis) {
        for axis in 0..2 {
            self.position[axis][lane] = position[axis];
            self.gradient[axis][lane] = gradient[axis];
            self.prior[axis][lane] = known.prior[axis];
        }
        (self.inverse_depth[lane], self.variance[lane]) = (known.inverse_depth, known.variance);
        self.successes[lane] = known.successes;
    }

    #[inline(always)]
    fn hypothesis(&self, lane: usize) -> Hypothesis {
        Hypothesis {
            inverse_depth: self.inverse_depth[lane],
            variance: self.variance[lane],
            prior: [self.prior[0][lane], self.prior[1][lane]],
            successes: self.successes[lane],
        }
    }
}

/// The looks at the pixels of a block, number by number, and which of them to take.
pub(super) struct LookBlock {
    numbers: [[f32; LANES]; Look::NUMBERS],
    /// Whether each is worth to be taken.
    pub worthwhile: [bool; LANES],
}

impl LookBlock {
    /// The look at a place of the block, which is that of `candidate`.
    #[inline(always)]
    pub fn get(&self, lane: usize, candidate: u32) -> Look {
        Look::from_numbers(candidate, std::array::from_fn(|number| self.numbers[number][lane]))
    }
}

impl<'a> Observer<'a> {
    /// Prepares the observation of a keyframe's image, so far off an ideal camera's, in `reference`.
    pub fn new(
        (image, shift): (&'a GrayImage, Shift),
        reference: &'a StereoFrame<'a>,
        camera: &Pinhole,
        params: &'a DepthParams,
    ) -> Self {
        let geometry = EpipolarGeometry::new(camera, &reference.frame_from_keyframe);
        Self {
            image,
            shift,
            reference,
            geometry,
            gain: reference.brightness.0.exp(),
            noise: params.image_noise,
            params,
        }
    }

    /// Whether a lens, and whether a rolling shutter, shifts pixels of one of the images.
    pub fn shifts(&self) -> [bool; 2] {
        let both = [self.shift, self.reference.shift];
        [both.iter().any(Shift::is_bent), both.iter().any(Shift::is_rolling)]
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
        let median = median(residuals).unwrap_or(0.0);
        let least = self.params.image_noise;
        self.noise = (0.5 * median.max(0.0) / CHI2_MEDIAN).sqrt().clamp(least, 4.0 * least);
    }

    /// Whether the pixel `(x, y)` has enough of its `gradient` along its epipolar line.
    #[inline(always)]
    pub fn is_aligned(&self, [x, y]: [f32; 2], [gx, gy]: [f32; 2]) -> bool {
        let [lx, ly] = self.geometry.direction(x, y);
        let along = gx * lx + gy * ly;
        let least = self.params.min_alignment * self.params.min_alignment;
        // False at the epipole.
        along * along > least * (gx * gx + gy * gy) * (lx * lx + ly * ly)
    }

    /// [`look`](Self::look) for a block of pixels side by side.
    #[inline(always)]
    pub fn look_at<const BENT: bool, const ROLLING: bool>(&self, pixels: &PixelBlock) -> LookBlock {
        let mut looks = LookBlock { numbers: [[0.0; LANES]; Look::NUMBERS], worthwhile: [false; LANES] };
        for lane in 0..LANES {
            let position = [pixels.position[0][lane], pixels.position[1][lane]];
            let gradient = [pixels.gradient[0][lane], pixels.gradient[1][lane]];
            let (look, worthwhile) = self.look::<BENT, ROLLING>(position, gradient, &pixels.hypothesis(lane));
            for (row, number) in looks.numbers.iter_mut().zip(look.to_numbers()) {
                row[lane] = number;
            }
            looks.worthwhile[lane] = worthwhile;
        }
        looks
    }

    /// Where to look for the pixel `(x, y)` with `gradient`, given what is known of it, and whether to look:
    /// not behind the camera, over too long a stretch, or for no gain.
    ///
    /// Free of branches: which pixels are worth a look is not predictable. What shifts pixels is told by
    /// `BENT` and `ROLLING` (see [`shifts`](Self::shifts)), so that nothing is worked out for what does not.
    #[inline(always)]
    fn look<const BENT: bool, const ROLLING: bool>(
        &self,
        [x, y]: [f32; 2],
        [gx, gy]: [f32; 2],
        known: &Hypothesis,
    ) -> (Look, bool) {
        let (params, geometry) = (self.params, &self.geometry);
        let [low, high] = known.range(params.search_sigmas);
        let [dx, dy] = match (BENT, ROLLING) {
            (_, true) => self.shift.to_undistorted([x, y], 0.5 * (low + high)),
            (true, false) => self.shift.lens_to_undistorted([x, y]),
            (false, false) => [0.0; 2],
        };
        let ideal_own = [x + dx, y + dy];
        let [lx, ly] = geometry.direction(ideal_own[0], ideal_own[1]);
        let inverse_norm = 1.0 / (lx * lx + ly * ly).sqrt();
        let direction = [lx * inverse_norm, ly * inverse_norm];
        let along = gx * direction[0] + gy * direction[1];
        let alignment2 = along * along / (gx * gx + gy * gy);
        let ray = geometry.ray(ideal_own[0], ideal_own[1], direction);
        let (centre, near) = (geometry.project(&ray, 0.5 * (low + high)), geometry.project(&ray, high));
        let far = geometry.project(&ray, low);
        let step = geometry.step(&ray, &centre);
        let step2 = step[0] * step[0] + step[1] * step[1];
        // Template samples from far to near; negative when the step points to falling inverse depth.
        let signed = ((near.u[0] - far.u[0]) * step[0] + (near.u[1] - far.u[1]) * step[1]) / step2;
        let (far_end, near_end) = ((far.u, low * far.iz), (near.u, high * near.iz));
        let (first, last) = if signed >= 0.0 { (far_end, near_end) } else { (near_end, far_end) };
        let distorted = |(u, inverse_depth)| match (BENT, ROLLING) {
            (_, true) => self.reference.shift.to_distorted(u, inverse_depth),
            (true, false) => self.reference.shift.lens_to_distorted(u),
            (false, false) => [0.0; 2],
        };
        let (begin, end) = (distorted(first), distorted(last));
        // Over less than a sample shifts do not change.
        let samples = signed.abs().max(1.0);
        let bent = [0, 1].map(|i: usize| step[i] + (end[i] - begin[i]) / samples);
        let depth_per_sample = (high - low) / signed;
        let alpha2 = depth_per_sample * depth_per_sample;
        let expected = alpha2 * self.variance(alignment2, along * along * COMPARED as f32);
        // Comparisons are false for what is not a number, as at the epipole.
        let worthwhile = near.is_in_front()
            & far.is_in_front()
            & (step2 > STEP_RANGE.start * STEP_RANGE.start)
            & (step2 < STEP_RANGE.end * STEP_RANGE.end)
            & (signed.abs() <= params.max_search)
            & (alpha2 < f32::MAX)
            & (!known.is_observed() | (expected <= params.worthwhile * known.variance));
        let look = Look {
            candidate: 0,
            own: Line { origin: [x, y], step: direction },
            ideal_own,
            line: Line { origin: [first.0[0] + begin[0], first.0[1] + begin[1]], step: bent },
            ideal_line: Line { origin: first.0, step },
            length: signed.abs(),
            alpha2,
            alignment2,
        };
        (look, worthwhile)
    }

    /// Looks there.
    #[inline(always)]
    pub fn observe(&self, look: &Look) -> Outcome {
        let bias = self.reference.brightness.1;
        let Some(template) = Template::new(self.image, &look.own, self.gain, bias) else {
            return Outcome::Skipped;
        };
        let task = Task {
            image: self.reference.image,
            line: &look.line,
            length: look.length,
            uniqueness: self.params.uniqueness,
            floor: 0.5 * self.noise2(),
        };
        let found = match template.search(&task) {
            Ok(found) => found,
            Err(Miss::Outside | Miss::TooLong) => return Outcome::Skipped,
            Err(Miss::Ambiguous | Miss::NoMinimum) => return Outcome::Failed,
        };
        let interpolation2 = INTERPOLATION_ERROR * INTERPOLATION_ERROR * template.energy;
        if found.residual > self.params.max_residual * (self.noise2() + interpolation2) {
            return Outcome::Failed;
        }
        let ray = self.geometry.ray(look.ideal_own[0], look.ideal_own[1], look.own.step);
        let inverse_depth = self.geometry.inverse_depth(&ray, look.ideal_line.at(found.mu));
        if !(inverse_depth > 0.0 && inverse_depth.is_finite()) {
            return Outcome::Failed;
        }
        let systematic2 = self.params.systematic_error * self.params.systematic_error;
        let measured = self.variance(look.alignment2, template.energy);
        // Half of the photometric noise is the keyframe's own, the same in every reference.
        let shared = 0.5 * photometric_variance(self.noise, template.energy);
        Outcome::Observed {
            inverse_depth,
            variance: look.alpha2 * (measured + systematic2),
            floor: look.alpha2 * (shared + systematic2),
            residual: found.residual - interpolation2,
        }
    }

    /// Sum of squared residuals expected from noise alone.
    #[inline(always)]
    fn noise2(&self) -> f32 {
        COMPARED as f32 * 2.0 * self.noise * self.noise
    }

    /// Disparity variance for this reference, template samples².
    #[inline(always)]
    fn variance(&self, alignment2: f32, energy: f32) -> f32 {
        geometric_variance(self.reference.pose_sigma_px, alignment2)
            + photometric_variance(self.noise, energy)
    }
}
