//! Calibration of a camera from corners of a flat board seen in several views.
//!
//! [`calibrate`] is the way through: a start , bundle adjustment , corners and views that do
//! not fit set aside, the uncertainty of every parameter , and the judgement whether the views
//! determine the camera.

mod bundle;
mod calibration;
mod check;
mod initial;
mod model;
mod pipeline;
pub mod planar;
mod refusal;
#[cfg(test)]
pub(crate) mod tests;
mod uncertainty;

pub use calibration::{Calibration, FittedCorner, FittedView};
pub use check::{Check, check};
pub use model::LensModel;
pub use pipeline::{SolverParams, calibrate};
pub use refusal::Refusal;
pub use uncertainty::Estimate;

use nalgebra::Vector2;

/// A corner of the board as it was found in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Its number on the board, see [`Board::points`](crate::Board::points).
    pub index: usize,
    /// Where it was found, pixels; pixel centres at integers.
    pub pixel: Vector2<f64>,
}

/// The corners found in one image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Name of the image, for people.
    pub name: String,
    /// The corners, each number at most once.
    pub corners: Vec<Corner>,
}
