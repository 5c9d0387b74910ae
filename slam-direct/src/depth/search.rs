//! The search for a keyframe pixel along its epipolar line in a reference.

use super::epipolar::{BLOCK, Line};
use geometry::GrayImage;

/// Samples compared: five, one pixel apart, as in Engel, Sturm, Cremers, ICCV 2013.
pub(super) const COMPARED: usize = 5;
/// Samples compared on either side of the pixel.
const HALF: f32 = (COMPARED / 2) as f32;
/// Samples taken of the template, in whole blocks: one more on either side, for the gradients.
const TEMPLATE: usize = (COMPARED + 2).next_multiple_of(BLOCK);
/// Steps by which a search runs beyond its range on either side at least.
const PADDING: f32 = 1.5;
/// Positions of a short search; most are, as hypotheses soon get certain.
const FEW_POSITIONS: usize = 2 * BLOCK;
/// Positions of the next larger search.
const SOME_POSITIONS: usize = 4 * BLOCK;
/// Most positions of one search.
const MAX_POSITIONS: usize = 27 * BLOCK;
/// Samples needed beyond the positions, in whole blocks.
const MARGIN: usize = (COMPARED - 1).next_multiple_of(BLOCK);

/// The keyframe's samples along the epipolar line through a pixel, with what the search needs of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Template {
    /// Intensities in the reference's brightness.
    values: [f32; COMPARED],
    /// Their central differences.
    gradients: [f32; COMPARED],
    /// Sum of squared differences.
    pub energy: f32,
}

/// A place that fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Match {
    /// Position on the line, template samples.
    pub mu: f32,
    /// Sum of squared residuals of the [`COMPARED`] samples.
    pub residual: f32,
}

/// Why no place was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Miss {
    /// The line leaves the image.
    Outside,
    /// The range is longer than one search takes.
    TooLong,
    /// Another position fits about as well.
    Ambiguous,
    /// The best position lies at the end of the range, or is no minimum.
    NoMinimum,
}

/// What to search where.
#[derive(Clone, Copy)]
pub(super) struct Task<'a> {
    /// The image to search in.
    pub image: &'a GrayImage,
    /// The line to search on.
    pub line: &'a Line,
    /// The range `μ ∈ [0, length]`, template samples.
    pub length: f32,
    /// A second minimum (2 or more steps away) below this multiple of the best makes the match ambiguous.
    pub uniqueness: f32,
    /// The sum of squared differences expected from noise alone: minima below it cannot be told apart.
    pub floor: f32,
}

impl Template {
    /// Samples `image` along `line`, centred at μ = 0, and applies the brightness `gain · I + bias`;
    /// `None` at the border of the image.
    #[inline(always)]
    pub fn new(image: &GrayImage, line: &Line, gain: f32, bias: f32) -> Option<Self> {
        let mut samples = [0.0; TEMPLATE];
        if !line.sample(image, -HALF - 1.0, &mut samples) {
            return None;
        }
        let (mut values, mut gradients, mut energy) = ([0.0; COMPARED], [0.0; COMPARED], 0.0);
        for j in 0..COMPARED {
            values[j] = gain * samples[j + 1] + bias;
            gradients[j] = 0.5 * gain * (samples[j + 2] - samples[j]);
            energy += gradients[j] * gradients[j];
        }
        Some(Self { values, gradients, energy })
    }

    /// Searches for the least sum of squared differences.
    #[inline(always)]
    pub fn search(&self, task: &Task) -> Result<Match, Miss> {
        let needed = task.length + 1.0 + 2.0 * PADDING;
        // Searches of few positions are of known size, so that the compiler unrolls them.
        if needed <= FEW_POSITIONS as f32 {
            let (mut samples, mut sums) = ([0.0; FEW_POSITIONS + MARGIN], [0.0; FEW_POSITIONS]);
            self.search_in(task, &mut samples, &mut sums)
        } else if needed <= SOME_POSITIONS as f32 {
            let (mut samples, mut sums) = ([0.0; SOME_POSITIONS + MARGIN], [0.0; SOME_POSITIONS]);
            self.search_in(task, &mut samples, &mut sums)
        } else if needed <= MAX_POSITIONS as f32 {
            let positions = (needed.ceil() as usize).next_multiple_of(BLOCK);
            let (mut samples, mut sums) = ([0.0; MAX_POSITIONS + MARGIN], [0.0; MAX_POSITIONS]);
            self.search_in(task, &mut samples[..positions + MARGIN], &mut sums[..positions])
        } else {
            Err(Miss::TooLong)
        }
    }

