//! The semi-dense depth filter: one inverse depth with variance per strong-gradient pixel of a keyframe,
//! from stereo with frames of known pose (Engel, Sturm, Cremers, ICCV 2013).
//!
//! ```text
//! new ─ seed ─ update × references ─ regularise ─ to_semi_dense
//! ```
//! The sparse backbone bounds the search; the first references, of short baseline, find the pixel; longer
//! baselines sharpen it. A pixel is exported when several references agree on it and its neighbours do too.

mod candidates;
mod epipolar;
mod fuse;
mod observation;
mod params;
mod prior;
mod references;
mod regularise;
mod search;
#[cfg(test)]
mod tests;
mod update;

pub(crate) use candidates::doubled_gradient;
pub use candidates::{candidate_pixels, has_hardly_any};
pub use params::DepthParams;
pub use prior::SeedPoint;
pub use references::choose_references;

use candidates::Candidates;
use geometry::sensor::Shift;
use geometry::{GrayImage, Pinhole, Se3};
use map::SemiDense;
use prior::PriorRanges;
use update::{LANES, Look, Observer, Outcome, PixelBlock};

/// Failed searches after which a pixel that was never observed is given up.
const HOPELESS: u8 = 2;
/// Growth of the variance when a hypothesis was not found again (Engel 2014).
const FAILURE_GROWTH: f32 = 1.1;

/// Candidates planned before they are observed; also the sample that an image pair's noise is learnt from.
const CHUNK: usize = 1024;

/// A frame to observe a keyframe's pixels in.
#[derive(Clone, Copy, Debug)]
pub struct StereoFrame<'a> {
    /// The frame, of the keyframe's size.
    pub image: &'a GrayImage,
    /// Its pose: maps points of the keyframe's camera frame to the frame's, keyframe units.
    pub frame_from_keyframe: Se3,
    /// Brightness `(a, b)`: `I_frame ≈ e^a · I_keyframe + b`, grey levels.
    pub brightness: (f32, f32),
    /// Standard deviation of the epipolar line's position from the poses' error, pixels.
    pub pose_sigma_px: f32,
    /// How far it is off an ideal camera's image.
    pub shift: Shift,
}

/// The outcome of one update for a keyframe's pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UpdateStats {
    /// Hypotheses with a new, agreeing observation.
    pub observed: usize,
    /// Pixels for which no single place fitted.
    pub failed: usize,
    /// Observations that contradicted the hypothesis.
    pub contradicted: usize,
    /// Pixels that were skipped: converged, given up, out of sight, or nothing to gain.
    pub skipped: usize,
}

/// What is known of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Hypothesis {
    inverse_depth: f32,
    variance: f32,
    /// Range to search before the first observation.
    prior: [f32; 2],
    successes: u8,
}

impl Hypothesis {
    #[inline(always)]
    fn is_observed(&self) -> bool {
        self.successes > 0
    }

    /// The inverse depths worth looking at.
    #[inline(always)]
    fn range(&self, sigmas: f32) -> [f32; 2] {
        let reach = sigmas * self.variance.sqrt();
        let observed =
            [(self.inverse_depth - reach).max(0.2 * self.inverse_depth), self.inverse_depth + reach];
        if self.is_observed() { observed } else { self.prior }
    }
}

/// The hypotheses of one keyframe's candidate pixels, in memory order of its image.
#[derive(Clone, Debug)]
pub struct DepthFilter {
    camera: Pinhole,
    /// How far the keyframe is off an ideal camera's image: pixels are its own, rays and depths those of that camera.
    shift: Shift,
    params: DepthParams,
    candidates: Candidates,
    ranges: PriorRanges,
    /// Range to search before the first observation.
    prior: Vec<[f32; 2]>,
    inverse_depth: Vec<f32>,
    variance: Vec<f32>,
    /// The least variance the best baseline so far can give.
    floor: Vec<f32>,
    successes: Vec<u8>,
    failures: Vec<u8>,
}

geometry::multiversion! {
    /// Observes all candidates and takes over what that tells.
    fn observe_all(filter: &mut DepthFilter, observer: &Observer, stats: &mut UpdateStats) {
        filter.observe_all_plain(observer, stats);
    }
}

