//! OpenCV's FileStorage YAML, as its calibration samples and many programs write it.

use super::{Model, distortion_error};
use crate::CalibError;
use crate::node::Node;
use geometry::{Camera, Distortion, Pinhole};

/// The names under which programs put the camera matrix (`M1`: the left one of a stereo pair).
pub(crate) const CAMERA_MATRIX: &[&str] =
    &["camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K", "M1", "K1", "intrinsics_matrix"];

/// The same for the distortion terms.
const DISTORTION: &[&str] = &[
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distCoeffs",
    "DistortionCoefficients",
    "dist_coeffs",
    "distortion",
    "D",
    "D1",
];

/// Reads size, matrix and terms. Terms are radial-tangential unless `fisheye_model` is set.
pub(crate) fn parse(root: &Node) -> Result<Camera, CalibError> {
    let matrix = root.need(CAMERA_MATRIX, "give the 3×3 camera matrix")?;
    let terms = root.need(DISTORTION, "give the distortion coefficients, or [] for none")?;
    let size = size(root)?;
    let fisheye = match root.child(&["fisheye_model", "fisheye"]) {
        Some(node) => node.number()? != 0.0,
        None => false,
    };
    let model = if fisheye { Model::KannalaBrandt } else { Model::RadTan };
    let distortion = model
        .padded_distortion(&terms.numbers()?)
        .map_err(|error| distortion_error(root.file, &terms.path, error))?;
    camera(size, &matrix, distortion)
}

/// The image size, as two keys or as a pair.
fn size(root: &Node) -> Result<(usize, usize), CalibError> {
    if let Some(pair) = root.child(&["image_size", "imageSize", "Image_Size", "size"]) {
        return pair.size();
    }
    let fix = "this file does not tell the image size: add `image_width` and `image_height`, in pixels";
    let width = root.need(&["image_width", "image_Width", "imageWidth", "width"], fix)?.pixels()?;
    let height = root.need(&["image_height", "image_Height", "imageHeight", "height"], fix)?.pixels()?;
    Ok((width, height))
}

/// A camera from a row-major 3×3 matrix `[fx s cx; 0 fy cy; 0 0 1]` with no skew.
pub(crate) fn camera(
    (width, height): (usize, usize),
    matrix: &Node,
    distortion: Distortion,
) -> Result<Camera, CalibError> {
    let fix = "give the 3×3 camera matrix row by row: fx 0 cx 0 fy cy 0 0 1";
    let [fx, skew, cx, zero, fy, cy, a, b, one] = matrix.exactly(fix)?;
    if [skew, zero, a, b] != [0.0; 4] || one != 1.0 {
        return Err(matrix.bad("not the matrix of a camera with rectangular pixels".into(), fix));
    }
    let key_of = |key: &str| match key {
        "width" => "image_width".into(),
        key => format!("{} ({key})", matrix.path),
    };
    Camera::new(Pinhole { width, height, fx, fy, cx, cy }, distortion)
        .map_err(|error| CalibError::from_camera(matrix.file, key_of, error))
}
