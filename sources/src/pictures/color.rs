//! The colours of pictures, which are decoded of few of them: those that become keyframes.

use super::color_planes::{ColorPlanes, two_planes};
use super::{RawPicture, bayer, decode_any, jpeg, raw};
use geometry::Image;
use map::Luma;

/// A picture in colour whose grey levels were decoded.
#[derive(Clone, Debug)]
pub struct ColorPicture(Held);

#[derive(Clone, Debug)]
enum Held {
    Encoded(Vec<u8>),
    Raw(RawPicture),
}

impl ColorPicture {
    /// The bytes of an image file in colour.
    pub(super) fn encoded(bytes: Vec<u8>) -> Self {
        Self(Held::Encoded(bytes))
    }

    /// Pixels, where they are in a layout with colours of eight bits.
    pub(super) fn raw(raw: RawPicture) -> Option<Self> {
        raw.is_colored().then_some(Self(Held::Raw(raw)))
    }

    /// Its colours; `None` where they cannot be decoded, and where all pixels turn out to be grey.
    pub fn planes(&self) -> Option<ColorPlanes> {
        let (luma, planes) = match &self.0 {
            Held::Encoded(bytes) => of_file(bytes)?,
            Held::Raw(raw) => raw.color_planes()?,
        };
        planes
            .iter()
            .any(|plane| plane.data().iter().any(|value| value.abs_diff(128) > 1))
            .then_some((luma, planes))
    }
}

fn of_file(bytes: &[u8]) -> Option<ColorPlanes> {
    if jpeg::is_jpeg(bytes)
        && let Some(planes) = jpeg::decode_differences(bytes)
    {
        return Some((Luma::Rec601, planes));
    }
    let image = decode_any(bytes, "").ok()?.into_rgb8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let pixels = image.pixels().map(|pixel| Luma::Rec709.differences(pixel.0));
    Some((Luma::Rec709, two_planes(width, height, pixels)?))
}

impl RawPicture {
    /// Its colours.
    fn color_planes(&self) -> Option<ColorPlanes> {
        let (width, height) = (self.width, self.height);
        match raw::Layout::of(&self.encoding).ok()? {
            raw::Layout::Colour(samples, [r, g, b]) => {
                let rows = self.rows(samples).ok()?;
                let pixels = rows.flat_map(|row| row.chunks_exact(samples));
                let pixels = pixels.map(|p| Luma::Rec709.differences([p[r], p[g], p[b]]));
                Some((Luma::Rec709, two_planes(width, height, pixels)?))
            }
            raw::Layout::Yuv422(first_luma) => {
                // Two pixels share four bytes: those between their luma are of blue, then of red.
                let chroma = 1 - first_luma;
                let shared = |row: &[u8], x: usize| {
                    let pair = 4 * (x / 2);
                    // The last of an odd number of pixels has but its own.
                    let red = row.get(pair + 2 + chroma).copied().unwrap_or(128);
                    [row[pair + chroma], red]
                };
                let rows = self.rows(2).ok()?;
                let pixels = rows.flat_map(|row| (0..width).map(move |x| shared(row, x)));
                Some((Luma::Rec601, two_planes(width, height, pixels)?))
            }
            raw::Layout::Nv12 => {
                let is_swapped = self.encoding.eq_ignore_ascii_case("nv21");
                let chroma = self.chroma_rows()?;
                let pair = |x: usize, y: usize| {
                    let row = &chroma[(y / 2) * self.row_step()..];
                    let at = 2 * (x / 2);
                    let [first, second] =
                        [row.get(at), row.get(at + 1)].map(|value| value.copied().unwrap_or(128));
                    if is_swapped { [second, first] } else { [first, second] }
                };
                let pixels = (0..height).flat_map(|y| (0..width).map(move |x| pair(x, y)));
                Some((Luma::Rec601, two_planes(width, height, pixels)?))
            }
            raw::Layout::Bayer8 => {
                let order = self.encoding.strip_prefix("bayer_")?.strip_suffix('8')?;
                let mosaic: Vec<u8> = self.rows(1).ok()?.flatten().copied().collect();
                let mosaic = Image::from_vec(width, height, mosaic)?;
                let pixels = bayer::colors(&mosaic, order)?.map(|color| Luma::Mosaic.differences(color));
                Some((Luma::Mosaic, two_planes(width, height, pixels)?))
            }
            raw::Layout::Mono8 | raw::Layout::Mono16 | raw::Layout::Colour16(..) | raw::Layout::Bayer16 => {
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pictures::Picture;
    use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
    use std::io::Cursor;

    const SIZE: (usize, usize) = (48, 32);

    /// A scene of two colours and a ramp, whose edges lie between squares of 2×2 pixels.
    fn scene(x: usize, y: usize) -> [u8; 3] {
        let ramp = (2 * (x / 2) + 3 * (y / 2)) as u8;
        if x < 24 { [200 - ramp, 60 + ramp, 70] } else { [50, 80 + ramp, 190 - ramp] }
    }

    /// Red, green and blue by the grey levels and the colours of a picture; `None` of one without colours.
    fn found(picture: Picture) -> Option<Vec<[u8; 3]>> {
        let (grey, color) = picture.into_grey_and_color().unwrap();
        let (luma, planes) = color?.planes()?;
        let size = (grey.width(), grey.height());
        let colors = map::Color::of_planes(luma, [&planes[0], &planes[1]])?.decoded(size).unwrap();
        let all = (0..size.0 * size.1).map(|i| colors.at(i % size.0, i / size.0, grey.data()[i]));
        Some(all.collect())
    }

    fn assert_scene(picture: Picture, what: &str, off: u8) {
        let found = found(picture).unwrap_or_else(|| panic!("{what}: no colours"));
        for (i, pixel) in found.iter().enumerate() {
            let (x, y) = (i % SIZE.0, i / SIZE.0);
            // Colours at half the resolution are smooth across an edge.
            if (22..=25).contains(&x) {
                continue;
            }
            let most = pixel.iter().zip(scene(x, y)).map(|(a, b)| a.abs_diff(b)).max().unwrap();
            assert!(most <= off, "{what} at {x} {y}: {pixel:?} for {:?}", scene(x, y));
        }
    }

    fn raw(encoding: &str, step: usize, data: Vec<u8>) -> Picture {
        let (width, height) = SIZE;
        Picture::Raw(RawPicture { width, height, step, encoding: encoding.into(), big_endian: false, data })
    }

    fn pixels() -> impl Iterator<Item = (usize, usize)> {
        (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)))
    }

    fn luma_of([r, g, b]: [u8; 3]) -> u8 {
        (0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b)).round() as u8
    }

