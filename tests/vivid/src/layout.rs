//! Grey pictures in the pixel formats of cameras.

use anyhow::{Result, bail};
use image::GrayImage;

/// The formats that both the driver and loopbox have. The driver makes no MJPEG.
pub const FORMATS: [&str; 5] = ["GREY", "Y16", "YUYV", "UYVY", "NV12"];

/// Chroma of a picture without colour.
const NEUTRAL: u8 = 128;

/// V4L2's four characters of a format.
///
/// # Errors
/// When it is none of [`FORMATS`].
pub fn code(format: &str) -> Result<[u8; 4]> {
    match format {
        "Y16" => Ok(*b"Y16 "),
        "GREY" | "YUYV" | "UYVY" | "NV12" => {
            let bytes = format.as_bytes();
            Ok([bytes[0], bytes[1], bytes[2], bytes[3]])
        }
        other => bail!("pixel format {other}: there are {}", FORMATS.join(", ")),
    }
}

/// The bytes of a picture with an even number of columns and rows, rows without padding.
///
/// # Errors
/// When the format is none of [`FORMATS`].
pub fn bytes(picture: &GrayImage, format: &str) -> Result<Vec<u8>> {
    let luma = picture.as_raw();
    Ok(match format {
        "GREY" => luma.clone(),
        "Y16" => luma.iter().flat_map(|&y| [y, y]).collect(),
        "YUYV" => luma.iter().flat_map(|&y| [y, NEUTRAL]).collect(),
        "UYVY" => luma.iter().flat_map(|&y| [NEUTRAL, y]).collect(),
        "NV12" => [luma.as_slice(), &vec![NEUTRAL; luma.len() / 2]].concat(),
        other => bail!("pixel format {other}: there are {}", FORMATS.join(", ")),
    })
}
