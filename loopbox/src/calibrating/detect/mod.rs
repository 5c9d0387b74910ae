//! Corners of calibration boards in images, by OpenCV.

mod april_grid;
mod charuco;
mod chessboard;
mod sub_pixel;

use anyhow::Result;
use calib::{Board, Corner};
use geometry::GrayImage;
use opencv::boxed_ref::BoxedRef;
use opencv::core::Mat;
use opencv::prelude::*;

/// Finds the corners of one board.
pub enum Detector {
    Chessboard(chessboard::Chessboard),
    Charuco(charuco::Charuco),
    AprilGrid(april_grid::AprilGrid),
}

impl Detector {
    /// A detector of this board; of a chessboard it looks `window` pixels around each corner.
    ///
    /// # Errors
    /// When OpenCV does not know the board's dictionary, or has fewer markers than the board.
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
    /// # Errors
    /// When OpenCV fails.
    pub fn corners(&self, image: &GrayImage) -> Result<Vec<Corner>> {
        let found = match self {
            Self::Chessboard(detector) => detector.corners(image)?,
            Self::Charuco(detector) => detector.corners(image)?,
            Self::AprilGrid(detector) => detector.corners(image)?,
        };
        // A corner at the very border was completed from half of its surroundings.
        Ok(found
            .into_iter()
            .filter(|corner| image.contains(corner.pixel.x as f32, corner.pixel.y as f32, 3.0))
            .collect())
    }

    /// What these images, in which no board was found, show instead; for people.
    ///
    /// # Errors
    /// When OpenCV fails.
    pub fn what_else(&self, images: &[GrayImage]) -> Result<String> {
        match self {
            Self::Chessboard(detector) => detector.what_else(images),
            Self::Charuco(detector) => detector.what_else(images),
            Self::AprilGrid(detector) => detector.what_else(images),
        }
    }
}

/// OpenCV's view of an image's pixels.
fn mat(image: &GrayImage) -> opencv::Result<Mat> {
    let flat = Mat::from_slice(image.data())?;
    let shaped: BoxedRef<Mat> = flat.reshape(1, image.height() as i32)?;
    shaped.try_clone()
}

/// The image as in a mirror.
fn mirrored(image: &GrayImage) -> GrayImage {
    let mut other = image.clone();
    let width = image.width().max(1);
    other.data_mut().chunks_mut(width).for_each(|row| row.reverse());
    other
}
