//! The scale space: octaves of ever more blurred images, and the differences of neighbours (Lowe 2004, §3).

use super::blur::Kernel;
use crate::numbers::exp2;
use geometry::{GrayImage, Image};

/// Scales of an octave at which extrema are looked for (Lowe 2004, §3.2).
pub const LAYERS: usize = 3;

/// Blur of the first image of every octave, in its pixels (Lowe 2004, §3.3).
pub const SIGMA: f64 = 1.6;

/// Blur that an image has from its camera, pixels (Lowe 2004, §3.3).
const CAMERA_SIGMA: f64 = 0.5;

/// An octave with a side below this many pixels has no room for a descriptor.
const SMALLEST: usize = 12;

/// The blurred images of one octave; image i has blur [`SIGMA`]·2^(i / [`LAYERS`]).
pub struct Octave {
    /// [`LAYERS`] + 1 images; of two more only the differences are asked.
    pub images: Vec<Image<f32>>,
}

/// Where the first octave's pixels lie in the image: the pixel `x` is `scale · x + offset` of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Pixels of the image in one of the octave.
    pub scale: f32,
    /// Pixels of the image.
    pub offset: f32,
}

/// The first image of the scale space, with blur [`SIGMA`].
///
/// With `double` it has twice the size of the image (Lowe 2004, §3.3).
#[inline(always)]
pub fn first(image: &GrayImage, double: bool) -> (Image<f32>, Placed) {
    let (sharp, sigma, placed) = if double {
        (doubled(image), 2.0 * CAMERA_SIGMA, Placed { scale: 0.5, offset: -0.25 })
    } else {
        let data = image.data().iter().map(|&v| f32::from(v)).collect();
        let copy = Image::from_vec(image.width(), image.height(), data).expect("as many pixels");
        (copy, CAMERA_SIGMA, Placed { scale: 1.0, offset: 0.0 })
    };
    let mut blurred = Image::filled(sharp.width(), sharp.height(), 0.0);
    Kernel::new((SIGMA * SIGMA - sigma * sigma).sqrt()).blur(&sharp, &mut blurred, &mut Vec::new());
    (blurred, placed)
}

/// What makes octaves of their first images.
pub struct Scales {
    /// From blur σ·2^((i−1)/layers) to σ·2^(i/layers).
    kernels: Vec<Kernel>,
    line: Vec<f32>,
}

impl Scales {
    /// The same for all octaves.
    pub fn new() -> Self {
        let step = |i: usize| {
            let before = SIGMA * exp2((i as f64 - 1.0) / LAYERS as f64);
            Kernel::new(before * (exp2(2.0 / LAYERS as f64) - 1.0).sqrt())
        };
        Self { kernels: (1..LAYERS + 3).map(step).collect(), line: Vec::new() }
    }

    /// The octave that begins with an image, and its [`LAYERS`] + 2 differences; nothing where the image is too small.
    #[inline(always)]
    pub fn octave(&mut self, first: Image<f32>) -> Option<(Octave, Vec<Image<f32>>)> {
        let (width, height) = (first.width(), first.height());
        if width.min(height) < SMALLEST {
            return None;
        }
        let (mut images, mut differences) = (vec![first], Vec::with_capacity(self.kernels.len()));
        for (i, kernel) in self.kernels.iter().enumerate() {
            let mut blurred = Image::filled(width, height, 0.0);
            kernel.blur(&images[i], &mut blurred, &mut self.line);
            differences.push(difference(&blurred, &images[i]));
            images.push(blurred);
        }
        images.truncate(LAYERS + 1);
        Some((Octave { images }, differences))
    }
}

impl Octave {
    /// The first image of the next octave.
    pub fn next(&self) -> Image<f32> {
        thinned(&self.images[LAYERS])
    }
}

/// `a − b`.
#[inline(always)]
fn difference(a: &Image<f32>, b: &Image<f32>) -> Image<f32> {
    let mut difference = Image::filled(a.width(), a.height(), 0.0);
    for ((difference, a), b) in difference.data_mut().iter_mut().zip(a.data()).zip(b.data()) {
        *difference = a - b;
    }
    difference
}

/// Every second pixel of every second row.
fn thinned(image: &Image<f32>) -> Image<f32> {
    let (width, height) = (image.width() / 2, image.height() / 2);
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        data.extend(image.row(2 * y).chunks_exact(2).map(|pair| pair[0]));
    }
    Image::from_vec(width, height, data).expect("as many pixels")
}

/// Twice the size by bilinear interpolation; pixel `x` lies at `x / 2 − 1/4` of the image.
fn doubled(image: &GrayImage) -> Image<f32> {
    let (width, height) = (image.width(), image.height());
    let mut data = Vec::with_capacity(4 * width * height);
    let mut row = vec![0.0f32; width];
    for y in 0..2 * height {
        let near = image.row(y / 2);
        let other = if y % 2 == 0 { (y / 2).saturating_sub(1) } else { (y / 2 + 1).min(height - 1) };
        for ((mixed, &near), &far) in row.iter_mut().zip(near).zip(image.row(other)) {
            *mixed = 0.75 * f32::from(near) + 0.25 * f32::from(far);
        }
        for x in 0..width {
            let (left, right) = (row[x.saturating_sub(1)], row[(x + 1).min(width - 1)]);
            data.push(0.75 * row[x] + 0.25 * left);
            data.push(0.75 * row[x] + 0.25 * right);
        }
    }
    Image::from_vec(2 * width, 2 * height, data).expect("as many pixels")
}
