//! The orientations of a key point: the peaks of the histogram of gradients around it (Lowe 2004, §5).

use super::window::Window;
use crate::numbers::{direction, rounded};
use geometry::Image;
use geometry::lanes::LANES;

/// Bins of the histogram.
const BINS: usize = 36;

/// The Gaussian window's standard deviation in key point scales (Lowe 2004, §5).
const WINDOW: f32 = 1.5;

/// A further peak counts from this share of the highest (Lowe 2004, §5).
const PEAK: f32 = 0.8;

/// Appends the orientations, turns from x towards y, 0 to 1, of a key point at `pixel` with blur `sigma`, both in
/// pixels of the octave.
#[inline(always)]
pub fn orientations(
    image: &Image<f32>,
    pixel: [f32; 2],
    sigma: f32,
    window: &mut Window,
    found: &mut Vec<f32>,
) {
    let spread = WINDOW * sigma;
    let (width, height) = (image.width(), image.height());
    let [columns, rows] = window.place([width, height], pixel, 3.0 * spread, spread);
    let mut histogram = [0.0f32; BINS];
    for y in rows {
        let weight = window.down[y - window.top];
        let neighbours = [image.row(y - 1), image.row(y), image.row(y + 1)];
        for first in columns.clone().step_by(LANES) {
            // At the right border some are looked at again, but not counted.
            let start = first.min(width - 1 - LANES);
            let (lengths, bins) = gradients(neighbours, start);
            for x in first..(start + LANES).min(columns.end) {
                let (length, bin) = (lengths[x - start], bins[x - start] as usize);
                histogram[if bin < BINS { bin } else { 0 }] +=
                    length * (weight * window.across[x - columns.start]);
            }
        }
    }
    let smooth = smoothed(&histogram);
    let highest = smooth.iter().copied().fold(0.0, f32::max);
    for (bin, &here) in smooth.iter().enumerate() {
        let (left, right) = (smooth[(bin + BINS - 1) % BINS], smooth[(bin + 1) % BINS]);
        if here > left && here > right && here >= PEAK * highest {
            // The parabola through the three.
            let peak = bin as f32 + 0.5 * (left - right) / (left - 2.0 * here + right);
            found.push((peak / BINS as f32).rem_euclid(1.0));
        }
    }
}

/// Lengths and bins of a row's gradients from a column on, by central differences.
#[inline(always)]
fn gradients([up, row, down]: [&[f32]; 3], start: usize) -> ([f32; LANES], [u32; LANES]) {
    let (left, right) = (lanes(&row[start - 1..]), lanes(&row[start + 1..]));
    let (up, down) = (lanes(&up[start..]), lanes(&down[start..]));
    let (mut lengths, mut bins) = ([0.0; LANES], [0; LANES]);
    for i in 0..LANES {
        let (dx, dy) = (right[i] - left[i], down[i] - up[i]);
        lengths[i] = (dx * dx + dy * dy).sqrt();
        bins[i] = rounded(direction(dx, dy) * BINS as f32);
    }
    (lengths, bins)
}

#[inline(always)]
fn lanes(numbers: &[f32]) -> &[f32; LANES] {
    numbers.first_chunk().expect("the image reaches so far")
}

/// The histogram blurred by the binomial (1 4 6 4 1) / 16.
fn smoothed(histogram: &[f32; BINS]) -> [f32; BINS] {
    std::array::from_fn(|i| {
        let at = |offset: usize| histogram[(i + BINS - 2 + offset) % BINS];
        (at(0) + at(4)) * (1.0 / 16.0) + (at(1) + at(3)) * (4.0 / 16.0) + at(2) * (6.0 / 16.0)
    })
}
