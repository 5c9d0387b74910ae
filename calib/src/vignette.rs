//! The vignette of a lens from images of an evenly lit flat surface.

use geometry::{GrayImage, Image, PhotometricCalibration};
use nalgebra::{DMatrix, DVector};
use thiserror::Error;

/// Terms of the smooth surface: 1, x, y, r², r⁴, r⁶.
const TERMS: usize = 6;
/// Pixels the surface is fitted to, along the longer side.
const GRID: usize = 120;
/// Rounds of reweighting.
const ROUNDS: usize = 8;
/// Largest share of white pixels.
const MAX_WHITE: f64 = 0.001;
/// Least mean grey level.
const MIN_LEVEL: f64 = 30.0;
/// Largest median difference from the smooth surface, as a share of it.
const MAX_UNEVEN: f64 = 0.03;
/// Least value of the vignette, so that 16 bits can hold what divides by it.
const MIN_VALUE: f64 = 1e-3;

/// Why images make no vignette.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum VignetteError {
    /// No images.
    #[error("there are no images\nhint: give images of an evenly lit white surface that fills the image")]
    None,
    /// Images differ in size, from each other or from the response's.
    #[error("image {index} has another size than the first\nhint: take all images in one mode of the camera")]
    Size {
        /// Index of the image.
        index: usize,
    },
    /// Too bright.
    #[error(
        "{share:.1} % of the pixels are white\nhint: shorten the exposure: white says nothing of how bright it was"
    )]
    White {
        /// Share of white pixels, per cent.
        share: f64,
    },
    /// Too dark.
    #[error(
        "the images are dark (mean grey level {level:.0})\nhint: lengthen the exposure until the middle is bright but not white"
    )]
    Dark {
        /// Mean grey level.
        level: f64,
    },
    /// The surface is not even.
    #[error(
        "the surface is not even: it differs from a smooth fall-off by {share:.1} %\nhint: fill the image with a plain white surface without shadows, out of focus if you can, and take several images while turning the camera"
    )]
    Uneven {
        /// Median difference, per cent.
        share: f64,
    },
}

/// Estimates the vignette: the median of the images, after the response is undone, and through it a smooth surface
/// `1, x, y, r², r⁴, r⁶` by reweighted least squares; 1 at its brightest. What light falls unevenly on the surface shows
/// as vignette.
///
/// # Errors
/// When the images are not of an even surface, too bright or too dark.
pub fn estimate_vignette(
    images: &[GrayImage],
    response: &PhotometricCalibration,
) -> Result<Image<f32>, VignetteError> {
    let first = images.first().ok_or(VignetteError::None)?;
    let (width, height) = (first.width(), first.height());
    if let Some(index) = images.iter().position(|image| (image.width(), image.height()) != (width, height)) {
        return Err(VignetteError::Size { index });
    }
    let count = (images.len() * width * height).max(1) as f64;
    let all = || images.iter().flat_map(|image| image.data());
    let white = all().filter(|level| **level == 255).count() as f64 / count;
    if white > MAX_WHITE {
        return Err(VignetteError::White { share: 100.0 * white });
    }
    let level = all().map(|level| f64::from(*level)).sum::<f64>() / count;
    if level < MIN_LEVEL {
        return Err(VignetteError::Dark { level });
    }
    let samples = samples(images, response.inverse_response());
    let (terms, uneven) = fitted(&samples, width, height);
    if uneven > MAX_UNEVEN {
        return Err(VignetteError::Uneven { share: 100.0 * uneven });
    }
    let value = |i: usize| row(i % width, i / width, width, height).dot(&terms);
    let values: Vec<f64> = (0..width * height).map(value).collect();
    let brightest = values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let data = values.iter().map(|value| (value / brightest).max(MIN_VALUE) as f32).collect();
    Image::from_vec(width, height, data).ok_or(VignetteError::None)
}

/// Of some pixels the median irradiance of the images: column, row, irradiance.
fn samples(images: &[GrayImage], inverse: &[f32; 256]) -> Vec<(usize, usize, f64)> {
    let (width, height) = (images[0].width(), images[0].height());
    let step = (width.max(height) / GRID).max(1);
    // Images may differ in exposure: each counts by its ratio to its own mean.
    let mean = |image: &GrayImage| {
        let sum: f64 = image.data().iter().map(|level| f64::from(inverse[*level as usize])).sum();
        (sum / image.data().len().max(1) as f64).max(f64::MIN_POSITIVE)
    };
    let means: Vec<f64> = images.iter().map(mean).collect();
    let mut out = Vec::new();
    for y in (0..height).step_by(step) {
        for x in (0..width).step_by(step) {
            let of = |(image, mean): (&GrayImage, &f64)| f64::from(inverse[image.get(x, y) as usize]) / mean;
            let mut values: Vec<f64> = images.iter().zip(&means).map(of).collect();
            values.sort_by(f64::total_cmp);
            out.push((x, y, values[values.len() / 2]));
        }
    }
    out
}

