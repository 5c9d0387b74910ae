//! What can be wrong with a calibration.

use geometry::{CameraError, PhotometricError};
use std::io;
use thiserror::Error;

/// Why a calibration could not be read or written; every message names the file and how to mend it.
#[derive(Debug, Error)]
pub enum CalibError {
    /// The file cannot be read.
    #[error("{file}: cannot be read ({source}); check the path and its permissions")]
    Read {
        /// The file.
        file: String,
        /// What the system says.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("{file}: cannot be written ({source}); check that its folder exists and has space")]
    Write {
        /// The file.
        file: String,
        /// What the system says.
        source: io::Error,
    },
    /// The file is no YAML.
    #[error("{file}: not valid YAML ({message}); correct that line, or write the calibration anew")]
    Syntax {
        /// The file.
        file: String,
        /// What the parser says, with line and column.
        message: String,
    },
    /// The file is in no known form.
    #[error(
        "{file}: not a camera calibration in a known form; give a camera.yaml (model, width, height, fx, \
         fy, cx, cy, distortion), a Kalibr camchain, a ROS camera_info, a YAML or XML of OpenCV, a YAML of EuRoC, \
         ORB-SLAM, stella_vslam, VINS or SVO, Basalt's JSON, nerfstudio's transforms.json, COLMAP's cameras.txt, KITTI's calib.txt or \
         calib_cam_to_cam.txt, or an \
         LSD/DSO text file"
    )]
    UnknownForm {
        /// The file.
        file: String,
    },
    /// There are several cameras in it.
    #[error(
        "{file}: it holds several cameras ({names}), and nothing tells which took these images; name it, as {example}"
    )]
    WhichCamera {
        /// The file.
        file: String,
        /// What the cameras are called.
        names: String,
        /// How to name one.
        example: String,
    },
    /// A key is missing.
    #[error("{file}: the key `{key}` is missing; {fix}")]
    MissingKey {
        /// The file.
        file: String,
        /// Path of the key.
        key: String,
        /// How to mend it.
        fix: String,
    },
    /// A value is wrong.
    #[error("{file}: `{key}`: {problem}; {fix}")]
    BadValue {
        /// The file.
        file: String,
        /// Path of the key, or the line of a text file.
        key: String,
        /// What is wrong.
        problem: String,
        /// How to mend it.
        fix: String,
    },
    /// The vignette is no image that can be decoded.
    #[error("{file}: not an image that can be read ({message}); give the vignette as 8- or 16-bit PNG")]
    Image {
        /// The file.
        file: String,
        /// What the decoder says.
        message: String,
    },
    /// The numbers of a photometric calibration do not make sense.
    #[error("{file}: {source}; calibrate again, or run without photometric calibration")]
    Photometric {
        /// The file.
        file: String,
        /// What is wrong.
        source: PhotometricError,
    },
}

impl CalibError {
    /// Puts the file and key to a refusal of [`geometry::Camera`]; `key_of` names the file's key for
    /// `width`, `fx`, `fy`, `cx`, `cy` or `distortion`.
    pub(crate) fn from_camera(file: &str, key_of: impl Fn(&str) -> String, error: CameraError) -> Self {
        let (name, fix) = match error {
            CameraError::Size { .. } => ("width", "give the size of the recording's images in pixels"),
            CameraError::Focal { name, .. } => {
                (name, "give the focal length in pixels; it is about as long as the image is wide")
            }
            CameraError::PrincipalPoint { name, .. } => (
                name,
                "give it in pixels from the centre of the upper left pixel, and check that image size and \
                 calibration belong together",
            ),
            CameraError::TermCount { .. } => (
                "distortion",
                "give k1 k2 p1 p2 [k3 [k4 k5 k6]] for radtan, k1 k2 k3 k4 for kb4, ω for fov, none for pinhole",
            ),
            CameraError::Term { .. } => ("distortion", "calibrate again, or correct the number"),
        };
        Self::BadValue { file: file.into(), key: key_of(name), problem: error.to_string(), fix: fix.into() }
    }
}
