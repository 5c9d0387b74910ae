//! The corners of calibration boards in images: chessboards and ChArUco boards by the crates `calib-targets`, AprilGrids and
//! single AprilTags by this one; with the feature `opencv`, what these do not find by the system's OpenCV too.
//!
//! Beside OpenCV 4.6 on rendered images of 640 × 480 pixels with known corners (sharp, soft, noisy, small, steep and cut off, 12
//! each), images in which the board was found, corners, and root mean square of their errors, pixels:
//!
//! | board | OpenCV | this |
//! |---|---|---|
//! | `chessboard:9x6:0.03` | 60, 3240, 0.043 | 60, 3240, 0.043 |
//! | `charuco:7x5:0.04:0.03` | 72, 1542, 0.080 | 72, 1664, 0.050 |
//! | `charuco:6x8:0.03:0.02:DICT_5X5_100` | 72, 2214, 0.089 | 70, 2346, 0.051 |
//! | `charuco:8x11:0.03:0.022:DICT_6X6_250` | 71, 4156, 0.132 | 60, 4030, 0.104 |
//! | `aprilgrid:6x6:0.088:0.3` | 54, 7154, 0.173 | 71, 9532, 0.065 |
//! | `aprilgrid:4x5:0.04:0.2` | 69, 4722, 0.661 | 72, 5388, 0.239 |
//! | `aprilgrid:2x2:0.1:0.3` | 65, 1008, 0.565 | 63, 976, 0.109 |
//!
//! What is lost are ChArUco markers with less than two pixels a bit.

mod april_grid;
#[cfg(feature = "opencv")]
mod by_opencv;
mod charuco;
mod chessboard;
#[cfg(test)]
mod drawn;
mod lattice;
mod sub_pixel;
mod tag;
mod tag_seeds;
#[cfg(test)]
mod tests;

use anyhow::Result;
use calib::{Board, Corner};
use calib_targets_chessboard::GrayImageView;
use geometry::GrayImage;

/// Finds the corners of one board.
pub enum Detector {
    /// Of a chessboard.
    Chessboard(chessboard::Chessboard),
    /// Of a ChArUco board.
    Charuco(charuco::Charuco),
    /// Of a grid of AprilTags.
    AprilGrid(april_grid::AprilGrid),
}

impl Detector {
    /// A detector of this board; of a chessboard it looks `window` pixels around each corner.
    ///
    /// # Errors
    /// When the board's dictionary is not known, or has fewer markers than the board.
    pub fn new(board: &Board, window: Option<u16>) -> Result<Self> {
        Ok(match board {
            Board::Chessboard { columns, rows, .. } => {
                Self::Chessboard(chessboard::Chessboard { columns: *columns, rows: *rows, window })
            }
            Board::Charuco { .. } => Self::Charuco(charuco::Charuco::new(board)?),
            Board::AprilGrid { columns, rows, .. } => {
                Self::AprilGrid(april_grid::AprilGrid::new(board, *columns, *rows)?)
            }
        })
    }

    /// The corners in an image, none when there is no board.
    ///
    /// With the feature `opencv` OpenCV looks for a board that is not found otherwise.
    ///
    /// # Errors
    /// When OpenCV fails, where it is there.
    pub fn corners(&self, image: &GrayImage) -> Result<Vec<Corner>> {
        let found = match self {
            Self::Chessboard(detector) => detector.corners(image),
            Self::Charuco(detector) => detector.corners(image),
            Self::AprilGrid(detector) => detector.corners(image),
        };
        #[cfg(feature = "opencv")]
        let found = if found.is_empty() { by_opencv::corners(self, image)? } else { found };
        Ok(inside(found, image))
    }

    /// What these images, in which no board was found, show instead; for people.
    pub fn what_else(&self, images: &[GrayImage]) -> String {
        match self {
            Self::Chessboard(detector) => detector.what_else(images),
            Self::Charuco(detector) => detector.what_else(images),
            Self::AprilGrid(detector) => detector.what_else(images),
        }
    }
}

/// Corners without those at the very border, which were completed from half of their surroundings.
fn inside(corners: Vec<Corner>, image: &GrayImage) -> Vec<Corner> {
    let inside = |corner: &Corner| image.contains(corner.pixel.x as f32, corner.pixel.y as f32, 3.0);
    corners.into_iter().filter(inside).collect()
}

/// The image as the detectors take it.
fn view(image: &GrayImage) -> GrayImageView<'_> {
    GrayImageView { width: image.width(), height: image.height(), data: image.data() }
}

/// The image as in a mirror.
fn mirrored(image: &GrayImage) -> GrayImage {
    let mut other = image.clone();
    let width = image.width().max(1);
    other.data_mut().chunks_mut(width).for_each(|row| row.reverse());
    other
}
