//! Response and vignette files in the form of the TUM monocular benchmark.

use crate::CalibError;
use geometry::{Image, PhotometricCalibration};
use std::path::Path;

/// Reads a photometric calibration: the inverse response (`pcalib.txt`: 256 numbers) and the vignette
/// (a grey PNG of 8 or 16 bits); either may be left out.
///
/// # Errors
/// When a file cannot be read, or its numbers make no sense.
pub fn read_photometric(
    response: Option<&Path>,
    vignette: Option<&Path>,
) -> Result<PhotometricCalibration, CalibError> {
    let response = response.map(read).transpose()?;
    let vignette = vignette.map(read).transpose()?;
    parse_photometric(
        response.as_ref().map(|(name, bytes)| (name.as_str(), bytes.as_slice())),
        vignette.as_ref().map(|(name, bytes)| (name.as_str(), bytes.as_slice())),
    )
}

/// A file's name and bytes.
fn read(path: &Path) -> Result<(String, Vec<u8>), CalibError> {
    let file = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| CalibError::Read { file: file.clone(), source })?;
    Ok((file, bytes))
}

/// As [`read_photometric`], from the bytes of the files; a name stands for its file in messages.
///
/// # Errors
/// When the numbers make no sense.
pub fn parse_photometric(
    response: Option<(&str, &[u8])>,
    vignette: Option<(&str, &[u8])>,
) -> Result<PhotometricCalibration, CalibError> {
    let values = response.map(|(name, bytes)| parse_response(name, bytes)).transpose()?;
    let attenuation = vignette.map(|(name, bytes)| parse_vignette(name, bytes)).transpose()?;
    let of = |part: Option<(&str, &[u8])>| {
        let file = part.map(|(name, _)| name.to_owned()).unwrap_or_default();
        move |source| CalibError::Photometric { file, source }
    };
    // Each part is checked alone first, so that the message names the file at fault.
    PhotometricCalibration::new(values.as_deref(), None).map_err(of(response))?;
    PhotometricCalibration::new(values.as_deref(), attenuation.as_ref()).map_err(of(vignette))
}

fn parse_response(file: &str, bytes: &[u8]) -> Result<Vec<f64>, CalibError> {
    String::from_utf8_lossy(bytes)
        .split_whitespace()
        .enumerate()
        .map(|(level, word)| {
            word.parse().map_err(|_| CalibError::BadValue {
                file: file.into(),
                key: format!("grey level {level}"),
                problem: format!("\"{word}\" is not a number"),
                fix: "give 256 numbers separated by spaces".into(),
            })
        })
        .collect()
}

fn parse_vignette(file: &str, bytes: &[u8]) -> Result<Image<f32>, CalibError> {
    let decoded = image::load_from_memory(bytes)
        .map_err(|error| CalibError::Image { file: file.into(), message: error.to_string() })?;
    // Only ratios count, so that both depths may go through 16 bits.
    let grey = decoded.into_luma16();
    let (width, height) = (grey.width() as usize, grey.height() as usize);
    let data = grey.into_raw().into_iter().map(f32::from).collect();
    Image::from_vec(width, height, data).ok_or_else(|| CalibError::Image {
        file: file.into(),
        message: "its size is not that of its pixels".into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::GrayImage;

    fn response_text() -> String {
        (0..256).map(|level| format!("{} ", (level * level) as f64 / 255.0)).collect()
    }

    #[test]
    fn reads_response_and_vignette() {
        let folder = tempfile::tempdir().unwrap();
        let (response, vignette) = (folder.path().join("pcalib.txt"), folder.path().join("vignette.png"));
        std::fs::write(&response, response_text()).unwrap();
        let pixels = image::ImageBuffer::from_raw(2, 1, vec![60000u16, 30000]).unwrap();
        image::DynamicImage::ImageLuma16(pixels).save(&vignette).unwrap();
        let calibration = read_photometric(Some(&response), Some(&vignette)).unwrap();
        let image = GrayImage::from_vec(2, 1, vec![100, 100]).unwrap();
        assert_eq!(calibration.apply(&image).unwrap().data(), [39, 78]);

        let pixels = image::ImageBuffer::from_raw(2, 1, vec![200u8, 100]).unwrap();
        image::DynamicImage::ImageLuma8(pixels).save(&vignette).unwrap();
        let calibration = read_photometric(None, Some(&vignette)).unwrap();
        assert_eq!(calibration.apply(&image).unwrap().data(), [100, 200]);
    }

    #[test]
    fn bad_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (response, vignette) = (folder.path().join("pcalib.txt"), folder.path().join("vignette.png"));
        let message = |response: Option<&Path>, vignette: Option<&Path>| {
            read_photometric(response, vignette).unwrap_err().to_string()
        };
        assert!(message(Some(&response), None).contains("pcalib.txt: cannot be read"));
        std::fs::write(&response, "1 2 3").unwrap();
        assert!(message(Some(&response), None).contains("3 values, not 256"));
        std::fs::write(&response, "1 two 3").unwrap();
        assert!(message(Some(&response), None).contains("\"two\" is not a number"));
        std::fs::write(&response, response_text().replacen("0.00392156862745098 ", "nan ", 1)).unwrap();
        assert!(message(Some(&response), None).contains("does not grow"));
        std::fs::write(&vignette, [1, 2, 3]).unwrap();
        assert!(message(None, Some(&vignette)).contains("vignette.png: not an image"));
        let black = image::ImageBuffer::from_raw(1, 1, vec![0u8]).unwrap();
        image::DynamicImage::ImageLuma8(black).save(&vignette).unwrap();
        assert!(message(None, Some(&vignette)).contains("vignette.png: the vignette is black"));
    }
}
