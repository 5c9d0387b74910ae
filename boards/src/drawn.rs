//! Boards drawn as a camera without distortion sees them.

use super::tag::Tags;
use calib::Board;
use calib::planar::mapped;
use calib_targets_charuco::builtins;
use geometry::GrayImage;
use nalgebra::{Matrix3, Vector2};

const BLACK: f64 = 25.0;
const WHITE: f64 = 225.0;
/// Rays per side of a pixel.
const RAYS: usize = 4;

/// An image of the board, seen somewhat from the side, and where its corners are in it.
pub fn drawn(
    board: &Board,
    (width, height): (usize, usize),
    pixels_per_metre: f64,
) -> (GrayImage, Vec<Vector2<f64>>) {
    // Kalibr's boards have y upwards.
    let up = if matches!(board, Board::AprilGrid { .. }) { -1.0 } else { 1.0 };
    let points = board.points();
    let middle = points.iter().map(|point| point.xy()).sum::<Vector2<f64>>() / points.len() as f64;
    let (sin, cos) = 0.12f64.sin_cos();
    let s = pixels_per_metre;
    let centred = Matrix3::new(1.0, 0.0, -middle.x, 0.0, 1.0, -middle.y, 0.0, 0.0, 1.0);
    let seen = Matrix3::new(s * cos, -s * sin * up, 0.0, s * sin, s * cos * up, 0.0, 0.25, 0.15 * up, 1.0);
    let placed = Matrix3::new(1.0, 0.0, width as f64 / 2.0, 0.0, 1.0, height as f64 / 2.0, 0.0, 0.0, 1.0);
    let pixel_from_board = placed * seen * centred;
    let board_from_pixel = pixel_from_board.try_inverse().expect("a view");
    let mut image = GrayImage::filled(width, height, 0);
    for (i, pixel) in image.data_mut().iter_mut().enumerate() {
        let sub = |k: usize| (k as f64 + 0.5) / RAYS as f64 - 0.5;
        let ray = |k: usize| {
            let at = Vector2::new((i % width) as f64 + sub(k % RAYS), (i / width) as f64 + sub(k / RAYS));
            if is_black(board, mapped(&board_from_pixel, &at)) { BLACK } else { WHITE }
        };
        *pixel = ((0..RAYS * RAYS).map(ray).sum::<f64>() / (RAYS * RAYS) as f64).round() as u8;
    }
    (image, points.iter().map(|point| mapped(&pixel_from_board, &point.xy())).collect())
}

/// Whether a place of the board's plane is black.
fn is_black(board: &Board, at: Vector2<f64>) -> bool {
    match *board {
        Board::Chessboard { columns, rows, square } => {
            let (i, j) = ((at.x / square).floor() as i64 + 1, (at.y / square).floor() as i64 + 1);
            (0..=columns as i64).contains(&i) && (0..=rows as i64).contains(&j) && (i + j) % 2 == 0
        }
        Board::Charuco { columns, rows, square, marker, ref dictionary } => {
            let (u, v) = (at.x / square + 1.0, at.y / square + 1.0);
            let (i, j) = (u.floor() as i64, v.floor() as i64);
            if !(0..columns as i64).contains(&i) || !(0..rows as i64).contains(&j) {
                return false;
            }
            if (i + j) % 2 == 0 {
                return true;
            }
            let before = |j: i64| (0..columns as i64).filter(|i| (i + j) % 2 == 1).count();
            let id = (0..j).map(before).sum::<usize>() + (0..i).filter(|i| (i + j) % 2 == 1).count();
            let dictionary = builtins::builtin_dictionary(dictionary).expect("a dictionary");
            let inside = |share: f64| (share - share.floor() - 0.5) * square / marker + 0.5;
            marker_is_black(dictionary.codes()[id], dictionary.marker_size(), 1, inside(u), inside(v))
        }
        Board::AprilGrid { columns, rows, tag, spacing } => {
            let pitch = tag * (1.0 + spacing);
            let (u, v) = (at.x / pitch, at.y / pitch);
            let (column, row) = (u.floor(), v.floor());
            let (x, y) = ((u - column) * pitch / tag, (v - row) * pitch / tag);
            let in_gaps = x > 1.0 && y > 1.0;
            if in_gaps {
                return (-1.0..columns as f64).contains(&column) && (-1.0..rows as f64).contains(&row);
            }
            if !(0.0..columns as f64).contains(&column) || !(0.0..rows as f64).contains(&row) {
                return false;
            }
            let tags = Tags::april_36h11(columns * rows).expect("tags");
            // Its first bit is where x is largest and y least.
            marker_is_black(tags.code(row as usize * columns + column as usize), 6, 2, 1.0 - x, y)
        }
    }
}

/// Whether a place of a marker, from its first bit's corner on in parts of its side, is black; white around it.
fn marker_is_black(code: u64, side: usize, border: usize, x: f64, y: f64) -> bool {
    if !(0.0..1.0).contains(&x) || !(0.0..1.0).contains(&y) {
        return false;
    }
    let cells = side + 2 * border;
    let cell = |share: f64| (share * cells as f64) as usize;
    let (column, row) = (cell(x), cell(y));
    let within = |at: usize| (border..border + side).contains(&at);
    let bit = || code >> ((row - border) * side + column - border) & 1 == 1;
    !within(column) || !within(row) || bit()
}
