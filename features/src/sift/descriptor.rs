//! The descriptor of a key point: 4 × 4 histograms of 8 gradient directions (Lowe 2004, §6).

use super::gradient::Gradient;
use super::window::{LANES, Window};
use crate::Descriptor;
use crate::numbers::sin_cos;

/// Histograms along a side.
const CELLS: usize = 4;

/// Directions of a histogram.
const DIRECTIONS: usize = 8;

/// A cell's width in key point scales.
const CELL: f32 = 3.0;

/// No direction keeps more than this share of the whole length (Lowe 2004, §6.1).
const LARGEST: f32 = 0.2;

/// Cells along a side with those around, which take what is interpolated beyond the border.
const PADDED: usize = CELLS + 2;

/// Samples of a row that follow each other, worked out side by side.
#[derive(Default)]
struct Samples {
    /// Whether it lies in the padded cells.
    counts: [bool; LANES],
    /// Its direction, in bins.
    direction: [f32; LANES],
    /// The upper left one of the four cells that share it.
    corner: [f32; LANES],
    /// What each of the four gets of it.
    weights: [[f32; LANES]; 4],
}

/// What the samples of a row share.
struct Row {
    /// The first sample's column and row of cells.
    u: f32,
    v: f32,
    /// How `u` grows and `v` falls from sample to sample.
    along_x: f32,
    along_y: f32,
    /// The window's weight of the row.
    weight: f32,
    /// The key point's orientation.
    turns: f32,
}

impl Row {
    /// [`LANES`] samples from one on, with the gradient there and the window's weights of the columns.
    #[inline(always)]
    fn samples(
        &self,
        first: usize,
        lengths: &[f32; LANES],
        directions: &[f32; LANES],
        across: &[f32; LANES],
    ) -> Samples {
        let mut samples = Samples::default();
        for k in 0..LANES {
            let x = first as f32 + k as f32;
            let (u, v) = (self.u + self.along_x * x, self.v - self.along_y * x);
            let size = (CELLS + 1) as f32;
            samples.counts[k] = (u >= 0.0) & (v >= 0.0) & (u < size) & (v < size);
            let length = lengths[k] * (self.weight * across[k]);
            let relative = self.turns - directions[k];
            let relative = if relative < 0.0 { relative + 1.0 } else { relative };
            samples.direction[k] = relative * DIRECTIONS as f32;
            let (column, row) = (u.floor(), v.floor());
            let (right, lower) = (u - column, v - row);
            let (of_lower, of_upper) = (length * lower, length - length * lower);
            samples.corner[k] = row * PADDED as f32 + column;
            samples.weights[0][k] = of_upper - of_upper * right;
            samples.weights[1][k] = of_upper * right;
            samples.weights[2][k] = of_lower - of_lower * right;
            samples.weights[3][k] = of_lower * right;
        }
        samples
    }
}

/// The first numbers of a slice that has as many.
#[inline(always)]
fn first_chunk(numbers: &[f32]) -> &[f32; LANES] {
    numbers.first_chunk().expect("the window and the image reach so far")
}

/// Describes the surroundings of `pixel` with blur `sigma`, both in pixels of the octave, seen along `turns`.
#[inline(always)]
pub fn describe(
    gradient: &Gradient,
    pixel: [f32; 2],
    sigma: f32,
    turns: f32,
    window: &mut Window,
) -> Descriptor {
    let cell = CELL * sigma;
    let (sine, cosine) = sin_cos(f64::from(turns));
    let (along_x, along_y) = (cosine as f32 / cell, sine as f32 / cell);
    let image = &gradient.length;
    // A sample counts up to one cell beyond the middle of the outermost; the square's half diagonal in x or y.
    let reach = (CELLS + 1) as f32 / 2.0;
    let radius = reach * cell * ((sine.abs() + cosine.abs()) as f32);
    // The window's standard deviation is half the descriptor's width (Lowe 2004, §6.1).
    let spread = CELLS as f32 / 2.0 * cell;
    let [columns, rows] = window.place([image.width(), image.height()], pixel, radius, spread);

    let mut histograms = [[0.0f32; DIRECTIONS]; PADDED * PADDED];
    for y in rows {
        let weight = window.down[y - window.top];
        let dy = y as f32 - pixel[1];
        // Along a row both coordinates of the cell grow evenly.
        let dx = columns.start as f32 - pixel[0];
        let (u, v) = (along_x * dx + along_y * dy + reach, along_x * dy - along_y * dx + reach);
        let inside = inside(u, along_x, columns.len());
        let also = self::inside(v, -along_y, columns.len());
        let (first, end) = (inside.0.max(also.0), inside.1.min(also.1));
        let row = Row { u, v, along_x, along_y, weight, turns };
        for start in (first..end).step_by(LANES) {
            // What lies beyond the window has no weight; the last rows of the images are not in it.
            let at = y * image.width() + columns.start + start;
            let lengths = first_chunk(&image.data()[at..]);
            let directions = first_chunk(&gradient.turns.data()[at..]);
            let samples = row.samples(start, lengths, directions, first_chunk(&window.across[start..]));
            for k in (0..LANES.min(end - start)).filter(|&k| samples.counts[k]) {
                let (shares, corner) = (shares(samples.direction[k]), samples.corner[k] as usize);
                for (cell, weights) in [0, 1, PADDED, PADDED + 1].into_iter().zip(&samples.weights) {
                    add(&mut histograms[corner + cell], weights[k], &shares);
                }
            }
        }
    }
    let mut histogram = [0.0f32; 128];
    for (cell, output) in histogram.as_chunks_mut::<DIRECTIONS>().0.iter_mut().enumerate() {
        *output = histograms[(cell / CELLS + 1) * PADDED + cell % CELLS + 1];
    }
    root_sift(&histogram)
}

/// The range of steps, of `count`, at which `start + slope · step` may lie inside the padded cells; a step too many
/// on either side does not harm.
#[inline(always)]
fn inside(start: f32, slope: f32, count: usize) -> (usize, usize) {
    let size = (CELLS + 1) as f32;
    if slope.abs() < 1e-6 {
        return (0, count);
    }
    let (a, b) = (-start / slope, (size - start) / slope);
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    (low.max(0.0) as usize, ((high + 2.0).max(0.0) as usize).min(count))
}

/// How a direction, in bins, is shared among the bins: linearly between the two that are nearest, going round.
#[inline(always)]
fn shares(direction: f32) -> [f32; DIRECTIONS] {
    const BINS: [f32; DIRECTIONS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
    let mut shares = [0.0; DIRECTIONS];
    for (share, bin) in shares.iter_mut().zip(BINS) {
        let off = (direction - bin).abs();
        let round = DIRECTIONS as f32 - off;
        let off = if round < off { round } else { off };
        *share = if off < 1.0 { 1.0 - off } else { 0.0 };
    }
    shares
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
