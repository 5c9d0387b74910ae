//! Calibrates cameras; reads and writes their calibrations.
//!
//! [`read_camera`] takes any of the forms in [`CameraFormat`] and tells them apart by content;
//! [`write_camera`] writes loopbox's own. [`read_photometric`] reads response and vignette.
//!
//! [`calibrate`] calibrates a camera from the corners of a [`Board`] seen in several views; [`coach`] says what views
//! are missing. Finding corners in images is left to the caller.

mod board;
mod camera_file;
mod camera_info;
pub mod coach;
mod error;
mod formats;
mod node;
mod photometric;
mod response;
mod sharpness;
mod solver;
mod vignette;

pub use board::{Board, BoardError};
pub use camera_file::choice::CameraHint;
pub use camera_file::{
    CalibrationFile, CameraFormat, format_camera, parse_camera, parse_camera_of, read_body_from_camera,
    read_camera, read_camera_of, write_camera,
};
pub use camera_info::{CameraInfo, Imagery, Roi};
pub use error::CalibError;
pub use photometric::{parse_photometric, read_photometric};
pub use response::{Response, ResponseError, estimate_response, format_response};
pub use sharpness::edge_width;
pub use solver::{
    Calibration, Check, Corner, Estimate, FittedCorner, FittedView, LensModel, Refusal, SolverParams, View,
    calibrate, check, planar,
};
pub use vignette::{VignetteError, estimate_vignette};
