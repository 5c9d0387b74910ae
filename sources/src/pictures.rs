//! Pictures as files and messages store them, and their conversion to grey images.

mod bayer;
mod color;
mod color_planes;
mod depth;
mod ends;
mod jpeg;
mod levels;
mod metadata;
mod raw;
mod rows;

pub use color::ColorPicture;
pub use color_planes::ColorPlanes;
pub use depth::read_depth_image;
pub use jpeg::{decode_jpeg, decode_mjpeg, whole_jpeg};
pub use levels::{GreyRange, Levels};
pub use metadata::StatedFocal;
pub use raw::RawPicture;

use geometry::limits::{MAX_BYTES, check_image_size};
use geometry::{GrayImage, Image};
use image::DynamicImage;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// A picture before decoding.
#[derive(Clone, Debug)]
pub enum Picture {
    /// An image file, read when it is decoded.
    File(PathBuf),
    /// The bytes of an image file: PNG, JPEG, PNM, TIFF or BMP.
    Encoded(Vec<u8>),
    /// Pixels as they come from a camera.
    Raw(RawPicture),
    /// One of more than eight bits, with the range of the recording's that becomes 0–255.
    Ranged(Box<Picture>, GreyRange),
    /// The source could not read it; holds the reason.
    Broken(String),
    /// Its time stamp is not of the recording's clock, so the time of the picture is unknown; holds the reason.
    Mistimed(String),
    /// The recording attributes it to another camera than those before, or to another zoom; holds the reason.
    OfOther(String),
}

/// What Git LFS puts in the place of a file that was not fetched begins so.
const LFS_POINTER: &[u8] = b"version https://git-lfs";

/// Grey levels as they are stored.
enum Grey {
    Eight(GrayImage),
    Sixteen(Image<u16>),
}

/// Grey levels, and the picture that they were decoded from if it has colours.
struct Decoded {
    grey: Grey,
    color: Option<ColorPicture>,
}

impl Picture {
    /// The picture as grey levels 0–255, or why there is none.
    ///
    /// Colour becomes Rec. 709 luma; of JPEG files and YUV layouts the luma they hold is taken, of Bayer mosaics the mean of the
    /// colours around each pixel. Levels of 16-bit samples are those of the picture's range, or their high byte where it has none.
    pub fn into_grey(self) -> Result<GrayImage, String> {
        self.into_grey_and_color().map(|(grey, _)| grey)
    }

    /// The same, and what its colours can be decoded from, where it may have some. Pictures of 16-bit samples give none.
    pub fn into_grey_and_color(self) -> Result<(GrayImage, Option<ColorPicture>), String> {
        let (picture, range) = match self {
            Picture::Ranged(picture, range) => (*picture, range),
            picture => (picture, GreyRange::WHOLE),
        };
        let Decoded { grey, color } = picture.decoded()?;
        match grey {
            Grey::Eight(image) => Ok((image, color)),
            Grey::Sixteen(image) => Ok((range.apply(&image)?, None)),
        }
    }

    /// That its time stamp, seconds, is none.
    pub(crate) fn mistimed(stamp: f64) -> Self {
        Self::Mistimed(format!("its time stamp {stamp} lies off those around it"))
    }

    /// Bytes that it holds in memory.
    pub fn memory_bytes(&self) -> u64 {
        self.bytes() as u64
    }

    /// Why there is no image, if that is visible without decoding it: a file that is missing, empty, of another kind
    /// or cut off.
    pub fn trouble(&self) -> Option<String> {
        match self {
            Picture::File(path) => {
                ends::of_file(path).err().map(|what| format!("{}: {what}", path.display()))
            }
            Picture::Encoded(bytes) => ends::of_bytes(bytes).err(),
            Picture::Raw(_) => None,
            Picture::Ranged(picture, _) => picture.trouble(),
            Picture::Broken(reason) | Picture::Mistimed(reason) | Picture::OfOther(reason) => {
                Some(reason.clone())
            }
        }
    }

