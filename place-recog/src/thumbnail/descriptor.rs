//! The thumbnail: a small, blurred, zero-mean image of unit length.

use geometry::{GrayImage, Image};

/// Columns of a thumbnail.
const WIDTH: usize = 40;
/// Rows of a thumbnail.
const HEIGHT: usize = 30;
/// Numbers in a thumbnail.
pub(super) const LENGTH: usize = WIDTH * HEIGHT;
/// Side of the squares that a thumbnail's coarse values are the means of.
const SIDE: usize = 5;
/// Numbers in a thumbnail's coarse values.
const COARSE: usize = LENGTH / (SIDE * SIDE);
/// Standard deviation of the blur, thumbnail pixels (Klein & Murray 2008 take 2.5 for theirs).
const BLUR: f32 = 2.0;
/// Length of the vector of stored values: with 1,200 values a sum of products stays within i32.
const NORM: f32 = 16384.0;
/// Contrast (standard deviation, grey levels) below which an image shows nothing.
const MIN_CONTRAST: f32 = 1.0;

/// A thumbnail ready to compare.
#[derive(Clone, Debug)]
pub(super) struct Thumbnail {
    /// Blurred intensities before normalisation, to shift and turn.
    blurred: Image<f32>,
    /// Zero mean, length [`NORM`]; all zero without contrast.
    values: Vec<i16>,
}

impl Thumbnail {
    /// The thumbnail of an image of any size.
    pub(super) fn new(image: &GrayImage) -> Self {
        Self::from_blurred(blur(&reduced(image)))
    }

    /// The values to store.
    pub(super) fn values(&self) -> &[i16] {
        &self.values
    }

    /// `None` when the image has no contrast to compare.
    pub(super) fn with_contrast(self) -> Option<Self> {
        self.values.iter().any(|&v| v != 0).then_some(self)
    }

    /// Normalised correlation with stored values, −1…1.
    pub(super) fn correlation(&self, stored: &[i16]) -> f32 {
        // The norms bound the sum by NORM², well within i32; wrapping operations say so to the
        // compiler, which then vectorises in checked builds too.
        let products = self.values.iter().zip(stored).map(|(&a, &b)| (a as i32).wrapping_mul(b as i32));
        let sum = products.fold(0, i32::wrapping_add);
        sum as f32 / (NORM * NORM)
    }

    /// What these values say of the correlation with others before those are looked at.
    pub(super) fn coarse(&self) -> Coarse {
        Coarse::new(&self.values)
    }

    /// Shifts by `shift` pixels to all eight sides, straight and turned by `±rotation` radians; the blur
    /// bridges the gaps between them.
    pub(super) fn variants(&self, shift: f32, rotation: f32) -> Vec<Self> {
        let grid = [-1.0, 0.0, 1.0];
        let mut all = Vec::with_capacity(27);
        for angle in grid {
            for y in grid {
                all.extend(grid.map(|x| self.moved(angle * rotation, x * shift, y * shift)));
            }
        }
        all
    }

    /// Turned about its middle and shifted; the border is repeated outwards.
    fn moved(&self, angle: f32, shift_x: f32, shift_y: f32) -> Self {
        let (sin, cos) = angle.sin_cos();
        let (cx, cy) = ((WIDTH - 1) as f32 * 0.5, (HEIGHT - 1) as f32 * 0.5);
        let mut moved = self.blurred.clone();
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let (dx, dy) = (x as f32 - cx, y as f32 - cy);
                let value = sample(
                    &self.blurred,
                    cx + cos * dx - sin * dy + shift_x,
                    cy + sin * dx + cos * dy + shift_y,
                );
                moved.set(x, y, value);
            }
        }
        Self::from_blurred(moved)
    }

    fn from_blurred(blurred: Image<f32>) -> Self {
        let data = blurred.data();
        let mean = data.iter().sum::<f32>() / LENGTH as f32;
        let norm = data.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>().sqrt();
        let contrast = norm / (LENGTH as f32).sqrt();
        let scale = if contrast < MIN_CONTRAST { 0.0 } else { NORM / norm };
        let values = data.iter().map(|v| ((v - mean) * scale).round() as i16).collect();
        Self { blurred, values }
    }
}

