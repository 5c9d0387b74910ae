//! Chessboards.

use super::lattice::Lattice;
use super::view;
use calib::Corner;
use calib_targets_chessboard::{
    ChessboardDetection, ChessboardDetector, ChessboardParams, default_chess_config, detect_corners,
};
use geometry::GrayImage;
use nalgebra::Vector2;
use std::collections::BTreeMap;

/// Part of the distance between corners that is looked at around each.
const WINDOW: f64 = 0.35;
/// Least share of the corners that the others, up to all, are sought by.
const MIN_FOUND: f64 = 0.75;

/// A chessboard of `columns × rows` inner corners.
pub struct Chessboard {
    pub columns: usize,
    pub rows: usize,
    /// How far around each corner is looked, pixels; of itself a part of the distance between corners.
    pub window: Option<u16>,
}

impl Chessboard {
    /// All corners, row by row; none where the board is not seen whole.
    pub fn corners(&self, image: &GrayImage) -> Vec<Corner> {
        let found = grids(image).into_iter().filter_map(|grid| grid.ordered(self.columns, self.rows));
        let measured = found.map(|rough| self.measured(image, rough));
        measured.into_iter().find(|corners| !corners.is_empty()).unwrap_or_default()
    }

    /// The corners near those found and those between them, to a fraction of a pixel; none where one is missing.
    pub fn measured(&self, image: &GrayImage, rough: BTreeMap<usize, Vector2<f64>>) -> Vec<Corner> {
        let lattice = Lattice { columns: self.columns, rows: self.rows, plain: 0.25 };
        let fitting = || (WINDOW * lattice.least_distance(&rough)).round().clamp(2.0, 11.0) as usize;
        let radius = self.window.map_or_else(fitting, usize::from);
        let corners = lattice.measured(image, rough, radius);
        if corners.len() < self.columns * self.rows { Vec::new() } else { corners }
    }

    /// Boards that people take for one another: squares counted instead of corners, a row too many or too few.
    pub fn what_else(&self, images: &[GrayImage]) -> String {
        let whole =
            |grid: &Grid| grid.columns.min(grid.rows) >= 3 && grid.corners.len() == grid.columns * grid.rows;
        if let Some(grid) = images.iter().flat_map(grids).find(whole) {
            let (columns, rows) = (grid.columns.max(grid.rows), grid.columns.min(grid.rows));
            return format!(
                "a chessboard of {columns}×{rows} inner corners is seen instead\nhint: give --board \
                 chessboard:{columns}x{rows}:SQUARE; inner corners are counted, not squares"
            );
        }
        "no chessboard of another size either\nhint: the whole board with a white margin must be in the image, flat and evenly \
         lit; count the inner corners, not the squares"
            .into()
    }
}

/// Column and row.
type Cell = (usize, usize);
type Placed = (Cell, Vector2<f64>);

/// Corners of a chessboard by column and row, of which some may be missing.
struct Grid {
    columns: usize,
    rows: usize,
    corners: Vec<Placed>,
}

impl Grid {
    fn new(detection: &ChessboardDetection) -> Self {
        let place = |corner: &calib_targets_chessboard::ChessboardCorner| {
            let cell = (usize::try_from(corner.grid.u).ok()?, usize::try_from(corner.grid.v).ok()?);
            Some((cell, Vector2::new(f64::from(corner.position.x), f64::from(corner.position.y))))
        };
        let mut corners: Vec<_> = detection.corners.iter().filter_map(place).collect();
        while let Some(stray) = stray_line(&corners) {
            corners.retain(|(cell, _)| !stray(cell));
        }
        Self::of(corners)
    }

    /// The corners, counted from the first column and row that have any.
    fn of(mut corners: Vec<Placed>) -> Self {
        let least = |side: fn(&Cell) -> usize| corners.iter().map(|(cell, _)| side(cell)).min().unwrap_or(0);
        let (left, top) = (least(|cell| cell.0), least(|cell| cell.1));
        corners.iter_mut().for_each(|(cell, _)| *cell = (cell.0 - left, cell.1 - top));
        let sides =
            |side: fn(&Cell) -> usize| corners.iter().map(|(cell, _)| side(cell) + 1).max().unwrap_or(0);
        Self { columns: sides(|cell| cell.0), rows: sides(|cell| cell.1), corners }
    }

