//! Corners of a chessboard that their neighbours lead to.

use super::sub_pixel::{corner_near, refined};
use calib::Corner;
use calib::planar::{homography, mapped};
use geometry::GrayImage;
use nalgebra::{Matrix3, Vector2};
use std::collections::BTreeMap;

/// Neighbours up to so many squares away say where a corner must be.
const NEAR: i64 = 2;
/// Fewest and most of them.
const NEIGHBOURS: std::ops::RangeInclusive<usize> = 4..=9;
/// How far a corner may be from where its neighbours say, as a share of the least side of a square there: what lenses bend.
const REACH: f64 = 0.15;
/// Least side of a square, pixels.
const MIN_SIDE: f64 = 5.0;
/// Least share of the median contrast of the other corners.
const MIN_CONTRAST: f32 = 0.3;

/// The inner corners of a board of squares in turns black and white.
pub struct Lattice {
    /// Corners of a row.
    pub columns: usize,
    /// Rows of corners.
    pub rows: usize,
    /// How far from a corner along a square's sides its colour is certain, as a share of the side.
    pub plain: f64,
}

impl Lattice {
    /// The corners near `rough` ones (by number, row by row) and those that they lead to, to a fraction of a pixel; looks `radius` pixels
    /// around each.
    pub fn measured(
        &self,
        image: &GrayImage,
        rough: BTreeMap<usize, Vector2<f64>>,
        radius: usize,
    ) -> Vec<Corner> {
        let places: Vec<Vector2<f64>> = rough.values().copied().collect();
        let mut corners: BTreeMap<usize, Vector2<f64>> =
            rough.into_keys().zip(refined(image, &places, radius)).collect();
        self.complete(image, &mut corners, radius);
        corners.into_iter().map(|(index, pixel)| Corner { index, pixel }).collect()
    }

    /// Adds the corners that are missing among `corners` (by number, row by row) and that the image shows where these say.
    pub fn complete(&self, image: &GrayImage, corners: &mut BTreeMap<usize, Vector2<f64>>, radius: usize) {
        let mut contrasts: Vec<f32> = corners
            .keys()
            .filter_map(|&index| self.contrast(image, index, corners, corners[&index]))
            .collect();
        if contrasts.is_empty() {
            return;
        }
        contrasts.sort_by(f32::total_cmp);
        let usual = contrasts[contrasts.len() / 2];
        loop {
            let missing = (0..self.columns * self.rows).filter(|index| !corners.contains_key(index));
            let found = missing.filter_map(|index| Some((index, self.found(image, index, corners, radius)?)));
            let right = |(index, at): &(usize, Vector2<f64>)| {
                let contrast = self.contrast(image, *index, corners, *at);
                contrast.is_some_and(|contrast| contrast * usual.signum() >= MIN_CONTRAST * usual.abs())
            };
            let found: Vec<(usize, Vector2<f64>)> = found.filter(right).collect();
            if found.is_empty() {
                return;
            }
            corners.extend(found);
        }
    }

    /// The corner near where its neighbours say.
    fn found(
        &self,
        image: &GrayImage,
        index: usize,
        corners: &BTreeMap<usize, Vector2<f64>>,
        radius: usize,
    ) -> Option<Vector2<f64>> {
        let homography = self.around(index, corners)?;
        let place = self.place(index);
        let rough = mapped(&homography, &place);
        let side = sides(&homography, &place).iter().map(|side| side.norm()).fold(f64::INFINITY, f64::min);
        let inside = |at: &Vector2<f64>| image.contains(at.x as f32, at.y as f32, 3.0);
        if side < MIN_SIDE || !inside(&rough) {
            return None;
        }
        let fine = corner_near(image, rough, radius)?;
        ((fine - rough).norm() <= REACH * side && inside(&fine)).then_some(fine)
    }

    /// From places on the board, in squares, to pixels, by the corners around one.
    fn around(&self, index: usize, corners: &BTreeMap<usize, Vector2<f64>>) -> Option<Matrix3<f64>> {
        let (x, y) = self.cell(index);
        let offset = |other: usize| {
            let (u, v) = self.cell(other);
            (u - x, v - y)
        };
        let near = corners.keys().copied().filter(|&other| {
            let (dx, dy) = offset(other);
            other != index && dx.abs() <= NEAR && dy.abs() <= NEAR
        });
        let mut near: Vec<usize> = near.collect();
        near.sort_by_key(|&other| {
            let (dx, dy) = offset(other);
            (dx * dx + dy * dy, other)
        });
        near.truncate(*NEIGHBOURS.end());
        if near.len() < *NEIGHBOURS.start() {
            return None;
        }
        homography(&near.iter().map(|other| (self.place(*other), corners[other])).collect::<Vec<_>>())
    }

    /// How much lighter the two squares beside the corner are than those before and behind it, the other way round at every
    /// second corner; `None` where the four are not of two colours.
    fn contrast(
        &self,
        image: &GrayImage,
        index: usize,
        corners: &BTreeMap<usize, Vector2<f64>>,
        at: Vector2<f64>,
    ) -> Option<f32> {
        let homography = self.around(index, corners)?;
        let [across, down] = sides(&homography, &self.place(index)).map(|side| side * self.plain);
        let level = |offset: Vector2<f64>| {
            let pixel = (at + offset).cast::<f32>();
            image.contains(pixel.x, pixel.y, 0.0).then(|| image.bilinear(pixel.x, pixel.y))
        };
        let (before, behind) = (level(-across - down)?, level(across + down)?);
        let (left, right) = (level(down - across)?, level(across - down)?);
        let (x, y) = self.cell(index);
        let sign = if (x + y) % 2 == 0 { 1.0 } else { -1.0 };
        let apart = (left.min(right) - before.max(behind)).max(before.min(behind) - left.max(right));
        (apart > 0.0).then(|| sign * (left + right - before - behind) / 2.0)
    }

    fn cell(&self, index: usize) -> (i64, i64) {
        ((index % self.columns) as i64, (index / self.columns) as i64)
    }

    fn place(&self, index: usize) -> Vector2<f64> {
        let (x, y) = self.cell(index);
        Vector2::new(x as f64, y as f64)
    }

    /// Least distance between neighbours in a row or column, pixels; infinite where there are none.
    pub fn least_distance(&self, corners: &BTreeMap<usize, Vector2<f64>>) -> f64 {
        let neighbour = |&index: &usize| {
            let right = (index % self.columns + 1 < self.columns).then_some(index + 1);
            [right, Some(index + self.columns)].into_iter().flatten().map(move |other| (index, other))
        };
        let pairs = corners.keys().flat_map(neighbour);
        let apart = pairs.filter_map(|(a, b)| Some((corners.get(&a)? - corners.get(&b)?).norm()));
        apart.fold(f64::INFINITY, f64::min)
    }
}

/// The sides of a square at a place, pixels: along its row and down its column.
fn sides(homography: &Matrix3<f64>, place: &Vector2<f64>) -> [Vector2<f64>; 2] {
    let at = mapped(homography, place);
    [Vector2::x(), Vector2::y()].map(|side| mapped(homography, &(place + side)) - at)
}