    /// The search over as many positions as `sums` holds, the range in their middle.
    #[inline(always)]
    fn search_in(&self, task: &Task, samples: &mut [f32], sums: &mut [f32]) -> Result<Match, Miss> {
        let first = 0.5 * (task.length - (sums.len() - 1) as f32);
        if !task.line.sample(task.image, first - HALF, samples) {
            return Err(Miss::Outside);
        }
        for (start, block) in sums.chunks_exact_mut(BLOCK).enumerate() {
            let window = &samples[start * BLOCK..start * BLOCK + BLOCK + MARGIN];
            let mut sum = [0.0f32; BLOCK];
            for (j, &value) in self.values.iter().enumerate() {
                for k in 0..BLOCK {
                    let difference = window[j + k] - value;
                    sum[k] += difference * difference;
                }
            }
            block.copy_from_slice(&sum);
        }
        let best = unique_minimum(sums, task.uniqueness, task.floor)?;
        let (offset, residual) = self.refine(&samples[best - 1..best + COMPARED + 1])?;
        Ok(Match { mu: first + best as f32 + offset, residual })
    }

    /// Sub-pixel offset of the match from the middle of `samples` ([`COMPARED`] + 2 of them), and its residual.
    ///
    /// Gauss–Newton along the line solves `Σ g (I(μ) − T) = 0` with the template's gradients g; with linear
    /// interpolation between samples that sum is linear between two positions, so its root is found at once.
    #[inline(always)]
    fn refine(&self, samples: &[f32]) -> Result<(f32, f32), Miss> {
        let mut sums = [0.0f32; 3];
        for j in 0..COMPARED {
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum += self.gradients[j] * (samples[j + k] - self.values[j]);
            }
        }
        // The sum grows through its root, as the samples' gradients resemble the template's.
        let start = (sums[1] <= 0.0) as usize;
        let (low, high) = (sums[start], sums[start + 1]);
        if !(low <= 0.0 && high >= 0.0 && high > low) {
            return Err(Miss::NoMinimum);
        }
        let fraction = low / (low - high);
        let mut residual = 0.0;
        for j in 0..COMPARED {
            let (a, b) = (samples[start + j], samples[start + j + 1]);
            let r = a + fraction * (b - a) - self.values[j];
            residual += r * r;
        }
        Ok((start as f32 - 1.0 + fraction, residual))
    }
}

/// The position of the least sum, if it is an inner one and no other minimum comes near it.
#[inline(always)]
fn unique_minimum(sums: &[f32], uniqueness: f32, floor: f32) -> Result<usize, Miss> {
    // Positive floats order like their bits: with the position in the lowest bits one integer minimum finds both.
    const MASK: u32 = 127;
    const { assert!(MAX_POSITIONS <= MASK as usize) };
    let key = sums.iter().zip(0..).fold(u32::MAX, |key, (sum, k)| key.min(sum.to_bits() & !MASK | k));
    let best = (key & MASK) as usize;
    if best == 0 || best >= sums.len() - 1 {
        return Err(Miss::NoMinimum);
    }
    let limit = uniqueness * sums[best].max(floor);
    let rivals = sums.windows(3).zip(1usize..).fold(false, |any, (w, k)| {
        any | ((w[1] < limit) & (w[1] <= w[0]) & (w[1] <= w[2]) & (k.abs_diff(best) >= 2))
    });
    if rivals { Err(Miss::Ambiguous) } else { Ok(best) }
}