    #[test]
    fn files_keep_their_colours() {
        let image =
            RgbImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, y| Rgb(scene(x as usize, y as usize)));
        let encoded = |image: &DynamicImage, format| {
            let mut bytes = Vec::new();
            image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
            bytes
        };
        let folder = tempfile::tempdir().unwrap();
        for format in
            [ImageFormat::Png, ImageFormat::Tiff, ImageFormat::Bmp, ImageFormat::Pnm, ImageFormat::Jpeg]
        {
            let bytes = encoded(&image.clone().into(), format);
            let off = if format == ImageFormat::Jpeg { 22 } else { 10 };
            assert_scene(Picture::Encoded(bytes.clone()), &format!("{format:?}"), off);
            let file = folder.path().join("image");
            std::fs::write(&file, bytes).unwrap();
            assert_scene(Picture::File(file), &format!("a file of {format:?}"), off);
            let grey = DynamicImage::from(image.clone()).into_luma8();
            assert_eq!(
                found(Picture::Encoded(encoded(&grey.clone().into(), format))),
                None,
                "grey {format:?}"
            );
            // Nor has a grey picture that is coded as one in colour.
            let as_color = DynamicImage::from(grey).into_rgb8();
            assert_eq!(found(Picture::Encoded(encoded(&as_color.into(), format))), None, "{format:?}");
        }
    }

    #[test]
    fn raw_layouts_keep_their_colours() {
        let samples = |order: &'static [usize]| -> Vec<u8> {
            pixels()
                .flat_map(|(x, y)| order.iter().map(move |i| scene(x, y).get(*i).copied().unwrap_or(255)))
                .collect()
        };
        for (encoding, order) in [
            ("rgb8", &[0, 1, 2][..]),
            ("bgr8", &[2, 1, 0]),
            ("rgba8", &[0, 1, 2, 3]),
            ("bgra8", &[2, 1, 0, 3]),
        ] {
            assert_scene(raw(encoding, order.len() * SIZE.0, samples(order)), encoding, 8);
        }
        let chroma = |x: usize, y: usize| Luma::Rec601.differences(scene(x, y));
        let pair = |x: usize, y: usize, first_luma: usize| {
            let (luma, chroma) = (luma_of(scene(x, y)), chroma(x, y)[x % 2]);
            if first_luma == 0 { [luma, chroma] } else { [chroma, luma] }
        };
        for (encoding, first_luma) in [("yuyv", 0), ("yuv422_yuy2", 0), ("uyvy", 1), ("yuv422", 1)] {
            let data = pixels().flat_map(|(x, y)| pair(x, y, first_luma)).collect();
            assert_scene(raw(encoding, 2 * SIZE.0, data), encoding, 8);
        }
        for (encoding, order) in [("nv12", [0, 1]), ("nv21", [1, 0])] {
            let luma = pixels().map(|(x, y)| luma_of(scene(x, y)));
            let halved = pixels().filter(|(x, y)| x % 2 == 0 && y % 2 == 0);
            let chroma = halved.flat_map(|(x, y)| order.map(|i| chroma(x, y)[i]));
            assert_scene(raw(encoding, SIZE.0, luma.chain(chroma).collect()), encoding, 8);
        }
        assert_eq!(found(raw("mono8", SIZE.0, vec![9; SIZE.0 * SIZE.1])), None);
    }

    #[test]
    fn mosaics_keep_their_colours() {
        for order in ["rggb", "bggr", "gbrg", "grbg"] {
            let letter = |x: usize, y: usize| order.as_bytes()[y % 2 * 2 + x % 2];
            let sample = |(x, y): (usize, usize)| {
                let channel = b"rgb".iter().position(|known| *known == letter(x, y)).unwrap();
                scene(x, y)[channel]
            };
            // Grey levels of a mosaic are means over neighbours.
            assert_scene(raw(&format!("bayer_{order}8"), SIZE.0, pixels().map(sample).collect()), order, 12);
        }
    }
}