    /// Its corners by their numbers, row by row, if it has so many columns and rows and most of its corners, or is such a
    /// board turned by a quarter.
    fn ordered(&self, columns: usize, rows: usize) -> Option<BTreeMap<usize, Vector2<f64>>> {
        if (self.corners.len() as f64) < MIN_FOUND * (columns * rows) as f64 {
            return None;
        }
        let place = |(u, v): Cell| match (self.columns, self.rows) {
            size if size == (columns, rows) => Some((u, v)),
            size if size == (rows, columns) => Some((v, self.columns - 1 - u)),
            _ => None,
        };
        let numbered = |(cell, pixel): &Placed| {
            let (column, row) = place(*cell)?;
            Some((row * columns + column, *pixel))
        };
        self.corners.iter().map(numbered).collect()
    }
}

/// The outermost column or row with corners in less than half of its places: those are not of the board but of what lies
/// beside it, such as the edge of its paper.
fn stray_line(corners: &[Placed]) -> Option<impl Fn(&Cell) -> bool + use<>> {
    let sides: [fn(&Cell) -> usize; 2] = [|cell| cell.0, |cell| cell.1];
    let range = |side: fn(&Cell) -> usize| {
        let places = || corners.iter().map(|(cell, _)| side(cell));
        Some((places().min()?, places().max()?))
    };
    let [columns, rows] = sides.map(range);
    let lengths = [rows?, columns?].map(|(first, last)| last + 1 - first);
    let ends = [(columns?.0, 0), (columns?.1, 0), (rows?.0, 1), (rows?.1, 1)];
    let count = |(at, k): (usize, usize)| corners.iter().filter(|(cell, _)| sides[k](cell) == at).count();
    let stray = |&(at, k): &(usize, usize)| 2 * count((at, k)) < lengths[k];
    let (at, k) = ends.into_iter().filter(stray).min_by_key(|end| count(*end))?;
    Some(move |cell: &Cell| sides[k](cell) == at)
}

/// The chessboards in an image.
fn grids(image: &GrayImage) -> Vec<Grid> {
    let corners = detect_corners(&view(image), &default_chess_config());
    // The defaults are valid, so there is always a detector.
    let Ok(detector) = ChessboardDetector::new(ChessboardParams::default()) else { return Vec::new() };
    detector.detect_all(&corners).iter().map(Grid::new).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The corners of a board drawn straight from the front, its columns along x or, turned, along −y.
    fn drawn(columns: usize, rows: usize, turned: bool) -> Grid {
        let pixel = |column: usize, row: usize| Vector2::new(column as f64, row as f64);
        let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        let corners = cells.map(|(column, row)| {
            let cell = if turned { (rows - 1 - row, column) } else { (column, row) };
            (cell, pixel(column, row))
        });
        let (w, h) = if turned { (rows, columns) } else { (columns, rows) };
        Grid { columns: w, rows: h, corners: corners.collect() }
    }

    #[test]
    fn a_board_turned_by_a_quarter_is_in_order_and_not_mirrored() {
        for turned in [false, true] {
            let ordered = drawn(5, 3, turned).ordered(5, 3).unwrap();
            let straight = drawn(5, 3, false).corners;
            assert_eq!(
                ordered.into_values().collect::<Vec<_>>(),
                straight.iter().map(|(_, at)| *at).collect::<Vec<_>>()
            );
        }
        assert!(drawn(5, 4, false).ordered(5, 3).is_none());
        let mut holed = drawn(5, 3, false);
        holed.corners.truncate(14);
        assert_eq!(holed.ordered(5, 3).unwrap().len(), 14);
        holed.corners.truncate(11);
        assert!(holed.ordered(5, 3).is_none());
    }
}
