//! Camera files in all their forms.

pub(crate) mod choice;

use crate::CalibError;
use crate::formats::{
    basalt, camchain, camera_info, colmap, kitti, loopbox, nerfstudio, opencv, orb_slam, svo, text, vins, xml,
};
use crate::node::{Document, Node};
use choice::{CameraHint, Named, choose};
use geometry::limits::check_image_size;
use geometry::{Camera, Crop, Pinhole, Se3};
use nalgebra::{Matrix3, Matrix4, UnitQuaternion};
use std::path::{Path, PathBuf};

/// The forms of camera files that are understood. In all but the relative numbers of [`LsdDso`](Self::LsdDso) and those of
/// [`Nerfstudio`](Self::Nerfstudio) and [`Colmap`](Self::Colmap), pixel centres lie at integers, as in loopbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraFormat {
    /// `camera.yaml`: `model width height fx fy cx cy distortion [fps]`.
    Loopbox,
    /// Kalibr's camchain.
    Kalibr,
    /// EuRoC's `sensor.yaml`: Kalibr's keys without `cam0`.
    Euroc,
    /// ROS `camera_info`, as calibration file or as printed message.
    RosCameraInfo,
    /// OpenCV's FileStorage, YAML or XML.
    OpenCv,
    /// Settings of ORB-SLAM2 and 3, OpenVSLAM and stella_vslam.
    OrbSlam,
    /// Cameras of VINS-Mono and VINS-Fusion (camodocal).
    Vins,
    /// Cameras of SVO (vikit, rpg_svo_pro) and maplab.
    Svo,
    /// Basalt's JSON.
    Basalt,
    /// `transforms.json` of nerfstudio and instant-ngp.
    Nerfstudio,
    /// COLMAP's `cameras.txt`.
    Colmap,
    /// KITTI's `calib.txt` and `calib_cam_to_cam.txt`.
    Kitti,
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

/// Reads a camera file that holds one camera.
///
/// # Errors
/// When it cannot be read, is in no known form, holds several cameras, lacks a key, or a number makes no sense.
pub fn read_camera(path: &Path) -> Result<CalibrationFile, CalibError> {
    read_camera_of(path, &CameraHint::default())
}

/// Reads a camera file, of several cameras the one that `hint` tells, or the one that is named behind the path: `chain.yaml:cam1`.
///
/// # Errors
/// As [`read_camera`], and when nothing tells which camera it is.
pub fn read_camera_of(path: &Path, hint: &CameraHint) -> Result<CalibrationFile, CalibError> {
    let (path, hint) = match named_behind(path) {
        Some((path, name)) => (path, CameraHint { name: Some(name), ..hint.clone() }),
        None => (path.to_owned(), hint.clone()),
    };
    let file = path.display().to_string();
    let bytes = std::fs::read(&path).map_err(|source| CalibError::Read { file: file.clone(), source })?;
    let text = String::from_utf8(bytes).map_err(|_| CalibError::UnknownForm { file: file.clone() })?;
    parse_camera_of(&text, &file, &hint)
}

/// The file and the camera of `FILE:CAMERA`, where that is no file itself.
fn named_behind(path: &Path) -> Option<(PathBuf, String)> {
    let (file, name) = path.to_str().filter(|_| !path.exists())?.rsplit_once(':')?;
    let is_name = !name.is_empty() && Path::new(file).is_file();
    is_name.then(|| (PathBuf::from(file), name.to_owned()))
}

/// Reads a camera file that holds one camera from its text; `name` stands for the file in messages.
///
/// # Errors
/// As [`read_camera`].
pub fn parse_camera(text: &str, name: &str) -> Result<CalibrationFile, CalibError> {
    parse_camera_of(text, name, &CameraHint::default())
}

