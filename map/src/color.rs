//! The colours of a keyframe's image: what is missing of it in grey, in a few kilobytes.
//!
//! A keyframe keeps its grey image without loss, because tracking and merging use it. Colours are for people and other
//! tools, so two planes of colour differences at half the image's resolution suffice, as in most videos (4:2:0). Both
//! are one grey JPEG file, the blue differences above the red ones. Files and copies of a map keep that file as it is.
//!
//! Measured on 23 images of two colour videos at 640×480: 7 and 17 kB an image, beside 132 and 245 kB of its grey PNG.
//! The same planes as PNG take 31 and 72 kB, the whole image as a colour JPEG 20 and 60 kB.

use geometry::{GrayImage, halved};
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder};
use std::io::Cursor;
use std::sync::Arc;

/// Quality of the JPEG, of 100.
const QUALITY: u8 = 90;
/// What a difference of nothing is stored as.
const NONE: f32 = 128.0;

/// What the grey levels of an image are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Luma {
    /// The luma of ITU-R BT.601, which JPEG files and most cameras' YUV layouts hold.
    Rec601,
    /// The luma of ITU-R BT.709, into which red, green and blue are converted.
    Rec709,
    /// Red, green and blue as 1 : 2 : 1, into which Bayer mosaics are converted.
    Mosaic,
}

impl Luma {
    /// All of them, by their numbers in files.
    const ALL: [Self; 3] = [Self::Rec601, Self::Rec709, Self::Mosaic];

    /// The shares of red, green and blue in a grey level.
    pub fn weights(self) -> [f32; 3] {
        match self {
            Self::Rec601 => [0.299, 0.587, 0.114],
            Self::Rec709 => [0.2126, 0.7152, 0.0722],
            Self::Mosaic => [0.25, 0.5, 0.25],
        }
    }

    /// Its number in files.
    pub(crate) fn number(self) -> u32 {
        self as u32
    }

    /// The one that has a number.
    pub(crate) fn of_number(number: u32) -> Option<Self> {
        Self::ALL.get(usize::try_from(number).ok()?).copied()
    }

    /// The differences from their grey level of a pixel's blue and red, as they are stored: 0–255, 128 for none. Those of
    /// [`Rec601`](Self::Rec601) are the Cb and Cr of JFIF.
    #[inline]
    pub fn differences(self, [red, green, blue]: [u8; 3]) -> [u8; 2] {
        let [of_red, of_green, of_blue] = self.weights();
        let [red, green, blue] = [red, green, blue].map(f32::from);
        let grey = of_red * red + of_green * green + of_blue * blue;
        let stored = |level: f32, weight: f32| NONE + (level - grey) / (2.0 * (1.0 - weight));
        [stored(blue, of_blue), stored(red, of_red)].map(rounded)
    }

    /// Red, green and blue of a pixel with this grey level and these stored differences.
    #[inline]
    fn color(self, grey: f32, [blue, red]: [f32; 2]) -> [u8; 3] {
        let [of_red, of_green, of_blue] = self.weights();
        let blue = 2.0 * (1.0 - of_blue) * (blue - NONE);
        let red = 2.0 * (1.0 - of_red) * (red - NONE);
        let green = -(of_red * red + of_blue * blue) / of_green;
        [red, green, blue].map(|off| rounded(grey + off))
    }
}

/// The nearest level; a cast keeps to 0–255, and without a call for each of millions of pixels.
#[inline]
fn rounded(value: f32) -> u8 {
    (value + 0.5) as u8
}

/// The colours of a keyframe as they are kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Color {
    /// What the grey levels of the image are made of.
    pub luma: Luma,
    /// A grey JPEG file of half the image's width (without an odd last column) and of twice half its height: the
    /// differences of blue, and below them those of red.
    pub jpeg: Arc<[u8]>,
}

