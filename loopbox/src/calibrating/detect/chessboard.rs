//! Chessboards.

use super::mat;
use super::sub_pixel::{refined, vector};
use anyhow::Result;
use calib::Corner;
use geometry::GrayImage;
use nalgebra::Vector2;
use opencv::calib3d::{
    CALIB_CB_ADAPTIVE_THRESH, CALIB_CB_FAST_CHECK, CALIB_CB_NORMALIZE_IMAGE, find_chessboard_corners,
};
use opencv::core::{Point2f, Size, Vector};

/// Part of the distance between corners that is looked at around each.
const WINDOW: f64 = 0.35;

/// A chessboard of `columns × rows` inner corners.
pub struct Chessboard {
    pub columns: usize,
    pub rows: usize,
    /// How far around each corner is looked, pixels; of itself a part of the distance between corners.
    pub window: Option<u16>,
}

impl Chessboard {
    pub fn corners(&self, image: &GrayImage) -> Result<Vec<Corner>> {
        let pixels = mat(image)?;
        let size = Size::new(self.columns as i32, self.rows as i32);
        let flags = CALIB_CB_ADAPTIVE_THRESH | CALIB_CB_NORMALIZE_IMAGE | CALIB_CB_FAST_CHECK;
        let mut found = Vector::<Point2f>::new();
        if !find_chessboard_corners(&pixels, size, &mut found, flags)?
            || found.len() != self.columns * self.rows
        {
            return Ok(Vec::new());
        }
        let rough: Vec<Vector2<f64>> = found.iter().map(|point| vector(&point)).collect();
        let fitting = || (WINDOW * self.least_distance(&rough)).round().clamp(2.0, 11.0) as i32;
        let radius = self.window.map_or_else(fitting, i32::from);
        let fine = refined(&pixels, &rough, radius)?;
        Ok(fine.into_iter().enumerate().map(|(index, pixel)| Corner { index, pixel }).collect())
    }

    /// Least distance between neighbours in a row or column, pixels.
    fn least_distance(&self, corners: &[Vector2<f64>]) -> f64 {
        let neighbour = |i: usize| {
            let right = (i % self.columns + 1 < self.columns).then_some(i + 1);
            let below = Some(i + self.columns).filter(|&j| j < corners.len());
            [right, below].into_iter().flatten().map(move |j| (i, j))
        };
        let all = (0..corners.len()).flat_map(neighbour);
        all.map(|(i, j)| (corners[i] - corners[j]).norm()).fold(f64::INFINITY, f64::min)
    }

    /// Boards that people take for one another: squares counted instead of corners, a row too many or too few.
    pub fn what_else(&self, images: &[GrayImage]) -> Result<String> {
        let (columns, rows) = (self.columns as i64, self.rows as i64);
        let common =
            [(9, 6), (8, 6), (7, 6), (8, 5), (7, 5), (10, 7), (11, 8), (6, 4), (5, 4), (7, 7), (8, 8)];
        let near = [(-1, -1), (0, -1), (-1, 0), (1, 0), (0, 1), (1, 1)].map(|(c, r)| (columns + c, rows + r));
        for (columns, rows) in near.into_iter().chain(common) {
            if columns < 3 || rows < 3 || (columns, rows) == (self.columns as i64, self.rows as i64) {
                continue;
            }
            let other = Self { columns: columns as usize, rows: rows as usize, window: None };
            for image in images {
                if !other.corners(image)?.is_empty() {
                    return Ok(format!(
                        "a chessboard of {columns}×{rows} inner corners is seen instead\nhint: give --board \
                         chessboard:{columns}x{rows}:SQUARE; inner corners are counted, not squares"
                    ));
                }
            }
        }
        Ok("no chessboard of another usual size either\nhint: the whole board with a white margin must be in the image, flat \
            and evenly lit; count the inner corners, not the squares"
            .into())
    }
}
