//! Pictures as a recording holds them: encoded ones byte for byte, raw ones as grey PNG.

use crate::pictures::{GreyRange, Picture, RawPicture};
use geometry::GrayImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageFormat};

/// The bytes of an image file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedPicture {
    /// `jpeg`, `png`, or empty where the bytes are neither (a torn frame, say).
    pub format: &'static str,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// Encodes a picture without loss of anything that tracking sees: JPEG and PNG pass as they are, all others
/// become grey PNG (of 16 bits where the picture had them).
///
/// # Errors
/// Says why there is no picture: an unreadable file, an unknown layout of pixels.
pub fn encode(picture: Picture) -> Result<EncodedPicture, String> {
    match picture {
        Picture::File(path) => {
            let bytes = std::fs::read(&path).map_err(|e| format!("{}: {e}", path.display()))?;
            of_bytes(bytes).map_err(|e| format!("{}: {e}", path.display()))
        }
        Picture::Encoded(bytes) => of_bytes(bytes),
        Picture::Raw(raw) if is_deep(&raw) => deep(&raw),
        Picture::Ranged(picture, range) => ranged(*picture, range),
        picture => grey(&picture.into_grey()?),
    }
}

fn is_deep(raw: &RawPicture) -> bool {
    matches!(raw.encoding.as_str(), "mono16" | "16UC1")
}

/// Of more than eight bits: those that pass as they are have the recording's range beside them, the others are what tracking sees.
fn ranged(picture: Picture, range: GreyRange) -> Result<EncodedPicture, String> {
    let passes = match &picture {
        Picture::Raw(raw) => is_deep(raw),
        Picture::File(path) => ImageFormat::from_path(path).is_ok_and(|format| format == ImageFormat::Png),
        Picture::Encoded(bytes) => image::guess_format(bytes).is_ok_and(|format| format == ImageFormat::Png),
        _ => false,
    };
    if passes { encode(picture) } else { grey(&Picture::Ranged(Box::new(picture), range).into_grey()?) }
}

fn of_bytes(bytes: Vec<u8>) -> Result<EncodedPicture, String> {
    Ok(match image::guess_format(&bytes) {
        Ok(ImageFormat::Jpeg) => EncodedPicture { format: "jpeg", bytes },
        Ok(ImageFormat::Png) => EncodedPicture { format: "png", bytes },
        // Few tools know these in a message.
        Ok(ImageFormat::Pnm | ImageFormat::Tiff | ImageFormat::Bmp) => {
            grey(&Picture::Encoded(bytes).into_grey()?)?
        }
        // Kept, so that a replay meets the same damage as the run did.
        _ => EncodedPicture { format: "", bytes },
    })
}

fn grey(image: &GrayImage) -> Result<EncodedPicture, String> {
    png(image.data(), image.width(), image.height(), ExtendedColorType::L8)
}

fn deep(raw: &RawPicture) -> Result<EncodedPicture, String> {
    let samples = raw.rows(2)?.flat_map(|row| row.chunks_exact(2)).flat_map(|sample| {
        let pair = [sample[0], sample[1]];
        let value = if raw.big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) };
        // The encoder takes samples in the machine's order.
        value.to_ne_bytes()
    });
    png(&samples.collect::<Vec<u8>>(), raw.width, raw.height, ExtendedColorType::L16)
}

fn png(
    samples: &[u8],
    width: usize,
    height: usize,
    colour: ExtendedColorType,
) -> Result<EncodedPicture, String> {
    let side = |length| u32::try_from(length).map_err(|_| "the picture is too large".to_owned());
    let mut bytes = Vec::with_capacity(samples.len());
    // Measured at 640×480: 1.3 ms and 126 to 211 kB a picture; the default takes 20 to 35 ms and is no smaller.
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Paeth)
        .write_image(samples, side(width)?, side(height)?, colour)
        .map_err(|error| error.to_string())?;
    Ok(EncodedPicture { format: "png", bytes })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(encoding: &str, big_endian: bool, step: usize, data: Vec<u8>) -> Picture {
        Picture::Raw(RawPicture { width: 3, height: 2, step, encoding: encoding.into(), big_endian, data })
    }

    #[test]
    fn every_layout_comes_back_as_the_grey_that_tracking_saw() {
        let bytes: Vec<u8> = (0..40u8).map(|i| i.wrapping_mul(97)).collect();
        let layouts =
            [("mono8", 1), ("mono16", 2), ("bgr8", 3), ("rgba8", 4), ("yuv422", 2), ("yuv422_yuy2", 2)];
        for (encoding, pixel) in layouts {
            for big_endian in [false, true] {
                let picture =
                    || raw(encoding, big_endian, 3 * pixel + 2, bytes[..2 * (3 * pixel + 2)].to_vec());
                let stored = encode(picture()).unwrap();
                assert_eq!(stored.format, "png");
                let seen = picture().into_grey().unwrap();
                assert_eq!(Picture::Encoded(stored.bytes).into_grey().unwrap(), seen, "{encoding}");
            }
        }
    }

    #[test]
    fn sixteen_bits_are_kept() {
        let stored = encode(raw("mono16", false, 6, (0..12).collect())).unwrap();
        let image = image::load_from_memory(&stored.bytes).unwrap().into_luma16();
        assert_eq!(image.into_raw(), [0x0100, 0x0302, 0x0504, 0x0706, 0x0908, 0x0b0a]);
    }

    #[test]
    fn encoded_pictures_pass_byte_for_byte_torn_ones_too() {
        let bytes = vec![0xff, 0xd8, 0xff, 0xe0, 1, 2, 3];
        assert_eq!(
            encode(Picture::Encoded(bytes.clone())).unwrap(),
            EncodedPicture { format: "jpeg", bytes }
        );
        assert_eq!(encode(Picture::Encoded(vec![1, 2])).unwrap().bytes, [1, 2]);
        assert!(encode(Picture::Broken("torn".into())).is_err());
        assert!(encode(raw("32FC1", false, 12, vec![0; 24])).is_err());
        assert!(encode(raw("mono16", false, 6, vec![0; 5])).is_err());
    }
}