    fn decoded(self) -> Result<Decoded, String> {
        match self {
            Picture::File(path) => read_file(&path, decode),
            Picture::Encoded(bytes) => decode(bytes),
            Picture::Raw(raw) => Ok(Decoded { grey: raw.levels()?, color: ColorPicture::raw(raw) }),
            Picture::Ranged(picture, _) => picture.decoded(),
            Picture::Broken(reason) | Picture::Mistimed(reason) | Picture::OfOther(reason) => Err(reason),
        }
    }
}

/// Reads an image's file as `read` does its bytes; what is wrong names the file.
fn read_file<T>(path: &Path, read: impl FnOnce(Vec<u8>) -> Result<T, String>) -> Result<T, String> {
    let of_file = |what: String| format!("{}: {what}", path.display());
    let about = std::fs::metadata(path).map_err(|e| of_file(e.to_string()))?;
    if about.len() > MAX_BYTES as u64 {
        return Err(of_file(format!("{} bytes are no image", about.len())));
    }
    let bytes = std::fs::read(path).map_err(|e| of_file(e.to_string()))?;
    read(bytes).map_err(of_file)
}

/// Decodes the bytes of a PNG, JPEG, PNM, TIFF or BMP file.
fn decode(bytes: Vec<u8>) -> Result<Decoded, String> {
    if jpeg::is_jpeg(&bytes)
        && let Some((luma, has_color)) = jpeg::decode_luma(&bytes)?
    {
        return Ok(Decoded {
            grey: Grey::Eight(luma),
            color: has_color.then(|| ColorPicture::encoded(bytes)),
        });
    }
    let image = decode_any(&bytes, "PNG, JPEG, PGM, TIFF or BMP")?;
    let color = image.color().has_color().then(|| ColorPicture::encoded(bytes));
    Ok(Decoded { grey: to_grey(image)?, color })
}

/// Decodes the bytes of an image file of any kind that the program knows, once its size was found to be one; `kinds` are
/// those that should have been given, for people.
fn decode_any(bytes: &[u8], kinds: &str) -> Result<DynamicImage, String> {
    let format = image::guess_format(bytes).map_err(|_| match bytes {
        [] => "the file is empty".to_owned(),
        bytes if bytes.starts_with(LFS_POINTER) => {
            "a pointer of Git LFS in place of the image: `git lfs pull` fetches it".to_owned()
        }
        _ => format!("not a {kinds} image"),
    })?;
    let reader = || image::ImageReader::with_format(Cursor::new(bytes), format);
    let (width, height) = reader().into_dimensions().map_err(|e| e.to_string())?;
    check_image_size(width as usize, height as usize)?;
    reader().decode().map_err(|e| e.to_string())
}

fn to_grey(image: DynamicImage) -> Result<Grey, String> {
    use DynamicImage::{ImageLuma8, ImageLuma16, ImageLumaA16, ImageRgb16, ImageRgba16};
    let (width, height) = (image.width() as usize, image.height() as usize);
    let none = || "the image has no pixels".to_owned();
    match image {
        deep @ (ImageLuma16(_) | ImageLumaA16(_) | ImageRgb16(_) | ImageRgba16(_)) => {
            let deep = deep.into_luma16().into_raw();
            Image::from_vec(width, height, deep).map(Grey::Sixteen).ok_or_else(none)
        }
        ImageLuma8(grey) => eight(width, height, grey.into_raw()),
        other => eight(width, height, other.into_luma8().into_raw()),
    }
}

