//! Pictures as they lie in files and messages, and how they become grey images.

mod depth;
mod jpeg;
mod metadata;

pub use depth::read_depth_image;
pub use jpeg::{decode_jpeg, decode_mjpeg, whole_jpeg};
pub use metadata::StatedFocal;

use geometry::GrayImage;
use geometry::limits::{MAX_BYTES, check_image_size};
use image::{DynamicImage, ImageBuffer};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// A picture before decoding.
#[derive(Clone, Debug)]
pub enum Picture {
    /// An image file, read when its turn comes.
    File(PathBuf),
    /// The bytes of an image file: PNG, JPEG, PNM, TIFF or BMP.
    Encoded(Vec<u8>),
    /// Pixels as they come from a camera.
    Raw(RawPicture),
    /// The source could not read it; says why.
    Broken(String),
}

/// Uncompressed pixels with their layout.
#[derive(Clone, Debug)]
pub struct RawPicture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from one row to the next.
    pub step: usize,
    /// Layout in the words of ROS: `mono8`, `bgr8`, ….
    pub encoding: String,
    /// Whether 16-bit samples are stored high byte first.
    pub big_endian: bool,
    /// The bytes, at least `step · height`.
    pub data: Vec<u8>,
}

impl Picture {
    /// The picture as grey levels 0–255, or why there is none.
    ///
    /// Colour becomes Rec. 709 luma; of JPEG files and YUV layouts the luma they hold is taken. Of 16-bit samples the
    /// high byte is kept.
    pub fn into_grey(self) -> Result<GrayImage, String> {
        match self {
            Picture::File(path) => read_file(&path, decode),
            Picture::Encoded(bytes) => decode(&bytes),
            Picture::Raw(raw) => raw.into_grey(),
            Picture::Broken(reason) => Err(reason),
        }
    }
}

/// Reads an image's file as `read` does its bytes; what is wrong names the file.
fn read_file<T>(path: &Path, read: impl FnOnce(&[u8]) -> Result<T, String>) -> Result<T, String> {
    let of_file = |what: String| format!("{}: {what}", path.display());
    let about = std::fs::metadata(path).map_err(|e| of_file(e.to_string()))?;
    if about.len() > MAX_BYTES as u64 {
        return Err(of_file(format!("{} bytes are no image", about.len())));
    }
    let bytes = std::fs::read(path).map_err(|e| of_file(e.to_string()))?;
    read(&bytes).map_err(of_file)
}

/// Decodes the bytes of a PNG, JPEG, PNM, TIFF or BMP file.
fn decode(bytes: &[u8]) -> Result<GrayImage, String> {
    if jpeg::is_jpeg(bytes)
        && let Some(luma) = decode_jpeg(bytes)?
    {
        return Ok(luma);
    }
    to_grey(decode_any(bytes, "PNG, JPEG, PGM, TIFF or BMP")?)
}

/// Decodes the bytes of an image file of any kind that the program knows, once its size was found to be one; `kinds` are
/// those that should have been given, for people.
fn decode_any(bytes: &[u8], kinds: &str) -> Result<DynamicImage, String> {
    let format = image::guess_format(bytes).map_err(|_| format!("not a {kinds} image"))?;
    let reader = || image::ImageReader::with_format(Cursor::new(bytes), format);
    let (width, height) = reader().into_dimensions().map_err(|e| e.to_string())?;
    check_image_size(width as usize, height as usize)?;
    reader().decode().map_err(|e| e.to_string())
}

fn to_grey(image: DynamicImage) -> Result<GrayImage, String> {
    let grey = match image {
        DynamicImage::ImageLuma8(grey) => grey,
        DynamicImage::ImageLuma16(deep) => ImageBuffer::from_fn(deep.width(), deep.height(), |x, y| {
            image::Luma([(deep[(x, y)].0[0] >> 8) as u8])
        }),
        other => other.into_luma8(),
    };
    let (width, height) = (grey.width() as usize, grey.height() as usize);
    GrayImage::from_vec(width, height, grey.into_raw()).ok_or_else(|| "the image has no pixels".into())
}

/// Where a pixel's samples lie.
enum Layout {
    Mono8,
    Mono16,
    /// `(bytes per pixel, offset of red, of green, of blue)`
    Colour(usize, [usize; 3]),
    /// Luma alternates with chroma; the offset of the first luma.
    Yuv422(usize),
    /// All luma, then chroma in half as many rows.
    Nv12,
}

impl RawPicture {
    fn layout(&self) -> Result<Layout, String> {
        Ok(match self.encoding.as_str() {
            "mono8" | "8UC1" => Layout::Mono8,
            "mono16" | "16UC1" => Layout::Mono16,
            "rgb8" => Layout::Colour(3, [0, 1, 2]),
            "bgr8" | "8UC3" => Layout::Colour(3, [2, 1, 0]),
            "rgba8" => Layout::Colour(4, [0, 1, 2]),
            "bgra8" | "8UC4" => Layout::Colour(4, [2, 1, 0]),
            "yuv422" | "uyvy" | "UYVY" => Layout::Yuv422(1),
            "yuv422_yuy2" | "yuyv" | "YUYV" => Layout::Yuv422(0),
            "nv12" | "NV12" => Layout::Nv12,
            other => {
                return Err(format!(
                    "pixel encoding '{other}' is not supported (mono8, mono16, rgb8, bgr8, rgba8, bgra8, \
                     yuv422, yuv422_yuy2 and nv12 are)"
                ));
            }
        })
    }

