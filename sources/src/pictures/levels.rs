//! The range of sample values of more than eight bits that becomes grey: one range for a recording, from its first
//! images.
//!
//! A range for every image would change the look of a place from image to image, which a direct method takes for
//! light. The high byte alone is black where sensors fill 10, 12 or 14 bits from below, and gives four grey levels
//! for a thermal camera.

use super::{Grey, Picture, jpeg, rows};
use geometry::{GrayImage, Image};
use image::{ColorType, ImageDecoder, ImageReader};
use std::io::Cursor;

/// The share of the pixels below the lowest level that counts, and above the highest: single hot and dead pixels do not.
const TAIL: f64 = 1e-3;
/// Depths of sensors, bits.
const DEPTHS: [u32; 4] = [10, 12, 14, 16];
/// Where the levels span this share of a depth, that depth is the range, since later images may be brighter: 64 of 256 grey levels are
/// left to these.
const ENOUGH: f64 = 0.25;
/// Else the range is so much wider than the levels of the first images, on either side, as a share of their span.
const MARGIN: f64 = 0.25;
/// About a second of images tell it, in which exposures settle, unless they are larger than this together, bytes;
const FIRST_IMAGES: usize = 30;
const MOST_BYTES: usize = 64 << 20;
/// each so many-th of them is looked at.
const LOOKED_AT: usize = 4;

/// A range of 16-bit samples that becomes grey levels 0–255.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GreyRange {
    /// The lowest sample, which becomes 0, as do those below it.
    pub from: u16,
    /// The highest, which becomes 255, as do those above it.
    pub to: u16,
    /// Rows at the top and at the bottom that hold numbers and no picture: they become copies of the picture's row beside them.
    pub numbers: [u16; 2],
}

impl GreyRange {
    /// All samples: their high byte.
    pub const WHOLE: Self = Self { from: 0, to: u16::MAX, numbers: [0; 2] };

    /// The range of a recording by how many samples of its first images have which level.
    fn of_counts(counts: &[u64]) -> Self {
        // Where a sensor has nothing, dead columns and the images before it runs, it says 0: that is no level of the scene.
        let nothing = counts.first().copied().unwrap_or(0);
        let total: u64 = counts.iter().sum::<u64>() - nothing;
        let tail = (total as f64 * TAIL) as u64;
        let (mut below, mut above) = (0, 0);
        let is_beyond = |sum: &mut u64, count: &u64| {
            *sum += count;
            *sum > tail
        };
        let low = counts.iter().skip(1).position(|count| is_beyond(&mut below, count)).map_or(0, |at| at + 1);
        let high = counts.iter().rposition(|count| is_beyond(&mut above, count)).unwrap_or(0);
        let most = (1usize << 16) - 1;
        let depth = DEPTHS.iter().map(|bits| (1usize << bits) - 1).find(|top| high <= *top).unwrap_or(most);
        let span = high.saturating_sub(low);
        if high == 0 {
            return Self::WHOLE;
        }
        // A band far above zero is a thermal camera's; dark images are not told from those of a sensor of fewer bits.
        if span as f64 >= ENOUGH * depth as f64 || span == 0 || low <= span {
            return Self { to: depth as u16, ..Self::WHOLE };
        }
        let margin = (MARGIN * span as f64).ceil() as usize;
        let (from, to) = (low.saturating_sub(margin) as u16, (high + margin).min(most) as u16);
        Self { from, to, ..Self::WHOLE }
    }

    /// The grey levels of an image.
    pub(super) fn apply(self, image: &Image<u16>) -> Result<GrayImage, String> {
        let (from, to) = (self.from.min(self.to), self.to.max(self.from));
        // Of a power of two of levels this is a shift.
        let scale = (256 << 16) / (u32::from(to - from) + 1);
        let level = |sample: &u16| ((u32::from((*sample).clamp(from, to) - from) * scale) >> 16) as u8;
        let mut levels: Vec<u8> = image.data().iter().map(level).collect();
        self.cover_numbers(&mut levels, image.width());
        GrayImage::from_vec(image.width(), image.height(), levels)
            .ok_or_else(|| "the image has no pixels".into())
    }

