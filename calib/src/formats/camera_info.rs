//! ROS `camera_info`: the calibration file, and the message as ROS 1 and ROS 2 print it.

use super::{MODEL_FIX, Model, distortion_error};
use crate::CalibError;
use crate::camera_info::{CameraInfo, Imagery, Roi};
use crate::node::Node;
use geometry::Camera;

/// Reads size, camera matrix, model and terms, and what part of the sensor images show.
pub(crate) fn parse(root: &Node) -> Result<Camera, CalibError> {
    let fix = "give the size of the recording's images in pixels";
    let width = root.need(&["image_width", "width"], fix)?.pixels()?;
    let height = root.need(&["image_height", "height"], fix)?.pixels()?;
    let model = root.need(&["distortion_model"], MODEL_FIX)?;
    let matrix = root.need(&["camera_matrix", "K", "k"], "give the 3×3 camera matrix")?;
    let terms = root.need(&["distortion_coefficients", "D", "d"], "give the terms, or [] for none")?;
    let d = terms.numbers()?;
    let named = Model::of_camera_info(model.text()?, &d)
        .ok_or_else(|| model.bad(format!("unknown model \"{}\"", model.text().unwrap_or("")), MODEL_FIX))?;
    let distortion =
        named.padded_distortion(&d).map_err(|error| distortion_error(root.file, &terms.path, error))?;
    let k = matrix.exactly::<9>(super::opencv::MATRIX_FIX)?;
    if k == [0.0; 9] {
        return Err(matrix.bad(
            "it is zero, by which the message says that the camera is not calibrated".into(),
            "calibrate it, or leave the file out: then the lens is found from the images",
        ));
    }
    let info = CameraInfo { width: width as u32, height: height as u32, k: k.into(), ..part(root)? };
    if (info.binning, info.roi) == ((0, 0), Roi::default()) {
        return super::opencv::camera((width, height), &matrix, distortion);
    }
    let named = CameraInfo { model: model.text()?.into(), d, ..info };
    let camera = named.camera(Imagery::Raw, root.file)?;
    camera.ok_or_else(|| matrix.bad("it is zero".into(), "calibrate the camera"))
}

/// Binning and region of interest.
fn part(root: &Node) -> Result<CameraInfo, CalibError> {
    let number = |node: &Node, key: &str| match node.child(&[key]) {
        Some(value) => {
            let found = value.number()?;
            if found.fract() == 0.0 && (0.0..=65535.0).contains(&found) {
                return Ok(found as u32);
            }
            Err(value.bad(format!("{found} is no number of pixels"), "give pixels of the sensor"))
        }
        None => Ok(0),
    };
    let binning = (number(root, "binning_x")?, number(root, "binning_y")?);
    let plain = |(x, y): (u32, u32)| if x <= 1 && y <= 1 { (0, 0) } else { (x, y) };
    let roi = match root.child(&["roi"]).filter(Node::is_mapping) {
        Some(roi) => Roi {
            x: number(&roi, "x_offset")?,
            y: number(&roi, "y_offset")?,
            width: number(&roi, "width")?,
            height: number(&roi, "height")?,
        },
        None => Roi::default(),
    };
    let roi = if roi.width == 0 { Roi::default() } else { roi };
    Ok(CameraInfo { binning: plain(binning), roi, ..CameraInfo::default() })
}
