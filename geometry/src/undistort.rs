//! Undistortion: the picture that a pinhole would have taken from the same place.

mod crop;

pub use crop::Crop;

use crate::camera::{Camera, CameraError, check_size_and_focal};
use crate::{GrayImage, Image, Pinhole};
use nalgebra::{Vector2, Vector3};
use thiserror::Error;

/// Weights of the interpolation are in units of one 256th of a pixel.
const WEIGHT_BITS: u32 = 8;
const ONE: u32 = 1 << WEIGHT_BITS;

/// Pixels outside the source by no more than this (rounding) count as inside.
const EDGE_TOLERANCE: f64 = 1e-6;

/// An image whose size is not that of its calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "the image is {}×{} pixels but the calibration is for {}×{}: use the calibration of this recording, \
     or resize its images",
    found.0, found.1, expected.0, expected.1
)]
pub struct ImageSizeError {
    /// Width and height of the image.
    pub found: (usize, usize),
    /// Width and height in the calibration.
    pub expected: (usize, usize),
}

/// Where one output pixel comes from: the upper left of four source pixels and the weights of the others.
#[derive(Clone, Copy)]
struct Tap {
    offset: u32,
    right: u16,
    below: u16,
}

/// Turns the images of a camera into those of a pinhole, by a table made once.
pub struct Undistorter {
    source_size: (usize, usize),
    pinhole: Pinhole,
    /// Empty when the camera already is the wanted pinhole.
    taps: Vec<Tap>,
    valid: Image<bool>,
}

impl Undistorter {
    /// Prepares the table for a camera and a choice of what the output shows.
    ///
    /// # Errors
    /// When an explicit output camera has no usable size or focal length.
    pub fn new(camera: &Camera, crop: Crop) -> Result<Self, CameraError> {
        let pinhole = crop.pinhole_of(camera);
        check_size_and_focal(&pinhole)?;
        let source_size = (camera.intrinsics().width, camera.intrinsics().height);
        if camera.distortion().is_identity() && pinhole == *camera.intrinsics() {
            let valid = Image::filled(pinhole.width, pinhole.height, true);
            return Ok(Self { source_size, pinhole, taps: Vec::new(), valid });
        }
        let mut valid = Image::filled(pinhole.width, pinhole.height, false);
        let mut taps = Vec::with_capacity(pinhole.width * pinhole.height);
        for y in 0..pinhole.height {
            for x in 0..pinhole.width {
                let (pixel, inside) = source_of(camera, &pinhole.unproject(x as f64, y as f64));
                valid.set(x, y, inside);
                taps.push(tap(&pixel, source_size));
            }
        }
        Ok(Self { source_size, pinhole, taps, valid })
    }

    /// The camera of the output images.
    pub fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    /// Whether images pass through unchanged, because the camera already is the wanted pinhole.
    pub fn is_identity(&self) -> bool {
        self.taps.is_empty()
    }

    /// Which output pixels show something that the camera saw; the others repeat its nearest edge.
    pub fn valid(&self) -> &Image<bool> {
        &self.valid
    }

    /// The undistorted image.
    ///
    /// # Errors
    /// When the image has not the size of the camera.
    pub fn undistort(&self, image: &GrayImage) -> Result<GrayImage, ImageSizeError> {
        let mut output = GrayImage::default();
        self.undistort_into(image, &mut output)?;
        Ok(output)
    }

    /// As [`undistort`](Self::undistort), into an image whose memory is used again; any size will do.
    ///
    /// # Errors
    /// When the image has not the size of the camera; the output is then left as it was.
    pub fn undistort_into(&self, image: &GrayImage, output: &mut GrayImage) -> Result<(), ImageSizeError> {
        let found = (image.width(), image.height());
        if found != self.source_size {
            return Err(ImageSizeError { found, expected: self.source_size });
        }
        if self.is_identity() {
            output.clone_from(image);
            return Ok(());
        }
        if (output.width(), output.height()) != (self.pinhole.width, self.pinhole.height) {
            *output = GrayImage::filled(self.pinhole.width, self.pinhole.height, 0);
        }
        remap(image, &self.taps, output.data_mut());
        Ok(())
    }
}

crate::multiversion! {
    /// Takes each pixel from where it lies in the source.
    fn remap(source: &GrayImage, taps: &[Tap], output: &mut [u8]) {
        let (width, source) = (source.width(), source.data());
        for (pixel, tap) in output.iter_mut().zip(taps) {
            let i = tap.offset as usize;
            let (top, bottom) = (&source[i..i + 2], &source[i + width..i + width + 2]);
            *pixel =
                interpolate([top[0], top[1]], [bottom[0], bottom[1]], tap.right.into(), tap.below.into());
        }
    }
}

/// Rounded bilinear mean of four pixels.
#[inline(always)]
fn interpolate(top: [u8; 2], bottom: [u8; 2], right: u32, below: u32) -> u8 {
    // Both columns at once, one in each half of a word: 255 · 256 fits in 16 bits.
    let pair = |row: [u8; 2]| u32::from(row[0]) | u32::from(row[1]) << 16;
    let columns = pair(top) * (ONE - below) + pair(bottom) * below;
    let sum = (columns & 0xffff) * (ONE - right) + (columns >> 16) * right;
    ((sum + (1 << (2 * WEIGHT_BITS - 1))) >> (2 * WEIGHT_BITS)) as u8
}

/// The source pixel that shows a ray, or else the nearest on the edge, and whether it is the former.
fn source_of(camera: &Camera, ray: &Vector3<f64>) -> (Vector2<f64>, bool) {
    let Pinhole { width, height, cx, cy, .. } = *camera.intrinsics();
    let limit = Vector2::new(width as f64 - 1.0, height as f64 - 1.0);
    let clamped = |pixel: Vector2<f64>| pixel.sup(&Vector2::zeros()).inf(&limit);
    if let Some(pixel) = camera.project(ray) {
        let inside = (clamped(pixel) - pixel).amax() <= EDGE_TOLERANCE;
        return (clamped(pixel), inside);
    }
    // The model ends before this ray: take the last one on the way from the axis that it knows.
    let towards = |share: f64| camera.project(&Vector3::new(ray.x * share, ray.y * share, 1.0));
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if towards(middle).is_some() { low = middle } else { high = middle }
    }
    (clamped(towards(low).unwrap_or(Vector2::new(cx, cy))), false)
}

/// The table entry of a pixel inside the source.
fn tap(pixel: &Vector2<f64>, (width, height): (usize, usize)) -> Tap {
    // The last column and row interpolate from the one before with weight one.
    let split = |value: f64, side: usize| {
        let units = (value * f64::from(ONE)).round() as usize;
        let whole = (units / ONE as usize).min(side - 2);
        (whole, (units - whole * ONE as usize) as u16)
    };
    let ((x, right), (y, below)) = (split(pixel.x, width), split(pixel.y, height));
    Tap { offset: (y * width + x) as u32, right, below }
}

#[cfg(test)]
mod tests;
