//! What a calibration found.

use super::uncertainty::Estimate;
use super::{Corner, LensModel};
use geometry::{Camera, Se3};
use nalgebra::{DMatrix, Vector2};

/// A calibrated camera with its evidence.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The camera.
    pub camera: Camera,
    /// Its model.
    pub model: LensModel,
    /// The parameters with their uncertainty.
    pub estimates: Vec<Estimate>,
    /// Covariance of the parameters, in their order.
    pub covariance: DMatrix<f64>,
    /// Condition of the parameters' information, each scaled to one.
    pub condition: f64,
    /// Root mean square of the residuals' lengths, pixels, over the corners used (as OpenCV counts it).
    pub rms: f64,
    /// The same over all corners of all views with enough of them, those set aside too.
    pub rms_of_all: f64,
    /// The most flexible model of the same kind, by which wrong corners were told, and its root mean square, pixels: where
    /// that is far less, `model` does not fit the lens.
    pub most_flexible: (LensModel, f64),
    /// Number of corners used.
    pub corner_count: usize,
    /// What became of each view, in the order given.
    pub views: Vec<FittedView>,
}

/// What became of a view.
#[derive(Clone, Debug)]
pub struct FittedView {
    /// Name of the image.
    pub name: String,
    /// camera_from_board; `None` for a view that has none.
    pub pose: Option<Se3>,
    /// Root mean square residual over the corners used (of a view set aside: all), pixels.
    pub rms: f64,
    /// Its corners.
    pub corners: Vec<FittedCorner>,
    /// Why it was set aside.
    pub rejected: Option<String>,
}

/// What became of a corner.
#[derive(Clone, Copy, Debug)]
pub struct FittedCorner {
    /// As found.
    pub corner: Corner,
    /// Predicted minus found, pixels; NaN where the camera does not see it.
    pub residual: Vector2<f64>,
    /// Whether it was used.
    pub used: bool,
}
