//! Pixels as cameras and messages have them.

use super::{Grey, bayer, eight};
use geometry::Image;
use geometry::limits::check_image_size;

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

/// Where a pixel's samples lie.
#[derive(Clone, Copy)]
pub(super) enum Layout {
    Mono8,
    Mono16,
    /// `(samples per pixel, offset of red, of green, of blue)`
    Colour(usize, [usize; 3]),
    /// The same of samples of 16 bits.
    Colour16(usize, [usize; 3]),
    /// A colour a pixel, in squares of 2×2; which pattern does not matter to grey.
    Bayer8,
    Bayer16,
    /// Luma alternates with chroma; the offset of the first luma.
    Yuv422(usize),
    /// All luma, then chroma in half as many rows.
    Nv12,
}

impl Layout {
    pub(super) fn of(encoding: &str) -> Result<Self, String> {
        Ok(match encoding {
            "mono8" | "8UC1" => Self::Mono8,
            "mono16" | "16UC1" => Self::Mono16,
            "rgb8" => Self::Colour(3, [0, 1, 2]),
            "bgr8" | "8UC3" => Self::Colour(3, [2, 1, 0]),
            "rgba8" => Self::Colour(4, [0, 1, 2]),
            "bgra8" | "8UC4" => Self::Colour(4, [2, 1, 0]),
            "rgb16" => Self::Colour16(3, [0, 1, 2]),
            "bgr16" | "16UC3" => Self::Colour16(3, [2, 1, 0]),
            "rgba16" => Self::Colour16(4, [0, 1, 2]),
            "bgra16" | "16UC4" => Self::Colour16(4, [2, 1, 0]),
            "bayer_rggb8" | "bayer_bggr8" | "bayer_gbrg8" | "bayer_grbg8" => Self::Bayer8,
            "bayer_rggb16" | "bayer_bggr16" | "bayer_gbrg16" | "bayer_grbg16" => Self::Bayer16,
            "yuv422" | "uyvy" | "UYVY" => Self::Yuv422(1),
            "yuv422_yuy2" | "yuyv" | "YUYV" => Self::Yuv422(0),
            "nv12" | "NV12" | "nv21" | "NV21" => Self::Nv12,
            other => {
                return Err(format!(
                    "pixel encoding '{other}' is not supported (mono8, mono16, rgb8, bgr8, rgba8, bgra8, rgb16, bgr16, rgba16, \
                     bgra16, the four of bayer in 8 and 16 bits, yuv422, yuv422_yuy2, nv12 and nv21 are)"
                ));
            }
        })
    }

    fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Mono8 | Self::Bayer8 | Self::Nv12 => 1,
            Self::Mono16 | Self::Bayer16 | Self::Yuv422(_) => 2,
            Self::Colour(samples, _) => samples,
            Self::Colour16(samples, _) => 2 * samples,
        }
    }
}

impl RawPicture {
    /// Whether samples have 16 bits.
    pub(super) fn is_deep(&self) -> bool {
        matches!(Layout::of(&self.encoding), Ok(Layout::Mono16 | Layout::Colour16(..) | Layout::Bayer16))
    }

    /// Whether it has colours of eight bits.
    pub(super) fn is_colored(&self) -> bool {
        let layout = Layout::of(&self.encoding);
        matches!(layout, Ok(Layout::Colour(..) | Layout::Yuv422(_) | Layout::Nv12 | Layout::Bayer8))
    }

    /// The colours behind the luma, in rows of [`row_step`](Self::row_step) bytes; `None` where the bytes do not suffice.
    pub(super) fn chroma_rows(&self) -> Option<&[u8]> {
        // That they suffice is checked with the rows of the luma.
        self.rows(1).ok().map(drop)?;
        self.data.get(self.row_step() * self.height..)
    }

    /// Bytes from one row of the luma to the next, and from one of the colours.
    pub(super) fn row_step(&self) -> usize {
        if self.step == 0 { self.width } else { self.step }
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
        matches!(Layout::of(&self.encoding), Ok(Layout::Nv12))
    }

    pub(super) fn levels(&self) -> Result<Grey, String> {
        let layout = Layout::of(&self.encoding)?;
        let bytes_per_pixel = layout.bytes_per_pixel();
        let mut grey = Vec::with_capacity(self.data.len() / bytes_per_pixel);
        for row in self.rows(bytes_per_pixel)? {
            let pixels = row.chunks_exact(bytes_per_pixel);
            match layout {
                Layout::Mono8 | Layout::Bayer8 | Layout::Nv12 => grey.extend_from_slice(row),
                Layout::Colour(_, [r, g, b]) => grey.extend(pixels.map(|p| luma(p[r], p[g], p[b]) as u8)),
                Layout::Yuv422(offset) => grey.extend(pixels.map(|p| p[offset])),
                Layout::Mono16 | Layout::Colour16(..) | Layout::Bayer16 => return self.deep(layout),
            }
        }
        if matches!(layout, Layout::Bayer8) {
            grey = bayer::grey(&grey, self.width);
        }
        eight(self.width, self.height, grey)
    }

    /// The levels of samples of 16 bits.
    fn deep(&self, layout: Layout) -> Result<Grey, String> {
        let mut grey = Vec::with_capacity(self.width * self.height);
        let read: fn([u8; 2]) -> u16 = if self.big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
        let sample = |pixel: &[u8], place: usize| read([pixel[2 * place], pixel[2 * place + 1]]);
        for row in self.rows(layout.bytes_per_pixel())? {
            let pixels = row.chunks_exact(layout.bytes_per_pixel());
            match layout {
                Layout::Colour16(_, [r, g, b]) => {
                    grey.extend(pixels.map(|p| luma(sample(p, r), sample(p, g), sample(p, b)) as u16));
                }
                _ => grey.extend(pixels.map(|p| sample(p, 0))),
            }
        }
        if matches!(layout, Layout::Bayer16) {
            grey = bayer::grey(&grey, self.width);
        }
        let image = Image::from_vec(self.width, self.height, grey);
        image.map(Grey::Sixteen).ok_or_else(|| "the image has no pixels".into())
    }
}

/// Rec. 709 luma in the integer arithmetic of the `image` crate, so raw and coded frames agree.
pub(super) fn luma<T: Into<u32>>(r: T, g: T, b: T) -> u32 {
    (2126 * r.into() + 7152 * g.into() + 722 * b.into()) / 10000
}