    /// Puts copies of the picture's first and last rows in the place of rows of numbers.
    fn cover_numbers(self, levels: &mut [u8], width: usize) {
        let [top, bottom] = self.numbers.map(|rows| usize::from(rows) * width);
        let (end, all) = (levels.len().saturating_sub(bottom), levels.len());
        if top + width > end {
            return;
        }
        (0..top).step_by(width.max(1)).for_each(|row| levels.copy_within(top..top + width, row));
        (end..all).step_by(width.max(1)).for_each(|row| levels.copy_within(end - width..end, row));
    }

    /// The range that a recording says, `from to`, and behind it the rows of numbers at top and bottom, where there are any.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let numbers: Vec<u16> = text.split(' ').map(str::parse).collect::<Result<_, _>>().ok()?;
        match numbers[..] {
            [from, to] => Some(Self { from, to, ..Self::WHOLE }),
            [from, to, top, bottom] => Some(Self { from, to, numbers: [top, bottom] }),
            _ => None,
        }
    }

    /// As a recording says it.
    pub(crate) fn written(self) -> String {
        match (self.from, self.to, self.numbers) {
            (from, to, [0, 0]) => format!("{from} {to}"),
            (from, to, [top, bottom]) => format!("{from} {to} {top} {bottom}"),
        }
    }

    /// For people.
    pub fn text(&self) -> String {
        let Self { from, to, numbers } = self;
        let rows = |[top, bottom]: [u16; 2]| match [top, bottom] {
            [0, 0] => String::new(),
            [0, rows] => format!("; the last {rows} rows hold numbers and are left out"),
            [rows, 0] => format!("; the first {rows} rows hold numbers and are left out"),
            [top, bottom] => {
                format!("; the first {top} and last {bottom} rows hold numbers and are left out")
            }
        };
        let rows = rows(*numbers);
        let depth = DEPTHS.iter().find(|bits| (1usize << **bits) - 1 == usize::from(*to));
        match depth.filter(|_| *from == 0) {
            Some(bits) => format!("16 bits a pixel, of which {bits} are used{rows}"),
            None => {
                format!(
                    "16 bits a pixel; {from} to {to} become grey levels 0 to 255, by the first images{rows}"
                )
            }
        }
    }
}

/// The range of a recording, from its first pictures.
#[derive(Clone, Debug, Default)]
pub struct Levels {
    range: Option<GreyRange>,
}

impl Levels {
    /// Whether a recording that begins with these pictures has more than eight bits, and needs more of them to find
    /// its range.
    pub fn needs_more<'a>(pictures: impl Iterator<Item = &'a Picture> + Clone) -> bool {
        let bytes: usize = pictures.clone().map(Picture::bytes).sum();
        let is_open = pictures.clone().count() < FIRST_IMAGES && bytes < MOST_BYTES;
        // Pictures that cannot be read tell nothing.
        is_open && pictures.clone().find_map(Picture::is_deep) != Some(false)
    }

    /// The levels of a recording that begins with these pictures.
    pub fn of<'a>(pictures: impl Iterator<Item = &'a Picture> + Clone) -> Self {
        if pictures.clone().find_map(Picture::is_deep) != Some(true) {
            return Self::default();
        }
        let deep = |picture: &Picture| match picture.clone().decoded().map(|decoded| decoded.grey) {
            Ok(Grey::Sixteen(image)) => Some(image),
            _ => None,
        };
        let mut bytes = 0;
        let mut is_room = |image: &Image<u16>| {
            let is_room = bytes < MOST_BYTES;
            bytes += 2 * image.data().len();
            is_room
        };
        let images = pictures.step_by(LOOKED_AT).filter_map(deep).take_while(|image| is_room(image));
        let images: Vec<Image<u16>> = images.collect();
        let (numbers, mut counts) = (rows::of_numbers(&images), vec![0u64; 1 << 16]);
        for image in &images {
            let [top, bottom] = numbers.map(|rows| usize::from(rows) * image.width());
            // One of another size may have fewer rows.
            let picture = image.data().get(top..image.data().len().saturating_sub(bottom));
            picture.into_iter().flatten().for_each(|sample| counts[usize::from(*sample)] += 1);
        }
        let is_empty = counts.iter().all(|count| *count == 0);
        Self { range: (!is_empty).then(|| GreyRange { numbers, ..GreyRange::of_counts(&counts) }) }
    }

    /// The range; `None` of images of eight bits.
    pub fn range(&self) -> Option<GreyRange> {
        self.range
    }

    /// A picture with the range, where it is to have one.
    pub fn of_picture(&self, picture: Picture) -> Picture {
        match (self.range, picture) {
            (Some(range), picture @ (Picture::File(_) | Picture::Encoded(_) | Picture::Raw(_))) => {
                Picture::Ranged(Box::new(picture), range)
            }
            (_, picture) => picture,
        }
    }
}

