//! Which calibration came with a recording, and from where.

use crate::camera_topics;
use crate::recording::CalibrationFiles;
use anyhow::Result;
use calib::{CameraInfo, Imagery};
use geometry::Camera;
use std::path::{Path, PathBuf};

/// A calibration that came with a recording.
#[derive(Clone, Debug)]
pub enum FoundCalibration {
    /// A file beside the frames.
    File(PathBuf),
    /// Read from the recording itself.
    Inside {
        /// Where in the recording, for people.
        origin: String,
        /// The camera.
        camera: Box<Camera>,
    },
    /// The one that is published for a data set, by the recording's layout.
    Preset {
        /// Which data set, for people.
        origin: String,
        /// The camera.
        camera: Box<Camera>,
    },
    /// Files of camera, response and vignette: those that loopbox put into its recording, or those beside the images.
    Recorded {
        /// Where, for people.
        origin: String,
        /// The files.
        files: Box<CalibrationFiles>,
    },
    /// The recording states that its camera is not calibrated.
    Uncalibrated {
        /// Where in the recording, for people.
        origin: String,
    },
    /// There is one in the recording, but it cannot be used.
    Unusable {
        /// Where in the recording, for people.
        origin: String,
        /// What is wrong with it.
        reason: String,
    },
}

impl FoundCalibration {
    /// What the first calibration messages of a topic gave, for the images of another: the first that is a calibration. Drivers may begin
    /// to send before they know theirs.
    pub(crate) fn of_messages(
        topic: &str,
        path: &Path,
        images: &str,
        messages: impl Iterator<Item = Result<CameraInfo>>,
    ) -> Option<Self> {
        /// A camera that is not calibrated after about a second is not.
        const LOOKED_AT: usize = 30;
        let mut first = None;
        for info in messages.take(LOOKED_AT) {
            match Self::of_message(topic, path, images, info) {
                found @ Self::Inside { .. } => return Some(found),
                other => drop(first.get_or_insert(other)),
            }
        }
        first
    }

    /// What the calibration message of a topic gave, for the images of another.
    pub(crate) fn of_message(topic: &str, path: &Path, images: &str, info: Result<CameraInfo>) -> Self {
        let rectified = camera_topics::is_rectified(images);
        let (imagery, part) =
            if rectified { (Imagery::Rectified, ", of rectified images") } else { (Imagery::Raw, "") };
        let origin = format!("topic {topic} of {}{part}", path.display());
        match info.and_then(|info| Ok(info.camera(imagery, "the message")?)) {
            Ok(Some(camera)) => Self::Inside { origin, camera: Box::new(camera) },
            Ok(None) => Self::Uncalibrated { origin },
            Err(error) => Self::Unusable { origin, reason: format!("{error:#}") },
        }
    }

    /// Where calibration topics may be the images', and nothing tells whether, or which.
    pub(crate) fn unclear(topics: &[String], path: &Path, images: &str) -> Self {
        let (what, reason) = match topics {
            [_] => ("topic", format!("nothing tells whether it is the camera's on {images}")),
            _ => ("topics", format!("nothing tells which of them is the camera's on {images}")),
        };
        Self::Unusable { origin: format!("{what} {} of {}", topics.join(", "), path.display()), reason }
    }
}
