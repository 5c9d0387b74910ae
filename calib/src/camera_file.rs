//! Camera files in all their forms.

use crate::CalibError;
use crate::formats::{camchain, camera_info, loopbox, opencv, text};
use crate::node::{Document, Node};
use geometry::limits::check_image_size;
use geometry::{Camera, Crop, Pinhole, Se3};
use nalgebra::{Matrix3, Matrix4, UnitQuaternion};
use std::path::Path;

/// The forms of camera files that are understood. In all but the relative numbers of
/// [`LsdDso`](Self::LsdDso), pixel centres lie at integers, as in loopbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraFormat {
    /// `camera.yaml`: `model width height fx fy cx cy distortion [fps]`.
    Loopbox,
    /// Kalibr's camchain; its `cam0`.
    Kalibr,
    /// EuRoC's `sensor.yaml`: Kalibr's keys without `cam0`.
    Euroc,
    /// ROS `camera_info`, as calibration file or as printed message.
    RosCameraInfo,
    /// OpenCV's FileStorage; the first camera.
    OpenCv,
    /// Four lines as LSD-SLAM and DSO read them.
    LsdDso,
}

/// What a camera file says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationFile {
    /// The camera.
    pub camera: Camera,
    /// The output picture that the file asks for (LSD/DSO form only).
    pub crop: Option<Crop>,
    /// Frames per second.
    pub fps: Option<f64>,
    /// The form of the file.
    pub format: CameraFormat,
}

/// Reads a camera file.
///
/// # Errors
/// When it cannot be read, is in no known form, lacks a key, or a number makes no sense.
pub fn read_camera(path: &Path) -> Result<CalibrationFile, CalibError> {
    let file = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| CalibError::Read { file: file.clone(), source })?;
    let text = String::from_utf8(bytes).map_err(|_| CalibError::UnknownForm { file: file.clone() })?;
    parse_camera(&text, &file)
}

/// Reads a camera file from its text; `name` stands for the file in messages.
///
/// # Errors
/// As [`read_camera`].
pub fn parse_camera(text: &str, name: &str) -> Result<CalibrationFile, CalibError> {
    let file = parse(text, name)?;
    let &Pinhole { width, height, .. } = file.camera.intrinsics();
    check_image_size(width, height).map_err(|problem| CalibError::BadValue {
        file: name.into(),
        key: "width, height".into(),
        problem,
        fix: "give the size of the recording's images in pixels".into(),
    })?;
    Ok(file)
}

/// Reads a camera file of any form.
fn parse(text: &str, name: &str) -> Result<CalibrationFile, CalibError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text::is_text_form(text) {
        return text::parse(text, name);
    }
    // OpenCV's header is no YAML directive; as a comment it keeps the line numbers.
    let opencv_header = text.starts_with("%YAML:");
    let commented = if opencv_header { format!("#{text}") } else { text.to_string() };
    let document = Document::parse(name, &commented)?;
    let root = document.root();
    let format = detect(&root, opencv_header).ok_or(CalibError::UnknownForm { file: name.into() })?;
    let (camera, fps) = match format {
        CameraFormat::Loopbox => loopbox::parse(&root)?,
        CameraFormat::Kalibr => camchain::parse(&root.need(&["cam0"], "give the camera's keys there")?)?,
        CameraFormat::Euroc => camchain::parse(&root)?,
        CameraFormat::RosCameraInfo => (camera_info::parse(&root)?, None),
        CameraFormat::OpenCv => (opencv::parse(&root)?, None),
        CameraFormat::LsdDso => return Err(CalibError::UnknownForm { file: name.into() }),
    };
    Ok(CalibrationFile { camera, crop: None, fps, format })
}

/// The pose of the camera on the body that EuRoC's `sensor.yaml` gives as `T_BS`, `body_from_camera`; `None` where the file
/// has none.
///
/// # Errors
/// When the file cannot be read, is no YAML, or `T_BS` is not a rigid transform.
pub fn read_body_from_camera(path: &Path) -> Result<Option<Se3>, CalibError> {
    let file = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|source| CalibError::Read { file: file.clone(), source })?;
    let document = Document::parse(&file, &text)?;
    let Some(node) = document.root().child(&["T_BS"]) else { return Ok(None) };
    let fix = "give the 16 numbers of a 4×4 matrix, row by row";
    let matrix = Matrix4::from_row_slice(&node.exactly::<16>(fix)?);
    let rotation: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into();
    let error = (rotation.transpose() * rotation - Matrix3::identity()).abs().max();
    if error > 1e-3 || rotation.determinant() < 0.0 {
        return Err(node.bad("its left 3×3 is not a rotation".into(), fix));
    }
    let translation = matrix.fixed_view::<3, 1>(0, 3).into_owned();
    Ok(Some(Se3::new(UnitQuaternion::from_matrix(&rotation), translation)))
}

/// The text of a camera in loopbox's own form; [`parse_camera`] gives back the same camera.
pub fn format_camera(camera: &Camera, fps: Option<f64>) -> String {
    loopbox::format(camera, fps)
}

/// Writes a camera in loopbox's own form.
///
/// # Errors
/// When the file cannot be written.
pub fn write_camera(path: &Path, camera: &Camera, fps: Option<f64>) -> Result<(), CalibError> {
    std::fs::write(path, format_camera(camera, fps))
        .map_err(|source| CalibError::Write { file: path.display().to_string(), source })
}

/// The form of a YAML file, from the keys that only it has.
fn detect(root: &Node, opencv_header: bool) -> Option<CameraFormat> {
    let has = |names: &[&str]| root.child(names).is_some();
    if !root.is_mapping() {
        return None;
    }
    if has(&["cam0"]) {
        Some(CameraFormat::Kalibr)
    } else if has(&["intrinsics", "distortion_coeffs", "T_BS"]) {
        Some(CameraFormat::Euroc)
    } else if !opencv_header && has(&["distortion_model"]) {
        Some(CameraFormat::RosCameraInfo)
    } else if opencv_header || has(opencv::CAMERA_MATRIX) {
        Some(CameraFormat::OpenCv)
    } else if has(&["model", "fx", "fy", "cx", "cy"]) {
        Some(CameraFormat::Loopbox)
    } else {
        None
    }
}

#[cfg(test)]
mod tests;