impl DepthFilter {
    /// Selects the candidate pixels of a keyframe; nothing is known of their depth.
    ///
    /// An image whose size is not the camera's gets no candidates. `shift` is the shift between it and an ideal
    /// camera's image.
    pub fn new(image: &GrayImage, camera: &Pinhole, shift: Shift, params: &DepthParams) -> Self {
        let fits = image.width() == camera.width && image.height() == camera.height;
        let candidates = if fits { candidates::select(image, params) } else { Candidates::default() };
        let count = candidates.pixel.len();
        Self {
            camera: *camera,
            shift,
            params: params.clone(),
            ranges: PriorRanges::unknown(camera, params),
            prior: vec![[params.min_inverse_depth, params.max_inverse_depth]; count],
            inverse_depth: vec![0.0; count],
            variance: vec![0.0; count],
            floor: vec![0.0; count],
            successes: vec![0; count],
            failures: vec![0; count],
            candidates,
        }
    }

    /// Removes the pixels for which `counts` is false. To be called before any depth is known.
    pub fn retain(&mut self, counts: impl Fn([f32; 2]) -> bool) {
        self.candidates.retain(counts);
        let count = self.candidates.pixel.len();
        self.prior.truncate(count);
        for column in [&mut self.inverse_depth, &mut self.variance, &mut self.floor] {
            column.truncate(count);
        }
        for column in [&mut self.successes, &mut self.failures] {
            column.truncate(count);
        }
    }

    /// How many pixels have a hypothesis, observed or not.
    pub fn len(&self) -> usize {
        self.candidates.pixel.len()
    }

    /// Whether no pixel qualifies.
    pub fn is_empty(&self) -> bool {
        self.candidates.pixel.is_empty()
    }

    /// Bounds the search around the points of the sparse backbone seen in the keyframe.
    ///
    /// Points outside the image or with meaningless numbers are left out; without any, the parameters'
    /// bounds hold.
    pub fn seed(&mut self, points: &[SeedPoint]) {
        self.ranges = PriorRanges::from_points(&self.camera, points, &self.params);
        for (prior, &pixel) in self.prior.iter_mut().zip(&self.candidates.position) {
            *prior = self.ranges.at(pixel);
        }
    }

    /// Observes all pixels in one reference frame. `image` is the keyframe's own.
    ///
    /// Call with growing baselines (see [`choose_references`]). Images of another size teach nothing.
    pub fn update(&mut self, image: &GrayImage, reference: &StereoFrame) -> UpdateStats {
        let mut stats = UpdateStats::default();
        let (width, height) = (self.camera.width, self.camera.height);
        let fits = |image: &GrayImage| image.width() == width && image.height() == height;
        if !fits(image) || !fits(reference.image) || !reference.frame_from_keyframe.is_finite() {
            return UpdateStats { skipped: self.len(), ..stats };
        }
        let params = self.params.clone();
        let mut observer = Observer::new((image, self.shift), reference, &self.camera, &params);
        observer.learn_noise(&mut self.sampled_residuals(&observer));
        observe_all(self, &observer, &mut stats);
        stats
    }

    /// [`observe_all`] for any processor.
    #[inline(always)]
    fn observe_all_plain(&mut self, observer: &Observer, stats: &mut UpdateStats) {
        match observer.shifts() {
            [false, false] => self.observe_by::<false, false>(observer, stats),
            [true, false] => self.observe_by::<true, false>(observer, stats),
            [_, true] => self.observe_by::<true, true>(observer, stats),
        }
    }

    /// The same for what shifts the images' pixels (see [`Observer::shifts`]).
    #[inline(always)]
    fn observe_by<const BENT: bool, const ROLLING: bool>(
        &mut self,
        observer: &Observer,
        stats: &mut UpdateStats,
    ) {
        let mut looks = [Look::EMPTY; CHUNK];
        for start in (0..self.len()).step_by(CHUNK) {
            let chunk = start..(start + CHUNK).min(self.len());
            let size = chunk.len();
            let count = self.plan::<BENT, ROLLING>(observer, chunk, &mut looks);
            stats.skipped += size - count;
            for look in &looks[..count] {
                self.apply(look.candidate as usize, observer.observe(look), stats);
            }
        }
    }