impl Picture {
    /// Whether its samples have more than eight bits; `None` where it has none, or a range already.
    fn is_deep(&self) -> Option<bool> {
        match self {
            // What is no file, a pipe say, can be read once only.
            Picture::File(path) if path.exists() && !path.is_file() => Some(false),
            Picture::File(path) => {
                let reader = ImageReader::open(path).ok()?.with_guessed_format().ok()?;
                Some(is_deep(reader.into_decoder().ok()?.color_type()))
            }
            Picture::Encoded(bytes) if jpeg::is_jpeg(bytes) => Some(false),
            Picture::Encoded(bytes) => {
                let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok()?;
                Some(is_deep(reader.into_decoder().ok()?.color_type()))
            }
            Picture::Raw(raw) => Some(raw.is_deep()),
            Picture::Ranged(..) => Some(false),
            Picture::Broken(_) | Picture::Mistimed(_) | Picture::OfOther(_) => None,
        }
    }

    /// Bytes that it holds in memory.
    pub(crate) fn bytes(&self) -> usize {
        match self {
            Picture::Encoded(bytes) => bytes.len(),
            Picture::Raw(raw) => raw.data.len(),
            Picture::Ranged(picture, _) => picture.bytes(),
            Picture::File(_) | Picture::Broken(_) | Picture::Mistimed(_) | Picture::OfOther(_) => 0,
        }
    }
}

