//! A keyframe's image as a JPEG file.

use geometry::{GrayImage, Pinhole};
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder};
use std::io::Cursor;

/// Quality of the JPEG, of 100: 72 kB at 640×480. Merged by images of this quality and rounded depths, 7 keyframes of
/// parking_a and of _c put the one 7.1 mm from where it belongs, the whole maps with exact ones 5.4 mm.
const QUALITY: u8 = 75;

/// An image as a JPEG file.
///
/// # Errors
/// When it has no pixels, or more than 65,535 in a row or column.
pub fn encode(image: &GrayImage) -> Result<Vec<u8>, String> {
    let side = |pixels: usize| u32::try_from(pixels).map_err(|error| error.to_string());
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, QUALITY);
    let (width, height) = (side(image.width())?, side(image.height())?);
    let done = encoder.encode(image.data(), width, height, ExtendedColorType::L8);
    done.map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// The inverse of [`encode`], of an image that `camera` may have taken.
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn decode(bytes: &[u8], camera: &Pinhole) -> Result<GrayImage, String> {
    let wrong = |what: String| format!("a JPEG cannot be used: {what}");
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|error| wrong(error.to_string()))?;
    // The size is checked first, so that no other size's memory is ever asked for.
    let (width, height) = decoder.dimensions();
    if (width as usize, height as usize) != (camera.width, camera.height) {
        return Err(wrong(format!("it has {width}×{height} pixels, as no image of the camera")));
    }
    if decoder.color_type() != ColorType::L8 {
        return Err(wrong("it is not grey".into()));
    }
    let mut pixels = vec![0; camera.width * camera.height];
    decoder.read_image(&mut pixels).map_err(|error| wrong(error.to_string()))?;
    GrayImage::from_vec(camera.width, camera.height, pixels)
        .ok_or_else(|| wrong("it has too few pixels".into()))
}
