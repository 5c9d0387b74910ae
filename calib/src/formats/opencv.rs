//! OpenCV's FileStorage YAML, as its calibration samples and many programs write it.

use super::{Model, distortion_error};
use crate::CalibError;
use crate::camera_file::choice::{CameraHint, Named, choose};
use crate::node::Node;
use geometry::{Camera, Distortion, Pinhole};

/// The names under which programs put the camera matrix (`M1`: the left one of a stereo pair).
pub(crate) const CAMERA_MATRIX: &[&str] = &[
    "camera_matrix",
    "Camera_Matrix",
    "cameraMatrix",
    "CameraMatrix",
    "K",
    "M1",
    "K1",
    "cameraMatrix1",
    "intrinsics_matrix",
];

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
    "distCoeffs1",
];

/// The matrix and the terms of the right camera of a stereo pair.
const RIGHT: [&[&str]; 2] = [&["M2", "K2", "cameraMatrix2"], &["D2", "distCoeffs2"]];

/// Reads size, matrix and terms, of a stereo pair those of the side that `hint` tells. Terms are radial-tangential unless
/// `fisheye_model` is set.
pub(crate) fn parse(root: &Node, hint: &CameraHint) -> Result<Camera, CalibError> {
    let is_pair = root.child(RIGHT[0]).is_some() && root.child(RIGHT[1]).is_some();
    let sides = [Named::side("left", false), Named::side("right", true)];
    let is_right = choose(root.file, if is_pair { &sides } else { &sides[..1] }, hint)? == 1;
    let [matrix, terms] = if is_right { RIGHT } else { [CAMERA_MATRIX, DISTORTION] };
    let matrix = root.need(matrix, "give the 3×3 camera matrix")?;
    let terms = root.need(terms, "give the distortion coefficients, or [] for none")?;
    let size = size(root)?;
    let fisheye = root.child(&["fisheye_model", "fisheye"]).is_some_and(|node| node.is_true());
    let model = if fisheye { Model::KannalaBrandt } else { Model::RadTan };
    let distortion = model
        .padded_distortion(&terms.numbers()?)
        .map_err(|error| distortion_error(root.file, &terms.path, error))?;
    camera(size, &matrix, distortion)
}

/// The image size, as two keys or as a pair.
fn size(root: &Node) -> Result<(usize, usize), CalibError> {
    if let Some(pair) = root.child(&["image_size", "imageSize", "Image_Size", "image_Size", "size"]) {
        return pair.size();
    }
    let fix = "this file does not tell the image size: add `image_width` and `image_height`, in pixels";
    let width =
        root.need(&["image_width", "image_Width", "Image_Width", "imageWidth", "width"], fix)?.pixels()?;
    let height = root
        .need(&["image_height", "image_Height", "Image_Height", "imageHeight", "height"], fix)?
        .pixels()?;
    Ok((width, height))
}

/// What to give as a camera matrix.
pub(crate) const MATRIX_FIX: &str = "give the 3×3 camera matrix row by row: fx 0 cx 0 fy cy 0 0 1";

/// A camera from a row-major 3×3 matrix `[fx s cx; 0 fy cy; 0 0 1]` with no skew.
pub(crate) fn camera(
    (width, height): (usize, usize),
    matrix: &Node,
    distortion: Distortion,
) -> Result<Camera, CalibError> {
    let fix = MATRIX_FIX;
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