impl Color {
    /// The colours of an image by its differences of blue and of red (see [`Luma::differences`]), each a plane of the
    /// image's size. `None` of an image that is smaller than two pixels, or larger than a JPEG file can be.
    pub fn of_planes(luma: Luma, [blue, red]: [&GrayImage; 2]) -> Option<Self> {
        let [blue, red] = [blue, red].map(halved);
        let (width, height) = (u32::try_from(blue.width()).ok()?, u32::try_from(2 * blue.height()).ok()?);
        let both = [blue.data(), red.data()].concat();
        let mut jpeg = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, QUALITY);
        encoder.encode(&both, width, height, ExtendedColorType::L8).ok()?;
        Some(Self { luma, jpeg: jpeg.into() })
    }

    /// The colours of an image of this width and height, ready to be looked up.
    ///
    /// # Errors
    /// Says what is wrong with the file.
    pub fn decoded(&self, (width, height): (usize, usize)) -> Result<Colors, String> {
        let wrong = |what: String| format!("the colours cannot be used: {what}");
        let decoder = JpegDecoder::new(Cursor::new(&*self.jpeg)).map_err(|error| wrong(error.to_string()))?;
        // The size is checked first, so that no other size's memory is ever asked for.
        let found = decoder.dimensions();
        let (half, rows) = (width / 2, height / 2);
        if (found.0 as usize, found.1 as usize) != (half, 2 * rows) || half == 0 || rows == 0 {
            return Err(wrong(format!(
                "they are {}×{}, those of an image of {width}×{height} pixels are {half}×{}",
                found.0,
                found.1,
                2 * rows
            )));
        }
        if decoder.color_type() != ColorType::L8 {
            return Err(wrong("their JPEG is not grey".into()));
        }
        let mut both = vec![0; 2 * half * rows];
        decoder.read_image(&mut both).map_err(|error| wrong(error.to_string()))?;
        Ok(Colors { luma: self.luma, half, rows, both })
    }
}

/// The colours of an image, decoded.
#[derive(Clone, Debug)]
pub struct Colors {
    luma: Luma,
    /// Columns and rows of a plane.
    half: usize,
    rows: usize,
    /// The planes of blue and of red, one behind the other.
    both: Vec<u8>,
}

impl Colors {
    /// Red, green and blue of the pixel in column `x` and row `y`, which has this grey level.
    pub fn at(&self, x: usize, y: usize, grey: u8) -> [u8; 3] {
        self.luma.color(grey.into(), self.differences(x, y))
    }

    /// The stored differences at a pixel, interpolated between those around it.
    fn differences(&self, x: usize, y: usize) -> [f32; 2] {
        let ([left, right], across) = neighbours(x, self.half);
        let ([above, below], down) = neighbours(y, self.rows);
        [0, 1].map(|plane| {
            let at = |column: usize, row: usize| {
                f32::from(self.both[(plane * self.rows + row) * self.half + column])
            };
            let upper = at(left, above) + across * (at(right, above) - at(left, above));
            let lower = at(left, below) + across * (at(right, below) - at(left, below));
            upper + down * (lower - upper)
        })
    }

    /// The stored differences of blue and of red at all pixels of an image of this size.
    pub fn planes(&self, width: usize, height: usize) -> [GrayImage; 2] {
        let columns: Vec<([usize; 2], f32)> = (0..width).map(|x| neighbours(x, self.half)).collect();
        [0, 1].map(|plane| {
            let mut data = Vec::with_capacity(width * height);
            for y in 0..height {
                let ([above, below], down) = neighbours(y, self.rows);
                let row = |row: usize| &self.both[(plane * self.rows + row) * self.half..][..self.half];
                let (above, below) = (row(above), row(below));
                let between = |column: usize| {
                    let (upper, lower) = (f32::from(above[column]), f32::from(below[column]));
                    upper + down * (lower - upper)
                };
                data.extend(columns.iter().map(|&([left, right], across)| {
                    let (left, right) = (between(left), between(right));
                    rounded(left + across * (right - left))
                }));
            }
            GrayImage::from_vec(width, height, data).expect("a value a pixel")
        })
    }

    /// The pixels of a grey image in colour, red, green and blue in turn; `planes` has the stored differences at all of
    /// them.
    pub fn painted(&self, grey: &GrayImage, planes: &[GrayImage; 2]) -> Vec<u8> {
        let [blue, red] = planes;
        let mut pixels = Vec::with_capacity(3 * grey.data().len());
        for ((&grey, &blue), &red) in grey.data().iter().zip(blue.data()).zip(red.data()) {
            pixels.extend(self.luma.color(grey.into(), [blue, red].map(f32::from)));
        }
        pixels
    }
}

