//! Photometric calibration: from recorded grey levels to those of an ideal sensor.

use crate::{GrayImage, Image, ImageSizeError};
use thiserror::Error;

/// Why numbers are no photometric calibration.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PhotometricError {
    /// The response has not one value for each of 256 grey levels.
    #[error("the response has {found} values, not 256 (one for each 8-bit grey level)")]
    ResponseLength {
        /// Number of values given.
        found: usize,
    },
    /// The inverse response does not grow from this grey level to the next, or is not finite.
    #[error("the inverse response does not grow from grey level {level} to the next")]
    ResponseOrder {
        /// The grey level.
        level: usize,
    },
    /// The vignette has a value that is not a finite number ≥ 0.
    #[error("the vignette at column {x}, row {y} is {value}, not a number from 0")]
    VignetteValue {
        /// Column of the pixel.
        x: usize,
        /// Row of the pixel.
        y: usize,
        /// What was given.
        value: f32,
    },
    /// The vignette is zero everywhere (or has no pixels).
    #[error("the vignette is black everywhere")]
    VignetteBlack,
}

/// Undoes a camera's response and vignette: `I' = G⁻¹(I) / V`, in grey levels 0–255
/// (Engel 2016, "A Photometrically Calibrated Benchmark For Monocular Visual Odometry", Eq. 2).
#[derive(Clone, Debug, PartialEq)]
pub struct PhotometricCalibration {
    inverse_response: [f32; 256],
    /// `1 / V`; zero where the lens lets no light through.
    gain: Option<Image<f32>>,
}

impl PhotometricCalibration {
    /// From the inverse response (256 growing values, any scale; `None`: the sensor is linear) and the
    /// vignette (attenuation of each pixel, any scale; `None`: none).
    ///
    /// # Errors
    /// When the response is not 256 growing numbers, or the vignette is negative, not finite or all zero.
    pub fn new(response: Option<&[f64]>, vignette: Option<&Image<f32>>) -> Result<Self, PhotometricError> {
        let inverse_response = match response {
            Some(values) => normalized_response(values)?,
            None => std::array::from_fn(|level| level as f32),
        };
        let gain = vignette.map(gain_of).transpose()?;
        Ok(Self { inverse_response, gain })
    }

    /// The irradiance of each recorded grey level, scaled to 0–255.
    pub fn inverse_response(&self) -> &[f32; 256] {
        &self.inverse_response
    }

    /// The corrected image, before undistortion. Levels above 255 (bright and dark-cornered) become 255.
    ///
    /// # Errors
    /// When the image has not the size of the vignette.
    pub fn apply(&self, image: &GrayImage) -> Result<GrayImage, ImageSizeError> {
        let mut output = image.clone();
        self.apply_in_place(&mut output)?;
        Ok(output)
    }

    /// As [`apply`](Self::apply), overwriting the image.
    ///
    /// # Errors
    /// When the image has not the size of the vignette; it is then left as it was.
    pub fn apply_in_place(&self, image: &mut GrayImage) -> Result<(), ImageSizeError> {
        // `as u8` saturates.
        let Some(gain) = &self.gain else {
            let rounded = self.inverse_response.map(|level| (level + 0.5) as u8);
            image.data_mut().iter_mut().for_each(|pixel| *pixel = rounded[*pixel as usize]);
            return Ok(());
        };
        let (found, expected) = ((image.width(), image.height()), (gain.width(), gain.height()));
        if found != expected {
            return Err(ImageSizeError { found, expected });
        }
        for (pixel, gain) in image.data_mut().iter_mut().zip(gain.data()) {
            *pixel = (self.inverse_response[*pixel as usize] * gain + 0.5) as u8;
        }
        Ok(())
    }
}

