//! ROS `camera_info`: the calibration file, and the message as ROS 1 and ROS 2 print it.

use super::{MODEL_FIX, Model, distortion_error};
use crate::CalibError;
use crate::node::Node;
use geometry::Camera;

/// Reads size, camera matrix, model and terms.
pub(crate) fn parse(root: &Node) -> Result<Camera, CalibError> {
    let fix = "give the size of the recording's images in pixels";
    let width = root.need(&["image_width", "width"], fix)?.pixels()?;
    let height = root.need(&["image_height", "height"], fix)?.pixels()?;
    let model = Model::read(&root.need(&["distortion_model"], MODEL_FIX)?)?;
    let matrix = root.need(&["camera_matrix", "K", "k"], "give the 3×3 camera matrix")?;
    let terms = root.need(&["distortion_coefficients", "D", "d"], "give the terms, or [] for none")?;
    let distortion = model
        .padded_distortion(&terms.numbers()?)
        .map_err(|error| distortion_error(root.file, &terms.path, error))?;
    super::opencv::camera((width, height), &matrix, distortion)
}