    /// Writes the looks worth taking at `candidates` to the front of `looks` and returns their number.
    #[inline(always)]
    fn plan<const BENT: bool, const ROLLING: bool>(
        &self,
        observer: &Observer,
        candidates: impl Iterator<Item = usize>,
        looks: &mut [Look; CHUNK],
    ) -> usize {
        let (mut open, mut open_count) = ([0u32; CHUNK], 0);
        for i in candidates.take(CHUNK) {
            open[open_count] = i as u32;
            let aligned = observer.is_aligned(self.candidates.position[i], self.candidates.gradient[i]);
            open_count += (aligned & !self.is_settled(i)) as usize;
        }
        let mut count = 0;
        let mut pixels = PixelBlock::default();
        for block in open[..open_count].chunks(LANES) {
            for (lane, &candidate) in block.iter().enumerate() {
                let i = candidate as usize;
                let (position, gradient) = (self.candidates.position[i], self.candidates.gradient[i]);
                pixels.set(lane, position, gradient, &self.hypothesis(i));
            }
            let looked = observer.look_at::<BENT, ROLLING>(&pixels);
            for (lane, &candidate) in block.iter().enumerate() {
                looks[count] = looked.get(lane, candidate);
                count += looked.worthwhile[lane] as usize;
            }
        }
        count
    }

    /// Residuals of a sample of the candidates.
    fn sampled_residuals(&self, observer: &Observer) -> Vec<f32> {
        let tolerant = observer.tolerant();
        let mut looks = [Look::EMPTY; CHUNK];
        let stride = self.len().div_ceil(CHUNK).max(1);
        let count = self.plan::<true, true>(observer, (0..self.len()).step_by(stride), &mut looks);
        let residual = |look: &Look| match tolerant.observe(look) {
            Outcome::Observed { residual, .. } => Some(residual),
            _ => None,
        };
        looks[..count].iter().filter_map(residual).collect()
    }

    /// The pixels that several references agree on, with small enough variance.
    pub fn to_semi_dense(&self) -> SemiDense {
        let converged: Vec<usize> = (0..self.len()).filter(|&i| self.is_converged(i)).collect();
        SemiDense {
            pixel: converged.iter().map(|&i| self.candidates.pixel[i]).collect(),
            inverse_depth: converged.iter().map(|&i| self.inverse_depth[i]).collect(),
            variance: converged.iter().map(|&i| self.variance[i]).collect(),
        }
    }

    /// Whether the pixel is good enough for the map.
    fn is_converged(&self, i: usize) -> bool {
        let sigma = self.params.max_relative_sigma * self.inverse_depth[i];
        self.successes[i] >= self.params.min_observations
            && 2 * self.failures[i] <= self.successes[i]
            && self.variance[i] <= sigma * sigma
    }

    /// Whether nothing is to be done for the pixel: given up, or certain enough.
    #[inline(always)]
    fn is_settled(&self, i: usize) -> bool {
        let sigma = self.params.converged * self.inverse_depth[i];
        let converged =
            (self.successes[i] > self.params.min_observations) & (self.variance[i] < sigma * sigma);
        converged | ((self.successes[i] == 0) & (self.failures[i] >= HOPELESS))
    }

    /// What is known of candidate `i`.
    #[inline(always)]
    fn hypothesis(&self, i: usize) -> Hypothesis {
        Hypothesis {
            inverse_depth: self.inverse_depth[i],
            variance: self.variance[i],
            prior: self.prior[i],
            successes: self.successes[i],
        }
    }

    /// Takes over what a reference told about candidate `i`.
    #[inline(always)]
    fn apply(&mut self, i: usize, outcome: Outcome, stats: &mut UpdateStats) {
        match outcome {
            Outcome::Skipped => stats.skipped += 1,
            Outcome::Failed => {
                stats.failed += 1;
                self.fail(i);
            }
            Outcome::Observed { inverse_depth, variance, floor, .. } if self.successes[i] == 0 => {
                (self.inverse_depth[i], self.variance[i]) = (inverse_depth, variance);
                (self.floor[i], self.successes[i]) = (floor, 1);
                stats.observed += 1;
            }
            Outcome::Observed { inverse_depth, variance, floor, .. } => {
                let fused = fuse::fused(self.inverse_depth[i], self.variance[i], inverse_depth, variance);
                if let Some((d, v)) = fused {
                    self.floor[i] = self.floor[i].min(floor);
                    (self.inverse_depth[i], self.variance[i]) = (d, v.max(self.floor[i]));
                    self.successes[i] = self.successes[i].saturating_add(1);
                    stats.observed += 1;
                } else {
                    stats.contradicted += 1;
                    self.fail(i);
                }
            }
        }
    }

    /// Counts a failure; a hypothesis without majority starts again from the backbone's range.
    #[inline(always)]
    fn fail(&mut self, i: usize) {
        self.failures[i] = self.failures[i].saturating_add(1);
        self.variance[i] *= FAILURE_GROWTH;
        if self.failures[i] >= self.successes[i] {
            self.successes[i] = 0;
            self.prior[i] = self.ranges.at(self.candidates.position[i]);
        }
    }
}