/// The response scaled such that the first value is 0 and the last 255.
fn normalized_response(values: &[f64]) -> Result<[f32; 256], PhotometricError> {
    let values: &[f64; 256] =
        values.try_into().map_err(|_| PhotometricError::ResponseLength { found: values.len() })?;
    // Written such that NaN is refused too.
    let grows = |pair: &[f64]| pair[1] > pair[0] && (pair[1] - pair[0]).is_finite();
    if let Some(level) = values.windows(2).position(|pair| !grows(pair)) {
        return Err(PhotometricError::ResponseOrder { level });
    }
    let (first, last) = (values[0], values[255]);
    Ok(values.map(|value| ((value - first) / (last - first) * 255.0) as f32))
}

/// `max V / V`, so that the brightest place keeps its level.
fn gain_of(vignette: &Image<f32>) -> Result<Image<f32>, PhotometricError> {
    let bad = vignette.data().iter().position(|value| !(value.is_finite() && *value >= 0.0));
    if let Some(index) = bad {
        let (x, y) = (index % vignette.width(), index / vignette.width());
        return Err(PhotometricError::VignetteValue { x, y, value: vignette.data()[index] });
    }
    let brightest = vignette.data().iter().copied().fold(0.0, f32::max);
    if brightest == 0.0 {
        return Err(PhotometricError::VignetteBlack);
    }
    let mut gain = vignette.clone();
    for value in gain.data_mut() {
        *value = if *value > 0.0 { brightest / *value } else { 0.0 };
    }
    Ok(gain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square_root_camera() -> Vec<f64> {
        // A sensor that records 255 √(L / 255): its inverse is I² / 255, here in odd units.
        (0..256).map(|level| 3.0 + (level * level) as f64 * 7.0).collect()
    }

    #[test]
    fn undoes_response_and_vignette() {
        let vignette = Image::from_vec(2, 1, vec![40000.0f32, 20000.0]).unwrap();
        let calibration = PhotometricCalibration::new(Some(&square_root_camera()), Some(&vignette)).unwrap();
        // Level 100 is irradiance 100² / 255 = 39.2; behind half the light it stands for 78.4.
        let image = GrayImage::from_vec(2, 1, vec![100, 100]).unwrap();
        assert_eq!(calibration.apply(&image).unwrap().data(), [39, 78]);
        let white = GrayImage::from_vec(2, 1, vec![255, 255]).unwrap();
        assert_eq!(calibration.apply(&white).unwrap().data(), [255, 255]);
    }

    #[test]
    fn without_parts_nothing_changes() {
        let image = GrayImage::from_vec(256, 1, (0..=255).collect()).unwrap();
        let neutral = PhotometricCalibration::new(None, None).unwrap();
        assert_eq!(neutral.apply(&image).unwrap(), image);
        let flat = PhotometricCalibration::new(None, Some(&Image::filled(256, 1, 9.0))).unwrap();
        assert_eq!(flat.apply(&image).unwrap(), image);
    }

    #[test]
    fn bad_numbers_are_refused() {
        let of_response = |values: &[f64]| PhotometricCalibration::new(Some(values), None).unwrap_err();
        assert_eq!(of_response(&[1.0; 255]), PhotometricError::ResponseLength { found: 255 });
        let mut values = square_root_camera();
        values[7] = values[6];
        assert_eq!(of_response(&values), PhotometricError::ResponseOrder { level: 6 });
        values[7] = f64::NAN;
        assert_eq!(of_response(&values), PhotometricError::ResponseOrder { level: 6 });
        let of_vignette = |value: f32| {
            let vignette = Image::from_vec(2, 1, vec![0.0, value]).unwrap();
            PhotometricCalibration::new(None, Some(&vignette)).unwrap_err()
        };
        assert_eq!(of_vignette(0.0), PhotometricError::VignetteBlack);
        assert_eq!(of_vignette(-1.0), PhotometricError::VignetteValue { x: 1, y: 0, value: -1.0 });
    }

    #[test]
    fn another_size_is_refused() {
        let calibration = PhotometricCalibration::new(None, Some(&Image::filled(4, 4, 1.0))).unwrap();
        assert!(calibration.apply(&GrayImage::filled(4, 3, 0)).is_err());
    }
}