fn is_deep(colour: ColorType) -> bool {
    matches!(colour, ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pictures::RawPicture;

    /// A picture whose samples go evenly from one to the other.
    fn ramp(from: u16, to: u16) -> Picture {
        let step = f64::from(to - from) / 4095.0;
        let samples = (0..4096).map(|i| from + (step * f64::from(i)).round() as u16);
        let data = samples.flat_map(u16::to_le_bytes).collect();
        let encoding = "mono16".into();
        Picture::Raw(RawPicture { width: 64, height: 64, step: 128, encoding, big_endian: false, data })
    }

    fn levels(picture: Picture) -> (u8, u8, usize) {
        let grey = picture.into_grey().unwrap();
        let mut all = grey.data().to_vec();
        all.sort_unstable();
        all.dedup();
        (all[0], all[all.len() - 1], all.len())
    }

    #[test]
    fn sensors_of_every_depth_have_many_levels() {
        for (from, to, range) in [
            (0, 65535, (0, 65535)),
            (3000, 60000, (0, 65535)),
            (64, 1000, (0, 1023)),
            (100, 4000, (0, 4095)),
            (16, 255, (0, 1023)),
            (200, 16000, (0, 16383)),
        ] {
            let picture = ramp(from, to);
            let found = Levels::of([&picture].into_iter());
            let (low, high) = range;
            assert_eq!(
                found.range(),
                Some(GreyRange { from: low, to: high, ..GreyRange::WHOLE }),
                "{from} to {to}"
            );
            assert!(levels(found.of_picture(picture)).2 >= 60, "{from} to {to}");
        }
    }

    #[test]
    fn thermal_images_have_the_range_of_their_levels() {
        // Hundredths of a kelvin, and what 14 bits of a microbolometer have indoors.
        for (from, to) in [(29_000, 31_000), (7_000, 7_400)] {
            let picture = ramp(from, to);
            let found = Levels::of([&picture].into_iter());
            let range = found.range().unwrap();
            assert!(
                range.from < from && range.to > to && range.to - range.from < 2 * (to - from),
                "{range:?}"
            );
            let (low, high, count) = levels(found.of_picture(picture));
            assert!(count > 150 && low > 30 && high < 225, "{low} {high} {count}");
            // What is hotter later is not cut off at once, and what is far off is.
            assert!(levels(found.of_picture(ramp(to, to + (to - from) / 5))).2 > 20);
            assert_eq!(levels(found.of_picture(ramp(60_000, 60_001))), (255, 255, 1));
        }
    }

    #[test]
    fn single_pixels_do_not_make_the_range() {
        let Picture::Raw(mut raw) = ramp(7_000, 7_400) else { panic!("raw") };
        raw.data[..4].copy_from_slice(&[0, 0, 0xff, 0xff]);
        let picture = Picture::Raw(raw);
        let range = Levels::of([&picture].into_iter()).range().unwrap();
        assert!(range.from > 6_800 && range.to < 7_600, "{range:?}");
    }

    #[test]
    fn where_a_sensor_has_nothing_is_no_level() {
        let Picture::Raw(mut black) = ramp(29_000, 30_500) else { panic!("raw") };
        let mut dead = black.clone();
        black.data.fill(0);
        // A fifth of the columns.
        dead.data.chunks_exact_mut(10).for_each(|five| five[..2].fill(0));
        let range = |first: RawPicture| {
            let (first, others) = (Picture::Raw(first), ramp(29_000, 30_500));
            Levels::of(std::iter::once(&first).chain(std::iter::repeat_n(&others, 8))).range().unwrap()
        };
        for range in [range(black), range(dead)] {
            assert!(range.from > 28_000 && range.to < 31_500, "{range:?}");
        }
    }

    #[test]
    fn rows_of_numbers_have_no_say_and_no_texture() {
        let scene = |seed: usize| {
            let sample = |i: usize| {
                let (x, y) = ((i % 80) as f64, (i / 80) as f64);
                (29_700.0 + 400.0 * (0.2 * x + seed as f64).sin() * (0.15 * y).cos()) as u16
            };
            let word =
                |i: usize| if i.is_multiple_of(3) { (i * 9973 * (seed + 1) % 65_536) as u16 } else { 0 };
            let all = (0..80 * 62).map(sample).chain((0..160).map(word));
            let (data, encoding) = (all.flat_map(u16::to_le_bytes).collect(), "mono16".into());
            Picture::Raw(RawPicture { width: 80, height: 64, step: 160, encoding, big_endian: false, data })
        };
        let pictures = [0, 1, 2, 3, 4].map(scene);
        let found = Levels::of(pictures.iter());
        let range = found.range().unwrap();
        assert_eq!(range.numbers, [0, 2]);
        assert!(range.from > 28_000 && range.to < 31_500, "{range:?}");
        assert!(range.text().contains("the last 2 rows hold numbers"), "{}", range.text());
        let grey = found.of_picture(scene(7)).into_grey().unwrap();
        let row = |y: usize| &grey.data()[80 * y..80 * (y + 1)];
        assert_eq!((row(62), row(63)), (row(61), row(61)));
        assert_eq!(GreyRange::parse(&range.written()), Some(range));
        // An image of another size among them.
        let encoding = "mono16".into();
        let small =
            RawPicture { width: 2, height: 1, step: 4, encoding, big_endian: false, data: vec![9; 4] };
        let with_small = Levels::of(
            [&pictures[0], &pictures[1], &pictures[2], &pictures[3], &Picture::Raw(small.clone())]
                .into_iter(),
        );
        assert_eq!(with_small.range().map(|range| range.numbers), Some([0, 2]));
        assert_eq!(with_small.of_picture(Picture::Raw(small)).into_grey().map(|image| image.height()), Ok(1));
        assert_eq!(GreyRange::parse("7 9"), Some(GreyRange { from: 7, to: 9, ..GreyRange::WHOLE }));
    }

    #[test]
    fn eight_bits_have_no_range_and_black_ones_all() {
        let eight = Picture::Raw(RawPicture {
            width: 2,
            height: 1,
            step: 2,
            encoding: "mono8".into(),
            big_endian: false,
            data: vec![1, 2],
        });
        assert!(!Levels::needs_more([&eight].into_iter()));
        assert_eq!(Levels::of([&eight].into_iter()).range(), None);
        let broken = Picture::Broken("torn".into());
        assert!(Levels::needs_more([&broken].into_iter()));
        assert_eq!(Levels::of([&broken].into_iter()).range(), None);
        let black = ramp(0, 0);
        assert_eq!(Levels::of([&black].into_iter()).range(), Some(GreyRange::WHOLE));
    }
}
