//! Gaussian blur by two passes over rows of `f32`.

use crate::numbers::exp;
use geometry::Image;

/// Pixels worked on at once: they stay in registers.
const BLOCK: usize = 32;

/// Half of a Gaussian kernel: the weight of the centre, then of each neighbour on either side; they sum to one.
pub struct Kernel(Vec<f32>);

impl Kernel {
    /// The kernel of standard deviation `sigma`, pixels; it ends where the Gaussian falls below 0.04 % of its peak
    /// (4σ).
    pub fn new(sigma: f64) -> Self {
        let radius = (4.0 * sigma).round() as usize;
        let weight = |i: usize| exp(-((i * i) as f64) / (2.0 * sigma * sigma));
        let weights: Vec<f64> = (0..=radius).map(weight).collect();
        let sum = 2.0 * weights.iter().sum::<f64>() - weights[0];
        Self(weights.iter().map(|w| (w / sum) as f32).collect())
    }

    fn radius(&self) -> usize {
        self.0.len() - 1
    }

    /// Blurs `source` into `target`, of one size; `line` is working memory. Beyond its border the image is mirrored.
    #[inline(always)]
    pub fn blur(&self, source: &Image<f32>, target: &mut Image<f32>, line: &mut Vec<f32>) {
        let (width, height, radius) = (source.width(), source.height(), self.radius());
        line.clear();
        line.resize(width + 2 * radius, 0.0);
        for y in 0..height {
            self.down(source, y, &mut line[radius..radius + width]);
            for i in 1..=radius {
                line[radius - i] = line[radius + mirrored(-(i as isize), width)];
                line[radius + width - 1 + i] = line[radius + mirrored((width - 1 + i) as isize, width)];
            }
            let row = &mut target.data_mut()[y * width..(y + 1) * width];
            self.along(line, row);
        }
    }

    /// The blur along the columns of row `y`.
    #[inline(always)]
    fn down(&self, source: &Image<f32>, y: usize, output: &mut [f32]) {
        let width = source.width();
        let mut start = 0;
        // The last block overlaps the one before.
        while width >= BLOCK && start < width {
            let x = start.min(width - BLOCK);
            let mut sums = [0.0; BLOCK];
            for (sum, v) in sums.iter_mut().zip(&source.row(y)[x..x + BLOCK]) {
                *sum = self.0[0] * v;
            }
            for (i, weight) in self.0.iter().enumerate().skip(1) {
                let (above, below) = rows(source, y, i);
                add(&mut sums, *weight, &above[x..x + BLOCK], &below[x..x + BLOCK]);
            }
            output[x..x + BLOCK].copy_from_slice(&sums);
            start += BLOCK;
        }
        if width < BLOCK {
            for (x, output) in output.iter_mut().enumerate() {
                *output = self.0[0] * source.get(x, y);
                for (i, weight) in self.0.iter().enumerate().skip(1) {
                    let (above, below) = rows(source, y, i);
                    *output += weight * (above[x] + below[x]);
                }
            }
        }
    }

    /// The blur along a line that has `radius` pixels more on either side.
    #[inline(always)]
    fn along(&self, line: &[f32], output: &mut [f32]) {
        let (width, radius) = (output.len(), self.radius());
        let mut start = 0;
        while width >= BLOCK && start < width {
            let x = start.min(width - BLOCK);
            let centre = x + radius;
            let mut sums = [0.0; BLOCK];
            for (sum, v) in sums.iter_mut().zip(&line[centre..centre + BLOCK]) {
                *sum = self.0[0] * v;
            }
            for (i, weight) in self.0.iter().enumerate().skip(1) {
                let (left, right) = (centre - i, centre + i);
                add(&mut sums, *weight, &line[left..left + BLOCK], &line[right..right + BLOCK]);
            }
            output[x..x + BLOCK].copy_from_slice(&sums);
            start += BLOCK;
        }
        if width < BLOCK {
            for (x, output) in output.iter_mut().enumerate() {
                *output = self.0[0] * line[x + radius];
                for (i, weight) in self.0.iter().enumerate().skip(1) {
                    *output += weight * (line[x + radius - i] + line[x + radius + i]);
                }
            }
        }
    }
}

/// The rows `i` above and below `y`.
#[inline(always)]
fn rows(image: &Image<f32>, y: usize, i: usize) -> (&[f32], &[f32]) {
    let above = mirrored(y as isize - i as isize, image.height());
    let below = mirrored((y + i) as isize, image.height());
    (image.row(above), image.row(below))
}

/// Adds a weighted pair of neighbours to each sum.
#[inline(always)]
fn add(sums: &mut [f32; BLOCK], weight: f32, a: &[f32], b: &[f32]) {
    for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
        *sum += weight * (a + b);
    }
}

/// The index of a pixel mirrored at the borders of `size` pixels, which are not repeated.
#[inline(always)]
fn mirrored(i: isize, size: usize) -> usize {
    if (0..size as isize).contains(&i) {
        return i as usize;
    }
    let period = (2 * size as isize - 2).max(1);
    let i = i.rem_euclid(period);
    i.min(period - i).clamp(0, size as isize - 1) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_becomes_a_gaussian_and_a_flat_image_stays_flat() {
        for (width, height) in [(61, 41), (21, 23)] {
            let mut point = Image::filled(width, height, 0.0f32);
            let (cx, cy) = (width / 2, height / 2);
            point.set(cx, cy, 1.0);
            let mut blurred = Image::filled(width, height, 0.0);
            let mut line = Vec::new();
            Kernel::new(2.0).blur(&point, &mut blurred, &mut line);
            for (x, y) in [(cx, cy), (cx + 1, cy), (cx, cy - 2), (cx + 3, cy + 2)] {
                let square = (x as f64 - cx as f64).powi(2) + (y as f64 - cy as f64).powi(2);
                let expected = (-square / 8.0).exp() / (std::f64::consts::TAU * 4.0);
                assert!((f64::from(blurred.get(x, y)) - expected).abs() < 2e-5, "{x} {y}");
            }
            Kernel::new(2.0).blur(&Image::filled(width, height, 7.0), &mut blurred, &mut line);
            assert!(blurred.data().iter().all(|v| (v - 7.0).abs() < 1e-4));
        }
    }

    #[test]
    fn borders_are_mirrored() {
        let indices: Vec<usize> = (-3..8).map(|i| mirrored(i, 4)).collect();
        assert_eq!(indices, [3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!(mirrored(5, 1), 0);
    }
}
