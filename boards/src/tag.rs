//! Tags: their corners and their bits.

use calib::planar::{homography, mapped};
use calib_targets_charuco::builtins;
use geometry::GrayImage;
use nalgebra::{Matrix3, Vector2};

/// Most wrong bits of a tag that its neighbours say is there, and most wrong bits and light cells of its border of one that
/// nothing else says; two tags differ by eleven bits at the least.
pub const MAX_WRONG_BITS: u32 = 3;
/// Bits in a row of a tag 36h11.
const SIDE: usize = 6;
/// Least difference of black and white, grey levels: as noise has none.
const MIN_CONTRAST: f32 = 15.0;

/// Four corners in the order of [`Board::points`](calib::Board::points), pixels.
pub type Tag = [Vector2<f64>; 4];

/// The shortest side of a tag, pixels.
pub fn side(tag: &Tag) -> f64 {
    (0..4).map(|k| (tag[k] - tag[(k + 1) % 4]).norm()).fold(f64::INFINITY, f64::min)
}

/// The codes of tags, by their numbers.
pub struct Tags(Vec<u64>);

impl Tags {
    /// The first tags of the family 36h11 (Olson 2011); `None` if there are not so many.
    pub fn april_36h11(count: usize) -> Option<Self> {
        let dictionary = builtins::builtin_dictionary("DICT_APRILTAG_36h11")?;
        Some(Self(dictionary.codes().get(..count)?.to_vec()))
    }

    /// The number of the tag with these bits, and by how many corners, clockwise, its first one lies behind that of the bits.
    pub fn find(&self, bits: &Bits) -> Option<(usize, usize)> {
        let mut turned = bits.code;
        for turns in 0..4 {
            let near = |code: &u64| (code ^ turned).count_ones() + bits.light_border <= MAX_WRONG_BITS;
            if let Some(id) = self.0.iter().position(near) {
                return Some((id, turns));
            }
            turned = turned_once(turned);
        }
        None
    }

    /// The bits of the tag of this number.
    #[cfg(test)]
    pub fn code(&self, id: usize) -> u64 {
        self.0[id]
    }

    /// How many bits, and cells of the border, are not those of the tag of this number, read from `turns` corners before its
    /// first one on.
    pub fn wrong_cells(&self, id: usize, turns: usize, bits: &Bits) -> u32 {
        let turned = (0..turns).fold(bits.code, |code, _| turned_once(code));
        (self.0[id] ^ turned).count_ones() + bits.light_border
    }

    /// How many bits are not those of the tag of this number.
    pub fn wrong_bits(&self, id: usize, bits: &Bits) -> u32 {
        self.0.get(id).map_or(u32::MAX, |code| (code ^ bits.code).count_ones())
    }
}

/// Width of a border of so many bits as a share of a tag's side.
pub fn border_share(bits: usize) -> f64 {
    bits as f64 / (SIDE + 2 * bits) as f64
}

/// The code as it is read from the next corner on, clockwise.
fn turned_once(code: u64) -> u64 {
    let bit = |row: usize, column: usize| code >> (row * SIDE + column) & 1;
    // Along the new rows the old ones are gone through, from the last column back.
    let of = |i: usize| bit(i % SIDE, SIDE - 1 - i / SIDE) << i;
    (0..SIDE * SIDE).map(of).sum()
}

/// What is read in a square that may be a tag.
pub struct Bits {
    /// A set bit is black; the lowest is that at the first corner, then on towards the second.
    code: u64,
    /// Cells of the border that look white.
    light_border: u32,
}

impl Bits {
    /// Reads the square with these corners, clockwise, whose border is so many bits wide; `None` where there is no contrast.
    pub fn read(image: &GrayImage, corners: &Tag, border: usize) -> Option<Self> {
        let cells = SIDE + 2 * border;
        let unit = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[x, y]| Vector2::new(x, y));
        let pairs: Vec<_> = (0..4).map(|k| (unit[k], corners[k])).collect();
        let homography = homography(&pairs)?;
        let level = |i: usize| cell_level(image, &homography, i % cells, i / cells, cells);
        let levels: Vec<f32> = (0..cells * cells).map(level).collect();
        let within = |at: usize| (border..border + SIDE).contains(&at);
        let (coded, dark): (Vec<usize>, Vec<usize>) =
            (0..cells * cells).partition(|i| within(i % cells) && within(i / cells));
        let black = dark.iter().map(|i| levels[*i]).sum::<f32>() / dark.len() as f32;
        let white = coded.iter().map(|i| levels[*i]).fold(0.0, f32::max);
        if white - black < MIN_CONTRAST {
            return None;
        }
        let is_black = |i: &usize| levels[*i] <= 0.5 * (black + white);
        let code = coded.iter().enumerate().map(|(bit, i)| u64::from(is_black(i)) << bit).sum();
        let light_border = dark.iter().filter(|i| !is_black(i)).count() as u32;
        Some(Self { code, light_border })
    }
}

/// Mean of a few places in the middle of a cell.
fn cell_level(image: &GrayImage, homography: &Matrix3<f64>, column: usize, row: usize, cells: usize) -> f32 {
    let places = [0.35, 0.5, 0.65];
    let mut sum = 0.0;
    for dy in places {
        for dx in places {
            let at = Vector2::new((column as f64 + dx) / cells as f64, (row as f64 + dy) / cells as f64);
            let pixel = mapped(homography, &at).cast::<f32>();
            sum += if image.contains(pixel.x, pixel.y, 0.0) { image.bilinear(pixel.x, pixel.y) } else { 0.0 };
        }
    }
    sum / (places.len() * places.len()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_comes_back_after_four_quarter_rotations_and_its_first_bit_visits_all_corners() {
        let code = 0x0d_5d62_8584;
        assert_eq!((0..4).fold(code, |code, _| turned_once(code)), code);
        // The top right corner's bit is the first one from there on.
        assert_eq!(turned_once(1 << (SIDE - 1)), 1);
        assert_eq!(turned_once(1), 1 << (SIDE * (SIDE - 1)));
    }

    #[test]
    fn a_tag_is_found_from_any_corner_and_with_wrong_bits_but_not_with_many() {
        let tags = Tags::april_36h11(36).unwrap();
        let mut code = tags.0[17];
        // Read from its last corner on: the first is one further.
        for turns in [0, 3, 2, 1] {
            let bits = |code| Bits { code, light_border: 0 };
            assert_eq!(tags.find(&bits(code)), Some((17, turns)));
            assert_eq!(tags.find(&bits(code ^ 0b10_0001_0001)), Some((17, turns)));
            assert_eq!(tags.find(&bits(code ^ 0b11_0001_0001)), None);
            assert_eq!(tags.find(&Bits { code: code ^ 0b1, light_border: 3 }), None);
            code = turned_once(code);
        }
        assert!(Tags::april_36h11(588).is_none());
    }
}
