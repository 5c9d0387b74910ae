//! JPEG files and the frames of MJPEG cameras, which leave out what a file must have.

use super::color_planes::two_planes;
use geometry::GrayImage;
use geometry::limits::{MAX_PIXELS, check_image_size};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

const START: [u8; 2] = [0xff, 0xd8];
const END: [u8; 2] = [0xff, 0xd9];
const HUFFMAN_TABLES: u8 = 0xc4;
const SCAN: u8 = 0xda;

/// Whether the bytes are meant as a JPEG.
pub fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&START)
}

/// Makes a JPEG file of a frame as cameras deliver it: takes off what follows its end, and puts in the usual Huffman
/// tables, which most of them leave out.
///
/// # Errors
/// When the frame is none, or its end is missing.
pub fn whole_jpeg(mut bytes: Vec<u8>) -> Result<Vec<u8>, String> {
    if !is_jpeg(&bytes) {
        return Err("the frame is no JPEG".into());
    }
    bytes.truncate(end(&bytes).ok_or("the JPEG is truncated")?);
    if let Some(at) = place_for_tables(&bytes)? {
        bytes.splice(at..at, usual_tables());
    }
    Ok(bytes)
}

/// The luma of a JPEG file; `None` for the rare one that holds no luma (RGB or CMYK inside).
///
/// # Errors
/// When it is damaged or truncated.
pub fn decode_jpeg(bytes: &[u8]) -> Result<Option<GrayImage>, String> {
    Ok(decode_luma(bytes)?.map(|(luma, _)| luma))
}

/// The same, and whether the file has colours as well.
pub(super) fn decode_luma(bytes: &[u8]) -> Result<Option<(GrayImage, bool)>, String> {
    let Some(Samples { width, height, values, has_color }) = decode_as(bytes, ColorSpace::Luma)? else {
        return Ok(None);
    };
    let image = GrayImage::from_vec(width, height, values);
    image.map(|image| Some((image, has_color))).ok_or_else(|| "the JPEG has no pixels".into())
}

/// The differences of blue and red from the luma that a JPEG file holds; `None` of one without.
pub(super) fn decode_differences(bytes: &[u8]) -> Option<[GrayImage; 2]> {
    let Samples { width, height, values, has_color } = decode_as(bytes, ColorSpace::YCbCr).ok()??;
    let pixels = values.chunks_exact(3).map(|pixel| [pixel[1], pixel[2]]);
    has_color.then(|| two_planes(width, height, pixels))?
}

/// What a JPEG file decodes to.
struct Samples {
    width: usize,
    height: usize,
    /// The samples of each pixel in turn.
    values: Vec<u8>,
    /// Whether the file holds colours, whatever of them was decoded.
    has_color: bool,
}

/// The samples of a JPEG file that holds luma; `None` of others.
fn decode_as(bytes: &[u8], samples: ColorSpace) -> Result<Option<Samples>, String> {
    // Decoders fill what is missing with grey instead of failing.
    end(bytes).ok_or("the JPEG is truncated")?;
    let options = DecoderOptions::default()
        .set_max_width(MAX_PIXELS)
        .set_max_height(MAX_PIXELS)
        .jpeg_set_out_colorspace(samples);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    let say = |error: zune_jpeg::errors::DecodeErrors| format!("the JPEG is damaged: {error}");
    decoder.decode_headers().map_err(say)?;
    let has_color = match decoder.input_colorspace() {
        Some(ColorSpace::YCbCr) => true,
        Some(ColorSpace::Luma) => false,
        _ => return Ok(None),
    };
    if !has_color && samples != ColorSpace::Luma {
        return Ok(None);
    }
    let info = decoder.info().ok_or("the JPEG has no size")?;
    let (width, height) = (info.width as usize, info.height as usize);
    check_image_size(width, height)?;
    Ok(Some(Samples { width, height, values: decoder.decode().map_err(say)?, has_color }))
}

/// The luma of a frame of an MJPEG camera.
///
/// # Errors
/// When it is damaged or truncated.
pub fn decode_mjpeg(bytes: Vec<u8>) -> Result<GrayImage, String> {
    decode_jpeg(&whole_jpeg(bytes)?)?.ok_or_else(|| "the frame holds no luma".into())
}

/// Where the JPEG ends, behind its end marker; zeros may follow, with which cameras fill their last block.
fn end(bytes: &[u8]) -> Option<usize> {
    let end = bytes.iter().rposition(|&b| b != 0)? + 1;
    bytes[..end].ends_with(&END).then_some(end)
}

/// Whether these may be the last bytes of a whole JPEG: all zeros do not tell.
pub(super) fn may_end_so(tail: &[u8]) -> bool {
    tail.iter().all(|byte| *byte == 0) || end(tail).is_some()
}

/// Before its scan, if no Huffman tables come before that.
fn place_for_tables(bytes: &[u8]) -> Result<Option<usize>, String> {
    let mut at = START.len();
    loop {
        let damaged = || format!("the JPEG is damaged at byte {at}");
        let &[0xff, kind, ref rest @ ..] = bytes.get(at..).unwrap_or_default() else { return Err(damaged()) };
        match (kind, rest) {
            // A marker may be led by any number of these.
            (0xff, _) => at += 1,
            (HUFFMAN_TABLES, _) => return Ok(None),
            (SCAN, _) => return Ok(Some(at)),
            // Segments without content.
            (0x01 | 0xd0..=0xd7, _) => at += 2,
            (_, &[high, low, ..]) => {
                let length = u16::from_be_bytes([high, low]) as usize;
                if length < 2 {
                    return Err(damaged());
                }
                at += 2 + length;
            }
            _ => return Err(damaged()),
        }
    }
}

