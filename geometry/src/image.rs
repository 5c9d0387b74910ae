//! Images in memory order.

use crate::{Buffer, Swap};
use bytemuck::Pod;

/// A row-major image of `width × height` pixels; pixel centres lie at integer coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image<T> {
    width: usize,
    height: usize,
    data: Buffer<T>,
}

/// An 8-bit grey image, intensities 0–255.
pub type GrayImage = Image<u8>;

impl<T: Copy> Image<T> {
    /// An image filled with one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: vec![value; width * height].into() }
    }

    /// An image from its pixels, row by row; `None` when their number is not `width × height`.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Option<Self> {
        (data.len() == width * height).then(|| Self { width, height, data: data.into() })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// All pixels, row by row, to write.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// The pixels of row `y`.
    #[inline]
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// The pixel in column `x`, row `y`.
    #[inline]
    pub fn get(&self, x: usize, y: usize) -> T {
        self.data[y * self.width + x]
    }

    /// Sets the pixel in column `x`, row `y`.
    #[inline]
    pub fn set(&mut self, x: usize, y: usize, value: T) {
        self.data[y * self.width + x] = value;
    }

    /// Whether `(x, y)` lies at least `border` pixels inside the image (and is not NaN).
    #[inline]
    pub fn contains(&self, x: f32, y: f32, border: f32) -> bool {
        x >= border
            && y >= border
            && x <= self.width as f32 - 1.0 - border
            && y <= self.height as f32 - 1.0 - border
    }
}

impl<T: Pod> Image<T> {
    /// The same image with its pixels kept by `swap`; `None` where it has no room, or has them already.
    pub fn swapped_out(&self, swap: &dyn Swap) -> Option<Self> {
        Some(Self { data: self.data.swapped_out(swap)?, ..*self })
    }

    /// Gives back the memory of pixels that are swapped out, until they are looked at again.
    pub fn rest(&self) {
        self.data.rest();
    }
}

impl GrayImage {
    /// Bilinear intensity at `(x, y)`; the caller guarantees `contains(x, y, 0)`.
    #[inline]
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        debug_assert!(self.contains(x, y, 0.0));
        // The last row and column interpolate from the pixel before with weight one.
        let x0 = (x as usize).min(self.width - 2);
        let y0 = (y as usize).min(self.height - 2);
        let (dx, dy) = (x - x0 as f32, y - y0 as f32);
        let i = y0 * self.width + x0;
        let (top, bottom) = (&self.data[i..i + 2], &self.data[i + self.width..i + self.width + 2]);
        let t = top[0] as f32 + dx * (top[1] as f32 - top[0] as f32);
        let b = bottom[0] as f32 + dx * (bottom[1] as f32 - bottom[0] as f32);
        t + dy * (b - t)
    }
}