/// The same, of several cameras the one that `hint` tells.
///
/// # Errors
/// As [`read_camera_of`].
pub fn parse_camera_of(text: &str, name: &str, hint: &CameraHint) -> Result<CalibrationFile, CalibError> {
    let file = parse(text, name, hint)?;
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
fn parse(text: &str, name: &str, hint: &CameraHint) -> Result<CalibrationFile, CalibError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text::is_text_form(text) {
        return text::parse(text, name);
    }
    if colmap::is_form(text) {
        let camera = colmap::parse(text, name, hint)?;
        return Ok(CalibrationFile { camera, crop: None, fps: None, format: CameraFormat::Colmap });
    }
    if kitti::is_form(text) {
        let camera = kitti::parse(text, name, hint)?;
        return Ok(CalibrationFile { camera, crop: None, fps: None, format: CameraFormat::Kitti });
    }
    let is_xml = xml::is_xml(text);
    // OpenCV's header is no YAML directive; as a comment it keeps the line numbers.
    let opencv_header = is_xml || text.starts_with("%YAML:");
    let yaml = match (is_xml, opencv_header) {
        (true, _) => xml::to_yaml(text, name)?,
        (false, true) => format!("#{text}"),
        // JSON may be indented by tabs.
        (false, false) if text.trim_start().starts_with('{') => text.replace('\t', " "),
        (false, false) => text.to_string(),
    };
    let document = Document::parse(name, &yaml)?;
    let root = document.root();
    let format = detect(&root, opencv_header).ok_or(CalibError::UnknownForm { file: name.into() })?;
    let (camera, fps) = match format {
        CameraFormat::Loopbox => loopbox::parse(&root)?,
        CameraFormat::Kalibr => chained(&root, hint)?,
        CameraFormat::Euroc => camchain::parse(&root)?,
        CameraFormat::RosCameraInfo => (camera_info::parse(&root)?, None),
        CameraFormat::OpenCv => (opencv::parse(&root, hint)?, None),
        CameraFormat::OrbSlam => orb_slam::parse(&root, hint)?,
        CameraFormat::Vins => (vins::parse(&root)?, None),
        CameraFormat::Svo => (svo::parse(&root, hint)?, None),
        CameraFormat::Basalt => (basalt::parse(&root, hint)?, None),
        CameraFormat::Nerfstudio => (nerfstudio::parse(&root)?, None),
        CameraFormat::LsdDso | CameraFormat::Colmap | CameraFormat::Kitti => {
            return Err(CalibError::UnknownForm { file: name.into() });
        }
    };
    Ok(CalibrationFile { camera, crop: None, fps, format })
}

/// The camera of a camchain that `hint` tells.
fn chained(root: &Node, hint: &CameraHint) -> Result<(Camera, Option<f64>), CalibError> {
    /// Rigs of more cameras than that are none.
    const MOST: usize = 32;
    let cameras: Vec<(usize, Node)> = (0..MOST)
        .filter_map(|index| Some((index, root.child(&[&format!("cam{index}")])?)))
        .filter(|(_, camera)| camera.child(&["intrinsics"]).is_some())
        .collect();
    let named: Vec<Named> = cameras
        .iter()
        .map(|(index, camera)| {
            let topic = camera.child(&["rostopic"]).and_then(|topic| topic.text().ok()).map(str::to_owned);
            Named { topic, ..Named::numbered(None, *index) }
        })
        .collect();
    let chosen = choose(root.file, &named, hint)?;
    match cameras.get(chosen) {
        Some((_, camera)) => camchain::parse(camera),
        None => camchain::parse(&root.need(&["cam0"], "give the camera's keys there")?),
    }
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
    // OpenVINS and others put a camchain into other files under the same names.
    if root.child(&["cam0", "cam1"]).is_some_and(|camera| camera.is_mapping()) {
        Some(CameraFormat::Kalibr)
    } else if basalt::is_form(root) {
        Some(CameraFormat::Basalt)
    } else if svo::is_form(root) {
        Some(CameraFormat::Svo)
    } else if orb_slam::is_form(root) {
        Some(CameraFormat::OrbSlam)
    } else if vins::is_form(root) {
        Some(CameraFormat::Vins)
    } else if nerfstudio::is_form(root) {
        Some(CameraFormat::Nerfstudio)
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
mod others;
#[cfg(test)]
mod tests;
