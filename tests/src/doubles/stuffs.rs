//! What things and walls of doubles wear.

use crate::Texture;
use geometry::Random;
use std::sync::LazyLock;

/// Pictures that things of all places wear, each another part of one.
pub(super) static PICTURES: LazyLock<Vec<Texture>> =
    LazyLock::new(|| (900..908).map(Texture::varied).collect());
/// Plaster, brick, wood, tiles, a carpet, paper, and what follows.
pub(super) static STUFFS: LazyLock<[Texture; 14]> = LazyLock::new(|| {
    let joint = |v: usize, step: usize| v % step < 3;
    let tone = |x: usize, y: usize| (Random::new((x * 977 + y) as u64).unit() as f32 - 0.5) * 30.0;
    [
        Texture::painted(|_, _| 168.0),
        Texture::painted(move |x, y| {
            let (row, column) = (y / 32, (x + y / 32 % 2 * 32) / 64 % 16);
            let is_joint = joint(y, 32) || joint(x + row % 2 * 32, 64);
            if is_joint { 150.0 } else { 105.0 + tone(column, row) }
        }),
        Texture::painted(move |x, y| {
            let plank = x / 64;
            let waves = (x as f32 * 0.9).sin() * 4.0 + ((y as f32) * 0.012 + plank as f32).sin() * 6.0;
            if joint(x, 64) { 70.0 } else { 120.0 + tone(plank, 7) + waves }
        }),
        Texture::painted(move |x, y| if joint(x, 128) || joint(y, 128) { 120.0 } else { 196.0 }),
        Texture::varied(77),
        Texture::painted(|x, y| 178.0 + printed(x % 256, y % 256)),
        Texture::painted(|_, _| 122.0),
        Texture::painted(|_, _| 46.0),
        Texture::painted(|x, y| 100.0 + woven(x % 128, y % 128)),
        Texture::painted(|x, y| cast(x % 256, y % 256)),
        Texture::painted(|x, _| if x / 128 % 2 == 0 { 92.0 } else { 108.0 }),
        books(),
        Texture::painted(|x, y| if is_ink(x, y) { 96.0 } else { 190.0 }),
        Texture::painted(|_, _| 205.0),
    ]
});
pub(super) const PLASTER: usize = 0;
pub(super) const BRICK: usize = 1;
pub(super) const WOOD: usize = 2;
pub(super) const TILES: usize = 3;
pub(super) const CARPET: usize = 4;
pub(super) const PAPER: usize = 5;
/// Grey paint.
pub(super) const STEEL: usize = 6;
/// Dark paint, glass, rubber.
pub(super) const DARK: usize = 7;
/// The cloth of seats, woven in a pattern.
pub(super) const CLOTH: usize = 8;
/// Concrete with the joints and the holes of its boards.
pub(super) const CONCRETE: usize = 9;
/// Grass that is mown in stripes.
pub(super) const LAWN: usize = 10;
/// Backs of books side by side.
pub(super) const BOOKS: usize = 11;
/// Lines of letters; the middle of a box's face is that of a line.
pub(super) const LETTERS: usize = 12;
/// White paint.
pub(super) const WHITE: usize = 13;

/// A fine pattern of some 4 grey levels, printed: blots of several sizes.
fn printed(x: usize, y: usize) -> f32 {
    let blots = [4usize, 8, 16, 32].iter().map(|size| {
        let at = (x / size * 7919 + y / size) as u64;
        Random::new(at ^ (*size as u64) << 40).unit() as f32 - 0.5
    });
    7.0 * blots.sum::<f32>()
}

/// Squares and bars of a cloth that repeats.
fn woven(x: usize, y: usize) -> f32 {
    let square = Random::new((x / 32 * 7 + y / 32) as u64).uniform(-45.0, 45.0);
    let bar = if x % 32 / 8 == 1 && y % 64 > 12 { 50.0 } else { 0.0 };
    square + bar
}

/// Concrete: a joint round each board, and four holes of the ties in it.
fn cast(x: usize, y: usize) -> f32 {
    let off = |v: usize| v.abs_diff(64).min(v.abs_diff(192));
    let is_hole = off(x).pow(2) + off(y).pow(2) < 36;
    if is_hole {
        70.0
    } else if x < 3 || y < 3 {
        112.0
    } else {
        146.0
    }
}

/// Books of all thicknesses, each with its cloth's tone and a title.
fn books() -> Texture {
    let mut random = Random::new(0xb00c);
    let mut backs = Vec::new();
    while backs.len() < Texture::SIZE {
        let (tone, ink) = (random.uniform(40.0, 190.0), random.uniform(-60.0, 60.0));
        let title = 15 + random.index(50);
        backs.extend(std::iter::repeat_n((tone, ink, title), 8 + random.index(18)));
        backs.push((30.0, 0.0, title));
    }
    Texture::painted(|x, y| {
        let (tone, ink, title) = backs[x];
        let is_title = (title..title + 40).contains(&(y % 128)) && y % 10 > 3;
        tone + if is_title { ink } else { 0.0 }
    })
}

/// Whether a letter's stroke is there: letters of 16 × 32 texels with spaces, of five upright or level strokes.
fn is_ink(x: usize, y: usize) -> bool {
    let (column, row) = ((x + 4) % 1024 / 16, (y + 4) % 1024 / 32);
    let (x, y) = ((x + 4) % 16, (y + 4) % 32);
    let strokes = Random::new((column * 64 + row) as u64 ^ 0x1e77).bits();
    let is_drawn = |stroke: u32| strokes >> stroke & 1 == 1;
    let is_inside = (3..13).contains(&x) && (6..26).contains(&y);
    let is_level =
        [6, 14, 22].iter().zip(2..).any(|(from, stroke)| (*from..from + 4).contains(&y) && is_drawn(stroke));
    let is_upright = x < 6 && is_drawn(0) || x >= 10 && is_drawn(1);
    is_inside && strokes >> 8 & 7 != 0 && (is_level || is_upright)
}