/// The surface's terms and the median difference from it, as a share.
fn fitted(samples: &[(usize, usize, f64)], width: usize, height: usize) -> (DVector<f64>, f64) {
    let mut weights = vec![1.0; samples.len()];
    let mut terms = DVector::zeros(TERMS);
    let mut typical = 0.0;
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (DMatrix::zeros(TERMS, TERMS), DVector::zeros(TERMS));
        for ((x, y, value), weight) in samples.iter().zip(&weights) {
            let row = row(*x, *y, width, height);
            normal += &row * row.transpose() * *weight;
            right += row * (value * weight);
        }
        if let Some(solution) = normal.lu().solve(&right) {
            terms = solution;
        }
        let off =
            |(x, y, value): &(usize, usize, f64)| (row(*x, *y, width, height).dot(&terms) - value).abs();
        let differences: Vec<f64> = samples.iter().map(off).collect();
        let mut sorted = differences.clone();
        sorted.sort_by(f64::total_cmp);
        typical = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        // Tukey's biweight: dust and the rim of the surface drop out.
        let reach = 6.0 * typical.max(1e-6);
        let weight = |d: &f64| if *d < reach { (1.0 - (d / reach).powi(2)).powi(2) } else { 0.0 };
        weights = differences.iter().map(weight).collect();
    }
    (terms, typical)
}

fn row(x: usize, y: usize, width: usize, height: usize) -> DVector<f64> {
    let unit = 0.5 * (width as f64).hypot(height as f64);
    let (x, y) =
        ((x as f64 - 0.5 * (width as f64 - 1.0)) / unit, (y as f64 - 0.5 * (height as f64 - 1.0)) / unit);
    let u = x * x + y * y;
    DVector::from_column_slice(&[1.0, x, y, u, u * u, u * u * u])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::tests::Noise;

    fn truth(x: usize, y: usize) -> f64 {
        let (dx, dy) = ((x as f64 - 79.5) / 100.0, (y as f64 - 59.5) / 100.0);
        // cos⁴ of the angle, as of a simple lens.
        1.0 / (1.0 + 0.8 * (dx * dx + dy * dy)).powi(2)
    }

    fn surface(gamma: f64, dust: bool) -> Vec<GrayImage> {
        let mut noise = Noise::new(3);
        (0..5)
            .map(|i| {
                let data = (0..160 * 120).map(|p| {
                    let (x, y) = (p % 160, p / 160);
                    let spot = if dust && x / 10 == 4 && y / 10 == 3 { 0.5 } else { 1.0 };
                    let light = (0.6 + 0.05 * i as f64) * truth(x, y) * spot;
                    (255.0 * light.powf(1.0 / gamma) + 2.0 * noise.normal()).round().clamp(0.0, 254.0) as u8
                });
                GrayImage::from_vec(160, 120, data.collect()).unwrap()
            })
            .collect()
    }

    #[test]
    fn a_vignette_is_found_again_behind_a_response() {
        let inverse: Vec<f64> = (0..256).map(|level| (level as f64 / 255.0).powf(2.2)).collect();
        let response = PhotometricCalibration::new(Some(&inverse), None).unwrap();
        let found = estimate_vignette(&surface(2.2, true), &response).unwrap();
        for (x, y) in [(80, 60), (0, 0), (159, 119), (20, 100), (45, 35)] {
            let error = (f64::from(found.get(x, y)) - truth(x, y)).abs();
            assert!(error < 0.02, "({x}, {y}): {error}");
        }
    }

    #[test]
    fn what_is_no_even_surface_is_refused() {
        let plain = PhotometricCalibration::new(None, None).unwrap();
        let message = |images: &[GrayImage]| estimate_vignette(images, &plain).unwrap_err().to_string();
        assert!(message(&[]).contains("no images"));
        assert!(message(&[GrayImage::filled(40, 30, 255)]).contains("white"));
        assert!(message(&[GrayImage::filled(40, 30, 9)]).contains("dark"));
        let stripes = (0..160 * 120).map(|i| if i / 8 % 2 == 0 { 90 } else { 160 }).collect();
        assert!(message(&[GrayImage::from_vec(160, 120, stripes).unwrap()]).contains("not even"));
        let other = [GrayImage::filled(40, 30, 99), GrayImage::filled(30, 40, 99)];
        assert!(message(&other).contains("image 1"));
    }
}