fn eight(width: usize, height: usize, levels: Vec<u8>) -> Result<Grey, String> {
    GrayImage::from_vec(width, height, levels)
        .map(Grey::Eight)
        .ok_or_else(|| "the image has no pixels".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::ImageFormat;

    fn decode(bytes: &[u8]) -> Result<GrayImage, String> {
        Picture::Encoded(bytes.to_vec()).into_grey()
    }

    fn raw(encoding: &str, step: usize, data: Vec<u8>) -> RawPicture {
        RawPicture { width: 2, height: 1, step, encoding: encoding.into(), big_endian: false, data }
    }

    #[test]
    fn raw_layouts_become_grey() {
        let grey = |raw: RawPicture| Picture::Raw(raw).into_grey().map(|image| image.data().to_vec());
        assert_eq!(grey(raw("mono8", 4, vec![1, 2, 99, 99])).unwrap(), [1, 2]);
        assert_eq!(grey(raw("mono16", 4, vec![9, 1, 9, 2])).unwrap(), [1, 2]);
        let big = RawPicture { big_endian: true, ..raw("mono16", 4, vec![1, 9, 2, 9]) };
        assert_eq!(grey(big).unwrap(), [1, 2]);
        assert_eq!(grey(raw("yuv422", 4, vec![128, 7, 128, 8])).unwrap(), [7, 8]);
        assert_eq!(grey(raw("yuv422_yuy2", 4, vec![7, 128, 8, 128])).unwrap(), [7, 8]);
        assert_eq!(grey(raw("nv12", 4, vec![1, 2, 9, 9, 128, 128, 9, 9])).unwrap(), [1, 2]);
        assert!(grey(raw("nv12", 2, vec![1, 2])).is_err());
        let red = raw::luma(255u8, 0, 0) as u8;
        assert_eq!(grey(raw("rgb8", 6, vec![255, 0, 0, 0, 0, 0])).unwrap(), [red, 0]);
        assert_eq!(grey(raw("bgra8", 8, vec![0, 0, 255, 255, 0, 0, 0, 255])).unwrap(), [red, 0]);
    }

    #[test]
    fn raw_data_that_does_not_fit_is_refused() {
        let grey = |raw: RawPicture| Picture::Raw(raw).into_grey();
        assert!(grey(raw("mono8", 2, vec![1])).is_err());
        assert!(grey(raw("mono8", 1, vec![1, 2])).is_err());
        assert!(grey(raw("32FC1", 8, vec![0; 8])).unwrap_err().contains("32FC1"));
    }

    #[test]
    fn a_truncated_jpeg_is_refused_and_a_whole_one_decodes() {
        let mut bytes = Vec::new();
        let image = image::GrayImage::from_fn(32, 24, |x, y| image::Luma([(x * 5 + y) as u8]));
        image.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Jpeg).unwrap();
        assert_eq!(decode(&bytes).unwrap().width(), 32);
        assert!(decode(&bytes[..bytes.len() / 2]).unwrap_err().contains("truncated"));
        bytes.extend([0, 0]);
        assert!(decode(&bytes).is_ok());
    }

    #[test]
    fn other_formats_without_loss_say_the_same_as_png() {
        let image = image::GrayImage::from_fn(32, 24, |x, y| image::Luma([(x * 5 + y) as u8]));
        let deep = image::ImageBuffer::from_fn(32, 24, |x, y| image::Luma([(x * 1111 + y) as u16]));
        let decoded = |image: &DynamicImage, format| {
            let mut bytes = Vec::new();
            image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
            decode(&bytes).unwrap()
        };
        for (image, formats) in [
            (image.into(), vec![ImageFormat::Bmp, ImageFormat::Tiff]),
            (deep.into(), vec![ImageFormat::Tiff]),
        ] {
            let expected = decoded(&image, ImageFormat::Png);
            assert!(formats.into_iter().all(|format| decoded(&image, format) == expected));
        }
    }

    #[test]
    fn sixteen_bits_without_a_range_keep_the_high_byte() {
        let deep = || raw("mono16", 4, vec![0xff, 0x7f, 0, 1]);
        assert_eq!(Picture::Raw(deep()).into_grey().unwrap().data(), [0x7f, 1]);
        let ranged = Picture::Ranged(
            Box::new(Picture::Raw(deep())),
            GreyRange { from: 0x100, to: 0x1ff, ..GreyRange::WHOLE },
        );
        assert_eq!(ranged.into_grey().unwrap().data(), [255, 0]);
    }
}