/// The means over squares of a thumbnail's values, by which its correlation with another is bounded: the means are coordinates along
/// orthonormal axes, and what is left of two vectors of known lengths correlates by the product of what is left of these at the most
/// (Cauchy–Schwarz).
#[derive(Clone, Debug)]
pub(super) struct Coarse {
    /// Parts of the vector's length.
    along: [f32; COARSE],
    /// Length of what they leave.
    left: f32,
}

impl Coarse {
    /// Of a thumbnail's values.
    pub(super) fn new(values: &[i16]) -> Self {
        let mut along = [0.0; COARSE];
        for (row, values) in values.chunks_exact(WIDTH).enumerate() {
            let squares = &mut along[row / SIDE * (WIDTH / SIDE)..][..WIDTH / SIDE];
            for (sum, values) in squares.iter_mut().zip(values.chunks_exact(SIDE)) {
                *sum += values.iter().map(|&value| f32::from(value)).sum::<f32>();
            }
        }
        along.iter_mut().for_each(|sum| *sum /= SIDE as f32 * NORM);
        let squared = |values: &mut dyn Iterator<Item = f32>| values.map(|value| value * value).sum::<f32>();
        let all = squared(&mut values.iter().map(|&value| f32::from(value) / NORM));
        let left = (all - squared(&mut along.iter().copied())).max(0.0).sqrt();
        Self { along, left }
    }

    /// What two thumbnails correlate by at the most.
    pub(super) fn bound(&self, other: &Self) -> f32 {
        let along: f32 = self.along.iter().zip(&other.along).map(|(a, b)| a * b).sum();
        along + self.left * other.left + ROUNDING
    }
}

/// More than single precision loses of a bound, and whole numbers of the values.
const ROUNDING: f32 = 1e-3;

/// Mean intensities of `WIDTH × HEIGHT` cells; an image with fewer pixels than that repeats some.
fn reduced(image: &GrayImage) -> Image<f32> {
    let mut small = Image::filled(WIDTH, HEIGHT, 0.0);
    if image.width() == 0 || image.height() == 0 {
        return small;
    }
    let range = |cell: usize, cells: usize, pixels: usize| {
        let start = cell * pixels / cells;
        start..((cell + 1) * pixels / cells).max(start + 1)
    };
    for y in 0..HEIGHT {
        let rows = range(y, HEIGHT, image.height());
        for x in 0..WIDTH {
            let columns = range(x, WIDTH, image.width());
            let row_sum = |row| image.row(row)[columns.clone()].iter().map(|&v| v as u32).sum::<u32>();
            let sum: u32 = rows.clone().map(row_sum).sum();
            small.set(x, y, sum as f32 / (rows.len() * columns.len()) as f32);
        }
    }
    small
}

/// Separable Gaussian blur, the border repeated outwards.
fn blur(image: &Image<f32>) -> Image<f32> {
    let radius = (3.0 * BLUR).ceil() as i32;
    let mut kernel: Vec<f32> = (-radius..=radius).map(|i| (-0.5 * (i as f32 / BLUR).powi(2)).exp()).collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|weight| *weight /= sum);
    let pass = |source: &Image<f32>, step_x: i32, step_y: i32| {
        let mut target = source.clone();
        for y in 0..HEIGHT as i32 {
            for x in 0..WIDTH as i32 {
                let value = (-radius..=radius).zip(&kernel).map(|(i, weight)| {
                    let column = (x + i * step_x).clamp(0, WIDTH as i32 - 1);
                    let row = (y + i * step_y).clamp(0, HEIGHT as i32 - 1);
                    weight * source.get(column as usize, row as usize)
                });
                target.set(x as usize, y as usize, value.sum());
            }
        }
        target
    };
    pass(&pass(image, 1, 0), 0, 1)
}

/// Bilinear value, the border repeated outwards.
fn sample(image: &Image<f32>, x: f32, y: f32) -> f32 {
    let x = x.clamp(0.0, (WIDTH - 1) as f32);
    let y = y.clamp(0.0, (HEIGHT - 1) as f32);
    let (x0, y0) = ((x as usize).min(WIDTH - 2), (y as usize).min(HEIGHT - 2));
    let (dx, dy) = (x - x0 as f32, y - y0 as f32);
    let top = image.get(x0, y0) * (1.0 - dx) + image.get(x0 + 1, y0) * dx;
    let bottom = image.get(x0, y0 + 1) * (1.0 - dx) + image.get(x0 + 1, y0 + 1) * dx;
    top * (1.0 - dy) + bottom * dy
}
