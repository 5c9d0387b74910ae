//! The descriptor of a key point: 4 × 4 histograms of 8 gradient directions (Lowe 2004, §6).
//!
//! As its surroundings are sampled on a grid that is turned and sized as the key point is, what a sample weighs in which cell
//! is the same for all key points and stands in one table, and the effort does not grow with their size.

use super::patch::{FULL_CIRCLE, Patch, SIZE};
use crate::Descriptor;
use crate::numbers::{exp, sin_cos};
use geometry::Image;

/// Histograms along a side.
const CELLS: usize = 4;

/// Directions of a histogram.
const DIRECTIONS: usize = 8;

/// A cell's width in key point scales.
const CELL: f32 = 3.0;

/// No direction keeps more than this share of the whole length (Lowe 2004, §6.1).
const LARGEST: f32 = 0.2;

/// Cells that are sampled along a side: half a cell beyond the outermost still counts in them.
const WIDTH: usize = CELLS + 1;

/// Samples along the side of a cell. With 4 as many matches are right as with every pixel (0.986 to 1.021 of them, by sets
/// of pairs of the example `compare`), with 3 0.978 to 1.023.
const OF_A_CELL: usize = SIZE / WIDTH;

/// Cells along a side with those around, which take what is not asked.
const PADDED: usize = CELLS + 2;

type Histogram = [f32; DIRECTIONS];

/// What each direction gives to each bin: its two nearest share it linearly, going round. A histogram's directions go from y
/// towards x.
static SHARES: [Histogram; FULL_CIRCLE + 1] = shares();

/// Describes key points, one after the other.
pub struct Describer {
    /// What a sample gives to the cell before it and to the one behind, along either axis, with the window's weight.
    weights: [[f32; 2]; SIZE],
    patch: Patch,
}

impl Describer {
    /// One for all key points.
    pub fn new() -> Self {
        // The window's standard deviation is half the descriptor's width (Lowe 2004, §6.1).
        let spread = CELLS as f32 / 2.0;
        let weights = std::array::from_fn(|i| {
            let cells = (i as f32 + 0.5) / OF_A_CELL as f32;
            let off = (cells - WIDTH as f32 / 2.0) / spread;
            let (window, behind) = (exp(f64::from(-0.5 * off * off)) as f32, cells.fract());
            [window * (1.0 - behind), window * behind]
        });
        Self { weights, patch: Patch::new() }
    }

    /// Describes the surroundings of `pixel` with blur `sigma`, both in pixels of the octave, seen along `turns`.
    #[inline(always)]
    pub fn describe(&mut self, image: &Image<f32>, pixel: [f32; 2], sigma: f32, turns: f32) -> Descriptor {
        let (sine, cosine) = sin_cos(f64::from(turns));
        let step = CELL / OF_A_CELL as f32 * sigma;
        self.patch.fill(image, pixel, [cosine as f32 * step, sine as f32 * step]);
        let mut histograms = [[[0.0; DIRECTIONS]; PADDED]; PADDED];
        for j in 0..SIZE {
            let row = self.row(j);
            for (histograms, weight) in histograms[j / OF_A_CELL..].iter_mut().zip(self.weights[j]) {
                for (histogram, row) in histograms.iter_mut().zip(&row) {
                    add(histogram, weight, row);
                }
            }
        }
        let mut histogram = [0.0f32; 128];
        for (cell, output) in histogram.as_chunks_mut::<DIRECTIONS>().0.iter_mut().enumerate() {
            *output = histograms[cell / CELLS + 1][cell % CELLS + 1];
        }
        root_sift(&histogram)
    }

    /// The histograms of one row of samples.
    #[inline(always)]
    fn row(&self, j: usize) -> [Histogram; PADDED] {
        let mut histograms = [[0.0; DIRECTIONS]; PADDED];
        let (lengths, turns) = (&self.patch.lengths[j], &self.patch.turns[j]);
        // Samples between the middles of two cells are shared by these.
        for between in 0..WIDTH {
            let (mut before, mut behind) = ([0.0; DIRECTIONS], [0.0; DIRECTIONS]);
            for i in between * OF_A_CELL..(between + 1) * OF_A_CELL {
                let shares = &SHARES[turns[i] as usize];
                add(&mut before, lengths[i] * self.weights[i][0], shares);
                add(&mut behind, lengths[i] * self.weights[i][1], shares);
            }
            add(&mut histograms[between], 1.0, &before);
            add(&mut histograms[between + 1], 1.0, &behind);
        }
        histograms
    }
}

const fn shares() -> [Histogram; FULL_CIRCLE + 1] {
    let mut all = [[0.0; DIRECTIONS]; FULL_CIRCLE + 1];
    let of_a_bin = FULL_CIRCLE / DIRECTIONS;
    let mut direction_step = 0;
    while direction_step <= FULL_CIRCLE {
        let back = FULL_CIRCLE - direction_step;
        let (bin, rest) = (back / of_a_bin, (back % of_a_bin) as f32 / of_a_bin as f32);
        all[direction_step][bin % DIRECTIONS] = 1.0 - rest;
        all[direction_step][(bin + 1) % DIRECTIONS] = rest;
        direction_step += 1;
    }
    all
}

#[inline(always)]
fn add(histogram: &mut [f32; DIRECTIONS], weight: f32, shares: &[f32; DIRECTIONS]) {
    for (bin, share) in histogram.iter_mut().zip(shares) {
        *bin += weight * share;
    }
}

/// Clips large bins (Lowe 2004, §6.1), and takes the square roots of the histogram whose sum is one, times 256
/// (Arandjelović & Zisserman 2012).
pub fn root_sift(histogram: &[f32; 128]) -> Descriptor {
    let length = histogram.iter().map(|v| v * v).sum::<f32>().sqrt();
    let clipped: [f32; 128] = histogram.map(|v| v.min(LARGEST * length));
    let sum = clipped.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    clipped.map(|v| (256.0 * (v / sum).sqrt()).round().min(255.0) as u8)
}