/// The two of `count` halved pixels between which a pixel of the image lies, and how far from the first to the second.
fn neighbours(pixel: usize, count: usize) -> ([usize; 2], f32) {
    // The middle of pixel i of the halved image is that between pixels 2i and 2i + 1.
    let before = pixel.div_ceil(2);
    let at = if pixel.is_multiple_of(2) { 0.75 } else { 0.25 };
    let (first, second) = (before.saturating_sub(1), before);
    if before == 0 { ([0, 0], 0.0) } else { ([first.min(count - 1), second.min(count - 1)], at) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, color: impl Fn(usize, usize) -> [u8; 3]) -> Vec<[u8; 3]> {
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| color(x, y)).collect()
    }

    fn grey(luma: Luma, color: [u8; 3]) -> u8 {
        let weights = luma.weights().into_iter();
        weights.zip(color).map(|(weight, level)| weight * f32::from(level)).sum::<f32>().round() as u8
    }

    fn color_of(luma: Luma, width: usize, height: usize, pixels: &[[u8; 3]]) -> Color {
        let planes = [0, 1].map(|plane| {
            let data = pixels.iter().map(|pixel| luma.differences(*pixel)[plane]).collect();
            GrayImage::from_vec(width, height, data).unwrap()
        });
        Color::of_planes(luma, [&planes[0], &planes[1]]).expect("an image in colour")
    }

    #[test]
    fn a_pixel_is_its_grey_level_and_two_differences() {
        for luma in Luma::ALL {
            assert_eq!(Luma::of_number(luma.number()), Some(luma));
            for color in [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255; 3], [0; 3], [90, 140, 30], [7, 8, 250]]
            {
                let stored = luma.differences(color).map(f32::from);
                let found = luma.color(grey(luma, color).into(), stored);
                for (found, expected) in found.iter().zip(color) {
                    assert!(found.abs_diff(expected) <= 3, "{luma:?} {found} {color:?}");
                }
            }
            assert_eq!(luma.differences([77; 3]), [128, 128]);
        }
        assert_eq!(Luma::of_number(3), None);
    }

    #[test]
    fn an_image_comes_back_within_the_error_of_its_compression() {
        for (width, height) in [(64, 48), (61, 47), (2, 2), (3, 2)] {
            for luma in Luma::ALL {
                let smooth =
                    |x: usize, y: usize| [(40 + 3 * x) as u8, (200 - 3 * y) as u8, (90 + x + y) as u8];
                let pixels = image(width, height, smooth);
                let colors = color_of(luma, width, height, &pixels).decoded((width, height)).unwrap();
                let greys: Vec<u8> = pixels.iter().map(|pixel| grey(luma, *pixel)).collect();
                let planes = colors.planes(width, height);
                let painted =
                    colors.painted(&GrayImage::from_vec(width, height, greys.clone()).unwrap(), &planes);
                for (i, expected) in pixels.iter().enumerate() {
                    let found = colors.at(i % width, i / width, greys[i]);
                    let off = found.iter().zip(expected).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
                    assert!(off <= 12, "{width}×{height} {luma:?} at {i}: {found:?} for {expected:?}");
                    let off = painted[3 * i..3 * i + 3].iter().zip(found).map(|(a, b)| a.abs_diff(b)).max();
                    assert!(off.unwrap() <= 2);
                }
            }
        }
    }

    #[test]
    fn an_edge_between_colours_is_where_it_was() {
        let pixels = image(64, 48, |x, _| if x < 32 { [200, 40, 40] } else { [40, 40, 200] });
        let colors = color_of(Luma::Rec709, 64, 48, &pixels).decoded((64, 48)).unwrap();
        for (x, expected) in
            [(4, [200, 40, 40]), (28, [200, 40, 40]), (35, [40, 40, 200]), (60, [40, 40, 200])]
        {
            let found = colors.at(x, 20, grey(Luma::Rec709, expected));
            let off = found.iter().zip(expected).map(|(a, b)| a.abs_diff(b)).max().unwrap();
            assert!(off <= 25, "column {x}: {found:?}");
        }
    }

    #[test]
    fn colours_of_another_size_and_damaged_ones_are_refused() {
        let pixels = image(64, 48, |x, y| [x as u8, y as u8, 100]);
        let color = color_of(Luma::Rec601, 64, 48, &pixels);
        assert!(color.decoded((66, 48)).unwrap_err().contains("66×48"));
        assert!(color.decoded((0, 0)).is_err());
        let cut = Color { jpeg: color.jpeg[..40].into(), ..color.clone() };
        assert!(cut.decoded((64, 48)).is_err());
        assert!(Color { jpeg: Arc::from([]), ..color }.decoded((64, 48)).is_err());
        let point = GrayImage::filled(1, 1, 5);
        assert_eq!(Color::of_planes(Luma::Rec601, [&point, &point]), None);
    }
}
