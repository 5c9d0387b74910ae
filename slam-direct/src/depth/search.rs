//! The search for a keyframe pixel along its epipolar line in a reference.

use super::epipolar::Line;
use geometry::GrayImage;

/// Samples of the template, one pixel apart along the epipolar line; the outermost only serve the gradients.
const TEMPLATE: usize = COMPARED + 2;
/// Samples compared: five, as in Engel, Sturm, Cremers, ICCV 2013.
pub(super) const COMPARED: usize = 5;
/// Samples compared on either side of the pixel.
const HALF: f32 = (COMPARED / 2) as f32;
/// Steps by which a search runs beyond its range on either side.
const PADDING: usize = 2;
/// Most positions of one search.
const MAX_POSITIONS: usize = 108;
/// Longest range of one search, template samples.
pub(super) const MAX_LENGTH: f32 = (MAX_POSITIONS - 2 * PADDING - 2) as f32;

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
    /// The range is longer than [`MAX_LENGTH`].
    TooLong,
    /// Another position fits about as well.
    Ambiguous,
    /// The best position lies at the end of the range, or is no minimum.
    NoMinimum,
}

/// What to search where.
#[derive(Clone, Copy)]
struct Task<'a> {
    image: &'a GrayImage,
    line: &'a Line,
    positions: usize,
    uniqueness: f32,
    floor: f32,
}

impl Template {
    /// Samples `image` along `line`, centred at μ = 0, and applies the brightness `gain · I + bias`;
    /// `None` at the border of the image.
    #[inline]
    pub fn new(image: &GrayImage, line: &Line, gain: f32, bias: f32) -> Option<Self> {
        let mut samples = [0.0; TEMPLATE];
        if !line.sample(image, -HALF - 1.0, &mut samples) {
            return None;
        }
        let values: [f32; COMPARED] = std::array::from_fn(|j| gain * samples[j + 1] + bias);
        let gradients: [f32; COMPARED] = std::array::from_fn(|j| 0.5 * gain * (samples[j + 2] - samples[j]));
        let energy = gradients.iter().map(|g| g * g).sum();
        Some(Self { values, gradients, energy })
    }

    /// Searches `μ ∈ [0, length]` on `line` for the least sum of squared differences.
    ///
    /// A second minimum (2 or more steps away) below `uniqueness` times the best one makes it ambiguous;
    /// `floor` is the sum expected from noise alone, below which minima cannot be told apart.
    pub fn search(
        &self,
        image: &GrayImage,
        line: &Line,
        length: f32,
        uniqueness: f32,
        floor: f32,
    ) -> Result<Match, Miss> {
        // Most searches are short: they get a small buffer, as clearing a large one takes longer than they do.
        let positions = length.min(MAX_LENGTH + 1.0).ceil() as usize + 1 + 2 * PADDING;
        let task = Task { image, line, positions, uniqueness, floor };
        match positions {
            ..=8 => self.search_within::<12, 8>(&task),
            ..=16 => self.search_within::<20, 16>(&task),
            ..=32 => self.search_within::<36, 32>(&task),
            ..=MAX_POSITIONS => self.search_within::<{ MAX_POSITIONS + COMPARED - 1 }, MAX_POSITIONS>(&task),
            _ => Err(Miss::TooLong),
        }
    }

    /// The search with room for `POSITIONS` positions and their `SAMPLES = POSITIONS + COMPARED − 1` samples.
    #[inline]
    fn search_within<const SAMPLES: usize, const POSITIONS: usize>(&self, task: &Task) -> Result<Match, Miss> {
        let Task { image, line, positions, uniqueness, floor } = *task;
        let first = -(PADDING as f32);
        let mut samples = [0.0f32; SAMPLES];
        if !line.sample(image, first - HALF, &mut samples[..positions + COMPARED - 1]) {
            return Err(Miss::Outside);
        }
        // All positions of the buffer, asked for or not: a loop of known length needs no remainder.
        let mut sums = [0.0f32; POSITIONS];
        for (j, &value) in self.values.iter().enumerate() {
            for (sum, &sample) in sums.iter_mut().zip(&samples[j..j + POSITIONS]) {
                let difference = sample - value;
                *sum += difference * difference;
            }
        }
        let best = unique_minimum(&sums[..positions], uniqueness, floor)?;
        let (offset, residual) = self.refine(&samples[best - 1..best + COMPARED + 1])?;
        Ok(Match { mu: first + best as f32 + offset, residual })
    }

    /// Sub-pixel offset of the match from the middle of `samples` ([`COMPARED`] + 2 of them), and its residual.
    ///
    /// Gauss–Newton along the line solves `Σ g (I(μ) − T) = 0` with the template's gradients g; with linear
    /// interpolation between samples that sum is linear between two positions, so its root is found at once.
    #[inline]
    fn refine(&self, samples: &[f32]) -> Result<(f32, f32), Miss> {
        let slope = |start: usize| -> f32 {
            let window = samples[start..start + COMPARED].iter().zip(&self.values);
            window.zip(&self.gradients).map(|((s, t), g)| g * (s - t)).sum()
        };
        // The sum grows through its root, as the samples' gradients resemble the template's.
        let here = slope(1);
        let (start, low, high) =
            if here > 0.0 { (0, slope(0), here) } else { (1, here, slope(2)) };
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
#[inline]
fn unique_minimum(sums: &[f32], uniqueness: f32, floor: f32) -> Result<usize, Miss> {
    // Positive floats order like their bits: with the position in the lowest bits one integer minimum finds both.
    const MASK: u32 = 127;
    const { assert!(MAX_POSITIONS <= MASK as usize) };
    let key = sums.iter().zip(0..).fold(u32::MAX, |key, (sum, k)| key.min(sum.to_bits() & !MASK | k));
    let best = (key & MASK) as usize;
    if best == 0 || best == sums.len() - 1 {
        return Err(Miss::NoMinimum);
    }
    let limit = uniqueness * sums[best].max(floor);
    let is_rival =
        |k: usize| sums[k] < limit && k.abs_diff(best) >= 2 && sums[k] <= sums[k - 1] && sums[k] <= sums[k + 1];
    if (1..sums.len() - 1).any(is_rival) { Err(Miss::Ambiguous) } else { Ok(best) }
}
