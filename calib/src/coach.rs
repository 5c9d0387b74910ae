//! What views of the board are still missing.

use crate::planar::{homography, mapped};
use crate::{Board, View};
use nalgebra::{Matrix3, Vector2};

/// Columns and rows of cells into which the image is divided.
pub const CELLS: (usize, usize) = (6, 4);
/// Views with which a calibration can be tried.
pub const ENOUGH_VIEWS: usize = 12;
/// How much farther one side of the board is than the other, as a share, before it counts as tilted; about 15° to 20° where
/// the board fills half of the image.
const TILTED: f64 = 0.08;
/// Board's share of the image's diagonal that counts as near, and as far.
const NEAR: f64 = 0.55;
const FAR: f64 = 0.4;
/// Mean motion of the corners, as a share of the image's diagonal, that makes a view a new one.
const NEW_VIEW: f64 = 0.04;

/// What has been seen so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coverage {
    /// Views taken.
    pub views: usize,
    /// Corners found in each cell of the image ([`CELLS`]), row by row.
    pub cells: Vec<usize>,
    /// Views tilted such that the left, right, upper, lower side of the image shows the farther side of the board.
    pub tilts: [usize; 4],
    /// Views with the board near (large), and far (small).
    pub near_far: [usize; 2],
}

impl Coverage {
    /// Share of the cells in which corners were found, 0–1.
    pub fn share(&self) -> f64 {
        self.cells.iter().filter(|count| **count > 0).count() as f64 / self.cells.len().max(1) as f64
    }

    /// Whether nothing important is missing.
    pub fn complete(&self) -> bool {
        self.advice().is_empty()
    }

    /// What to do next, the weightiest first; empty when nothing important is missing.
    pub fn advice(&self) -> Vec<String> {
        let mut advice = Vec::new();
        let names = ["to the left", "to the right", "away at the top", "away at the bottom"];
        for (count, name) in self.tilts.iter().zip(names) {
            if *count < 2 {
                advice.push(format!("tilt the board {name}, by 20° to 45°"));
            }
        }
        for (cells, name) in edges() {
            if !cells.iter().any(|&cell| self.cells.get(cell).is_some_and(|count| *count > 0)) {
                advice.push(format!("bring the board to the {name} of the image"));
            }
        }
        if advice.is_empty() && self.share() < 0.75 {
            advice.push("show the board where the image is still empty".into());
        }
        if self.near_far[0] == 0 {
            advice.push("bring the board near, so that it fills the image".into());
        }
        if self.near_far[1] == 0 {
            advice.push("take the board farther away".into());
        }
        if self.views < ENOUGH_VIEWS {
            advice.push(format!("take more views: {} of {ENOUGH_VIEWS}", self.views));
        }
        advice
    }
}

