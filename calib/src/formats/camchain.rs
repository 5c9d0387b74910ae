//! Kalibr's camchain and EuRoC's `sensor.yaml`, which share their keys.

use super::loopbox::frame_rate;
use super::{Model, distortion_error, terms};
use crate::CalibError;
use crate::node::Node;
use geometry::{Camera, Pinhole};

/// Reads one camera: `intrinsics: [fx, fy, cx, cy]`, `resolution: [width, height]`, its models and terms.
pub(crate) fn parse(camera: &Node) -> Result<(Camera, Option<f64>), CalibError> {
    if let Some(projection) = camera.child(&["camera_model"])
        && projection.text()? != "pinhole"
    {
        let problem = format!("camera model \"{}\" is not supported", projection.text()?);
        return Err(
            projection.bad(problem, "calibrate with Kalibr's pinhole-radtan, pinhole-equi or pinhole-fov")
        );
    }
    let intrinsics = camera.need(&["intrinsics"], "give [fx, fy, cx, cy] in pixels")?;
    let [fx, fy, cx, cy] = intrinsics.exactly("give [fx, fy, cx, cy] in pixels")?;
    let (width, height) =
        camera.need(&["resolution"], "give [width, height] of the recording's images in pixels")?.size()?;
    let model = Model::read(&camera.need(&["distortion_model"], "give radtan, equidistant, fov or none")?)?;
    let (terms, terms_key) = terms(camera, &["distortion_coeffs", "distortion_coefficients"], model)?;
    let distortion =
        model.padded_distortion(&terms).map_err(|error| distortion_error(camera.file, &terms_key, error))?;
    let key_of = |key: &str| match ["fx", "fy", "cx", "cy"].iter().position(|name| *name == key) {
        Some(index) => format!("{}[{index}]", intrinsics.path),
        None => camera.path_of("resolution"),
    };
    let camera_model = Camera::new(Pinhole { width, height, fx, fy, cx, cy }, distortion)
        .map_err(|error| CalibError::from_camera(camera.file, key_of, error))?;
    let fps = camera.child(&["rate_hz"]).map(|node| frame_rate(&node)).transpose()?;
    Ok((camera_model, fps))
}