    /// The rows, without what pads them; refuses sizes that the bytes do not fit.
    pub(crate) fn rows(&self, bytes_per_pixel: usize) -> Result<impl Iterator<Item = &[u8]>, String> {
        check_image_size(self.width, self.height)?;
        let row_bytes = self.width.checked_mul(bytes_per_pixel).ok_or("the width is absurd")?;
        let step = if self.step == 0 { row_bytes } else { self.step };
        let chroma_rows = if self.has_chroma_plane() { self.height.div_ceil(2) } else { 0 };
        let rows = self.height.checked_add(chroma_rows).ok_or("the height is absurd")?;
        let needed = step.checked_mul(rows).ok_or("the height is absurd")?;
        if self.width == 0 || self.height == 0 || step < row_bytes || self.data.len() < needed {
            return Err(format!(
                "{}×{} pixels of {} in rows of {step} bytes do not fit {} bytes",
                self.width,
                self.height,
                self.encoding,
                self.data.len()
            ));
        }
        Ok(self.data.chunks_exact(step).take(self.height).map(move |row| &row[..row_bytes]))
    }

    /// Whether colour lies behind the luma, in a plane of its own.
    fn has_chroma_plane(&self) -> bool {
        matches!(self.layout(), Ok(Layout::Nv12))
    }

    fn into_grey(self) -> Result<GrayImage, String> {
        let layout = self.layout()?;
        let bytes_per_pixel = match layout {
            Layout::Mono8 | Layout::Nv12 => 1,
            Layout::Mono16 | Layout::Yuv422(_) => 2,
            Layout::Colour(bytes, _) => bytes,
        };
        let mut grey = Vec::with_capacity(self.data.len() / bytes_per_pixel);
        for row in self.rows(bytes_per_pixel)? {
            let pixels = row.chunks_exact(bytes_per_pixel);
            match layout {
                Layout::Mono8 | Layout::Nv12 => grey.extend_from_slice(row),
                Layout::Mono16 => grey.extend(pixels.map(|p| if self.big_endian { p[0] } else { p[1] })),
                Layout::Colour(_, [r, g, b]) => grey.extend(pixels.map(|p| luma(p[r], p[g], p[b]))),
                Layout::Yuv422(offset) => grey.extend(pixels.map(|p| p[offset])),
            }
        }
        GrayImage::from_vec(self.width, self.height, grey).ok_or_else(|| "the image has no pixels".into())
    }
}

/// Rec. 709 luma in the integer arithmetic of the `image` crate, so raw and coded frames agree.
fn luma(r: u8, g: u8, b: u8) -> u8 {
    ((2126 * r as u32 + 7152 * g as u32 + 722 * b as u32) / 10000) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::ImageFormat;

    fn raw(encoding: &str, step: usize, data: Vec<u8>) -> RawPicture {
        RawPicture { width: 2, height: 1, step, encoding: encoding.into(), big_endian: false, data }
    }

    #[test]
    fn raw_layouts_become_grey() {
        let grey = |raw: RawPicture| raw.into_grey().map(|image| image.data().to_vec());
        assert_eq!(grey(raw("mono8", 4, vec![1, 2, 99, 99])).unwrap(), [1, 2]);
        assert_eq!(grey(raw("mono16", 4, vec![9, 1, 9, 2])).unwrap(), [1, 2]);
        let big = RawPicture { big_endian: true, ..raw("mono16", 4, vec![1, 9, 2, 9]) };
        assert_eq!(grey(big).unwrap(), [1, 2]);
        assert_eq!(grey(raw("yuv422", 4, vec![128, 7, 128, 8])).unwrap(), [7, 8]);
        assert_eq!(grey(raw("yuv422_yuy2", 4, vec![7, 128, 8, 128])).unwrap(), [7, 8]);
        assert_eq!(grey(raw("nv12", 4, vec![1, 2, 9, 9, 128, 128, 9, 9])).unwrap(), [1, 2]);
        assert!(grey(raw("nv12", 2, vec![1, 2])).is_err());
        let red = luma(255, 0, 0);
        assert_eq!(grey(raw("rgb8", 6, vec![255, 0, 0, 0, 0, 0])).unwrap(), [red, 0]);
        assert_eq!(grey(raw("bgra8", 8, vec![0, 0, 255, 255, 0, 0, 0, 255])).unwrap(), [red, 0]);
    }

    #[test]
    fn raw_data_that_does_not_fit_is_refused() {
        assert!(raw("mono8", 2, vec![1]).into_grey().is_err());
        assert!(raw("mono8", 1, vec![1, 2]).into_grey().is_err());
        assert!(raw("bayer_rggb8", 2, vec![1, 2]).into_grey().unwrap_err().contains("bayer_rggb8"));
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
    fn sixteen_bits_keep_the_high_byte() {
        let deep = ImageBuffer::from_fn(1, 1, |_, _| image::Luma([0x7fffu16]));
        assert_eq!(to_grey(deep.into()).unwrap().data(), [0x7f]);
    }
}