/// The cells at the corners of the image, with their names.
fn edges() -> [([usize; 3], &'static str); 4] {
    let (columns, rows) = CELLS;
    let (right, last) = (columns - 1, (rows - 1) * columns);
    [
        ([0, 1, columns], "upper left corner"),
        ([right, right - 1, right + columns], "upper right corner"),
        ([last, last + 1, last - columns], "lower left corner"),
        ([last + right, last + right - 1, last + right - columns], "lower right corner"),
    ]
}

/// What these views of the board, in images of `size`, have seen. No calibration is needed.
pub fn coverage(board: &Board, views: &[View], size: (usize, usize)) -> Coverage {
    let points = board.points();
    let mut coverage = Coverage { cells: vec![0; CELLS.0 * CELLS.1], ..Coverage::default() };
    for view in views {
        coverage.views += 1;
        for corner in &view.corners {
            let cell = |at: f64, side: usize, cells: usize| {
                ((at + 0.5) / side as f64 * cells as f64).clamp(0.0, cells as f64 - 1.0) as usize
            };
            let (x, y) = (cell(corner.pixel.x, size.0, CELLS.0), cell(corner.pixel.y, size.1, CELLS.1));
            coverage.cells[y * CELLS.0 + x] += 1;
        }
        let pairs: Vec<_> =
            view.corners.iter().map(|corner| (points[corner.index].xy(), corner.pixel)).collect();
        let Some(homography) = homography(&pairs) else { continue };
        let (slope, extent) = slope_and_extent(&homography, &pairs, board);
        let (across, down) = (slope.x, slope.y);
        let tilted = [across < -TILTED, across > TILTED, down < -TILTED, down > TILTED];
        tilted.iter().zip(&mut coverage.tilts).for_each(|(is, count)| *count += usize::from(*is));
        let share = extent / (size.0 as f64).hypot(size.1 as f64);
        coverage.near_far[0] += usize::from(share > NEAR);
        coverage.near_far[1] += usize::from(share < FAR);
    }
    coverage
}

/// How depth grows across the board, per board's diagonal, in the directions of the image's axes; and the length of the
/// board's diagonal in the image, pixels.
fn slope_and_extent(
    h: &Matrix3<f64>,
    pairs: &[(Vector2<f64>, Vector2<f64>)],
    board: &Board,
) -> (Vector2<f64>, f64) {
    let middle = pairs.iter().map(|pair| pair.0).sum::<Vector2<f64>>() / pairs.len() as f64;
    // The third coordinate is depth, up to scale: its relative gradient on the board.
    let depth = (h * middle.push(1.0)).z;
    let gradient = Vector2::new(h[(2, 0)], h[(2, 1)]) / depth * board.diagonal();
    let step = 1e-3 * board.diagonal();
    let at = mapped(h, &middle);
    let along = |axis: Vector2<f64>| (mapped(h, &(middle + axis * step)) - at) / step;
    let (x, y) = (along(Vector2::x()), along(Vector2::y()));
    // Each axis of the board counts towards the image's axis along which it runs.
    let slope = x.normalize() * gradient.x + y.normalize() * gradient.y;
    (slope, board.diagonal() * x.norm().max(y.norm()))
}

/// Whether a view is unlike each of those taken already: worth keeping.
pub fn is_new_view(views: &[View], view: &View, size: (usize, usize)) -> bool {
    let least = NEW_VIEW * (size.0 as f64).hypot(size.1 as f64);
    views.iter().all(|taken| {
        let mut moves = Vec::new();
        for corner in &view.corners {
            if let Some(other) = taken.corners.iter().find(|other| other.index == corner.index) {
                moves.push((other.pixel - corner.pixel).norm());
            }
        }
        // Views of other parts of the board are new.
        2 * moves.len() < view.corners.len() || moves.iter().sum::<f64>() / moves.len() as f64 > least
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::tests::{Noise, board, placed, seen, usual_poses};
    use geometry::{Camera, Distortion, Pinhole};

    const SIZE: (usize, usize) = (640, 480);

    fn view(position: [f64; 3], tilt: [f64; 3]) -> View {
        let pinhole = Pinhole { width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 319.5, cy: 239.5 };
        let camera = Camera::new(pinhole, Distortion::None).unwrap();
        seen(&camera, &board(), &placed(&board(), position, tilt), 0.0, &mut Noise::new(1))
    }

    #[test]
    fn nothing_seen_asks_for_everything() {
        let advice = coverage(&board(), &[], SIZE).advice();
        assert!(advice[0].contains("tilt the board to the left") && advice.len() == 11, "{advice:?}");
    }

    #[test]
    fn tilts_are_recognised_by_where_the_board_is_farther() {
        let tilts = |tilt: [f64; 3]| coverage(&board(), &[view([0.0, 0.0, 0.4], tilt)], SIZE).tilts;
        // Turned about y by +: x of the board goes to −z, its right side comes nearer.
        assert_eq!(tilts([0.0, 0.5, 0.0]), [1, 0, 0, 0]);
        assert_eq!(tilts([0.0, -0.5, 0.0]), [0, 1, 0, 0]);
        // Turned about x by +: y goes to +z, its lower side goes away.
        assert_eq!(tilts([0.5, 0.0, 0.0]), [0, 0, 0, 1]);
        assert_eq!(tilts([-0.5, 0.0, 0.0]), [0, 0, 1, 0]);
        assert_eq!(tilts([0.0, 0.0, 0.6]), [0; 4]);
    }

    #[test]
    fn good_views_leave_nothing_to_say() {
        let tilts = [[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, -0.5, 0.0]];
        let mut views = Vec::new();
        for (i, x) in [-0.08, 0.08, -0.08, 0.08].into_iter().enumerate() {
            let y = if i < 2 { -0.06 } else { 0.06 };
            views.extend((0..3).map(|k| view([x, y, 0.38], tilts[(i + k) % 4])));
        }
        views.push(view([0.0, 0.0, 0.3], [0.0; 3]));
        views.push(view([0.0, 0.0, 0.9], [0.0; 3]));
        let found = coverage(&board(), &views, SIZE);
        assert!(found.complete(), "{:?} {found:?}", found.advice());
    }

    #[test]
    fn a_view_is_new_when_the_board_has_moved() {
        let first = view([0.0, 0.0, 0.4], [0.0; 3]);
        assert!(is_new_view(&[], &first, SIZE));
        assert!(!is_new_view(std::slice::from_ref(&first), &view([0.002, 0.0, 0.4], [0.0; 3]), SIZE));
        assert!(is_new_view(&[first], &view([0.05, 0.0, 0.4], [0.0; 3]), SIZE));
        assert!(!usual_poses(&board()).is_empty());
    }
}
