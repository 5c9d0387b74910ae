//! Reads and writes camera calibrations.
//!
//! [`read_camera`] takes any of the forms in [`CameraFormat`] and tells them apart by content;
//! [`write_camera`] writes loopbox's own. [`read_photometric`] reads response and vignette.

mod camera_file;
mod error;
mod formats;
mod node;
mod photometric;

pub use camera_file::{
    CalibrationFile, CameraFormat, format_camera, parse_camera, read_camera, write_camera,
};
pub use error::CalibError;
pub use photometric::{parse_photometric, read_photometric};