/// The tables of ITU-T T.81, K.3.3, that frames without any are coded with, as one segment.
fn usual_tables() -> Vec<u8> {
    let tables = [(0x00, &DC_LUMA_COUNTS, &DC_VALUES[..]), (0x10, &AC_LUMA_COUNTS, &AC_LUMA_VALUES[..])];
    let chroma =
        [(0x01, &DC_CHROMA_COUNTS, &DC_VALUES[..]), (0x11, &AC_CHROMA_COUNTS, &AC_CHROMA_VALUES[..])];
    let mut content = Vec::new();
    for (class, counts, values) in tables.into_iter().chain(chroma) {
        content.push(class);
        content.extend(counts);
        content.extend(values);
    }
    let length = (content.len() + 2) as u16;
    [&[0xff, HUFFMAN_TABLES], &length.to_be_bytes()[..], &content].concat()
}

/// How many codes there are of 1, 2, … 16 bits.
const DC_LUMA_COUNTS: [u8; 16] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
const DC_CHROMA_COUNTS: [u8; 16] = [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0];
const DC_VALUES: [u8; 12] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
const AC_LUMA_COUNTS: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d];
const AC_CHROMA_COUNTS: [u8; 16] = [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77];
#[rustfmt::skip]
const AC_LUMA_VALUES: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22, 0x71,
    0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33, 0x62, 0x72,
    0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x34, 0x35, 0x36, 0x37,
    0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59,
    0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83,
    0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3,
    0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3,
    0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2,
    0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
];
#[rustfmt::skip]
const AC_CHROMA_VALUES: [u8; 162] = [
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71, 0x13, 0x22,
    0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33, 0x52, 0xf0, 0x15, 0x62, 0x72, 0xd1,
    0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x35, 0x36,
    0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58,
    0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a,
    0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a,
    0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba,
    0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda,
    0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
];

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, ImageFormat};
    use std::io::Cursor;

    /// The encoder codes with the usual tables.
    fn coded(image: DynamicImage) -> Vec<u8> {
        let mut bytes = Vec::new();
        image.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Jpeg).unwrap();
        bytes
    }

    fn grey() -> Vec<u8> {
        coded(image::GrayImage::from_fn(48, 32, |x, y| image::Luma([(x * 5 + y * 3) as u8])).into())
    }

    fn coloured() -> Vec<u8> {
        coded(image::RgbImage::from_fn(48, 32, |x, y| image::Rgb([(x * 5) as u8, (y * 7) as u8, 90])).into())
    }

    /// As a camera sends it: without Huffman tables, and with zeros behind.
    fn as_camera(file: &[u8]) -> Vec<u8> {
        let mut at = 2;
        let mut bytes = file[..2].to_vec();
        loop {
            let length = 2 + u16::from_be_bytes([file[at + 2], file[at + 3]]) as usize;
            if file[at + 1] == SCAN {
                break;
            }
            if file[at + 1] != HUFFMAN_TABLES {
                bytes.extend(&file[at..at + length]);
            }
            at += length;
        }
        bytes.extend(&file[at..]);
        bytes.extend([0; 17]);
        bytes
    }

    #[test]
    fn frames_without_tables_decode_like_files_with_them() {
        for file in [grey(), coloured()] {
            let frame = as_camera(&file);
            assert!(frame.len() + 150 < file.len(), "the tables were there to be left out");
            let expected = decode_jpeg(&file).unwrap().unwrap();
            assert_eq!(decode_mjpeg(frame).unwrap().data(), expected.data());
            assert_eq!(whole_jpeg(file.clone()).unwrap(), file, "a whole file stays as it is");
        }
    }

    #[test]
    fn luma_is_that_of_the_picture() {
        let luma = decode_jpeg(&coloured()).unwrap().unwrap();
        let rgb = image::load_from_memory(&coloured()).unwrap().to_rgb8();
        for (x, y, pixel) in rgb.enumerate_pixels() {
            let [r, g, b] = pixel.0.map(f32::from);
            let expected = 0.299 * r + 0.587 * g + 0.114 * b;
            let found = luma.data()[(y * 48 + x) as usize] as f32;
            assert!((found - expected).abs() < 3.0, "{found} {expected} at {x} {y}");
        }
    }

    #[test]
    fn grey_files_keep_every_bit() {
        let other = image::load_from_memory(&grey()).unwrap().into_luma8();
        assert_eq!(decode_jpeg(&grey()).unwrap().unwrap().data(), other.as_raw());
    }

    #[test]
    fn damaged_frames_are_refused_and_none_panics() {
        let frame = as_camera(&coloured());
        assert!(decode_mjpeg(frame[..frame.len() / 2].to_vec()).unwrap_err().contains("truncated"));
        assert!(decode_mjpeg(vec![]).is_err());
        assert!(decode_mjpeg(vec![0; 100]).is_err());
        assert!(decode_mjpeg([START, END].concat()).is_err());
        assert!(decode_mjpeg([&START[..], &[0xff, 0xe0, 0, 1], &END].concat()).is_err());
        for i in 0..frame.len() {
            for value in [0, 0x7f, 0xff] {
                let mut damaged = frame.clone();
                damaged[i] = value;
                let _ = decode_mjpeg(damaged);
            }
            let mut cut = frame[..i].to_vec();
            cut.extend(END);
            let _ = decode_mjpeg(cut);
        }
    }
}
