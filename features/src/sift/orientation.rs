//! The orientations of a key point: the peaks of the histogram of gradients around it (Lowe 2004, §5).

use super::gradient::Gradient;
use super::window::Window;

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
    gradient: &Gradient,
    pixel: [f32; 2],
    sigma: f32,
    window: &mut Window,
    found: &mut Vec<f32>,
) {
    let spread = WINDOW * sigma;
    let image = &gradient.length;
    let [columns, rows] = window.place([image.width(), image.height()], pixel, 3.0 * spread, spread);
    let mut histogram = [0.0f32; BINS];
    for y in rows {
        let weight = window.down[y - window.top];
        let (lengths, turns) = (&image.row(y)[columns.clone()], &gradient.turns.row(y)[columns.clone()]);
        for ((length, turns), across) in lengths.iter().zip(turns).zip(&window.across) {
            let bin = (turns * BINS as f32 + 0.5) as usize;
            histogram[if bin >= BINS { 0 } else { bin }] += length * (weight * across);
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

/// The histogram blurred by the binomial (1 4 6 4 1) / 16.
fn smoothed(histogram: &[f32; BINS]) -> [f32; BINS] {
    std::array::from_fn(|i| {
        let at = |offset: usize| histogram[(i + BINS - 2 + offset) % BINS];
        (at(0) + at(4)) * (1.0 / 16.0) + (at(1) + at(3)) * (4.0 / 16.0) + at(2) * (6.0 / 16.0)
    })
}
