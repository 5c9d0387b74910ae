//! The lens by an image's metadata (Exif 2.32).

use super::{Picture, read_file};
use exif::{Exif, In, Reader, Tag, Value};
use std::io::Cursor;

/// Diagonal of a frame of 35 mm film, 36 × 24 mm, by which equivalent focal lengths are stated (CIPA DCG-001).
const FILM_DIAGONAL_MM: f64 = 43.266_615_305_567_87;

/// A focal length by metadata. It is a guess: lenses are rounded to millimetres, and videos are a crop of the
/// sensor's image.
#[derive(Clone, Debug, PartialEq)]
pub struct StatedFocal {
    /// Pixels, for an image of the requested size.
    pub pixels: f64,
    /// By which entry, for people.
    pub origin: String,
}

impl StatedFocal {
    /// The focal length from its equivalent on 35 mm film, for images of this width and height; `whose` names the
    /// metadata.
    pub fn of_film(mm: f64, (width, height): (usize, usize), whose: &str) -> Self {
        let pixels = mm / FILM_DIAGONAL_MM * (width as f64).hypot(height as f64);
        Self { pixels, origin: format!("{mm:.0} mm on 35 mm film, by the {whose}") }
    }
}

impl Picture {
    /// The focal length in the metadata of a JPEG, PNG or TIFF, for an image of this width and height; `None` if they
    /// have none, or an impossible one.
    pub fn stated_focal(&self, size: (usize, usize)) -> Option<StatedFocal> {
        match self {
            Picture::File(path) => read_file(path, |bytes| Ok(stated_focal(&bytes, size))).ok()?,
            Picture::Encoded(bytes) => stated_focal(bytes, size),
            Picture::Ranged(picture, _) => picture.stated_focal(size),
            Picture::Raw(_) | Picture::Broken(_) | Picture::Mistimed(_) | Picture::OfOther(_) => None,
        }
    }
}

fn stated_focal(bytes: &[u8], size: (usize, usize)) -> Option<StatedFocal> {
    let exif = Reader::new().read_from_container(&mut Cursor::new(bytes)).ok()?;
    by_film(&exif, size).or_else(|| by_sensor(&exif, size))
}

/// From the length that has the same view on 35 mm film.
fn by_film(exif: &Exif, size: (usize, usize)) -> Option<StatedFocal> {
    Some(StatedFocal::of_film(number(exif, Tag::FocalLengthIn35mmFilm)?, size, "images' Exif"))
}

/// From the length itself and the sensor's pixels per unit of length, which are those of the image as it was taken.
fn by_sensor(exif: &Exif, (width, height): (usize, usize)) -> Option<StatedFocal> {
    let mm = number(exif, Tag::FocalLength)?;
    let unit_mm = match number(exif, Tag::FocalPlaneResolutionUnit).unwrap_or(2.0) as u32 {
        3 => 10.0,
        4 => 1.0,
        5 => 0.001,
        _ => 25.4,
    };
    let per_mm = number(exif, Tag::FocalPlaneXResolution)? / unit_mm;
    let side = |tag| number(exif, tag).unwrap_or(0.0);
    let taken = side(Tag::PixelXDimension).max(side(Tag::PixelYDimension));
    let scale = if taken > 0.0 { width.max(height) as f64 / taken } else { 1.0 };
    let origin = format!("{mm} mm on a sensor of {per_mm:.0} pixels a mm, by the images' Exif");
    Some(StatedFocal { pixels: mm * per_mm * scale, origin })
}

/// A positive number; zero means that it is not known.
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = &exif.get_field(tag, In::PRIMARY)?.value;
    let number = match value {
        Value::Rational(values) => values.first()?.to_f64(),
        _ => f64::from(value.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exif::experimental::Writer;
    use exif::{Field, Rational};

    /// A JPEG, as far as metadata go.
    fn jpeg(fields: &[(Tag, Value)]) -> Picture {
        let fields: Vec<Field> = fields
            .iter()
            .map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() })
            .collect();
        let (mut writer, mut block) = (Writer::new(), Cursor::new(Vec::new()));
        fields.iter().for_each(|field| writer.push_field(field));
        writer.write(&mut block, false).expect("a TIFF block");
        let block = [b"Exif\0\0".as_slice(), &block.into_inner()].concat();
        let length = (block.len() as u16 + 2).to_be_bytes();
        Picture::Encoded([&[0xff, 0xd8, 0xff, 0xe1], &length[..], &block, &[0xff, 0xd9]].concat())
    }

    fn rational(num: u32, denom: u32) -> Value {
        Value::Rational(vec![Rational { num, denom }])
    }

    #[test]
    fn an_equivalent_length_is_that_of_the_diagonal() {
        let telephone = jpeg(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![26]))]);
        let found = telephone.stated_focal((4000, 3000)).expect("it is stated");
        assert!((found.pixels - 26.0 / 43.2666 * 5000.0).abs() < 0.1, "{found:?}");
        assert!(found.origin.contains("26 mm"), "{}", found.origin);
    }

    #[test]
    fn a_sensor_has_so_many_pixels_a_unit() {
        // 35 mm before 5472 pixels on 22.3 mm, stated per inch; the image was made smaller since.
        let fields = [
            (Tag::FocalLength, rational(35, 1)),
            (Tag::FocalPlaneXResolution, rational(5472 * 254, 223)),
            (Tag::FocalPlaneResolutionUnit, Value::Short(vec![2])),
            (Tag::PixelXDimension, Value::Long(vec![5472])),
            (Tag::PixelYDimension, Value::Long(vec![3648])),
        ];
        let found = jpeg(&fields).stated_focal((1368, 912)).expect("it is stated");
        assert!((found.pixels - 35.0 / 22.3 * 1368.0).abs() < 1.0, "{found:?}");
    }

    #[test]
    fn what_says_nothing_is_no_length() {
        let nothing = [
            jpeg(&[(Tag::FocalLengthIn35mmFilm, Value::Short(vec![0]))]),
            jpeg(&[(Tag::FocalLength, rational(50, 0)), (Tag::FocalPlaneXResolution, rational(100, 1))]),
            jpeg(&[(Tag::FocalLength, rational(50, 1))]),
            Picture::Encoded(b"no image".to_vec()),
            Picture::Broken("nothing".into()),
            Picture::File("/nothing/here.jpg".into()),
        ];
        assert!(nothing.iter().all(|picture| picture.stated_focal((640, 480)).is_none()));
    }
}
