//! The calibration of a run, and what it does to each image.

use crate::recording::CalibrationFiles;
use crate::sources::{FoundCalibration, SourceInfo};
use anyhow::{Context, Result, bail};
use calib::read_camera;
use geometry::{Camera, Crop, GrayImage, PhotometricCalibration, Pinhole, Undistorter};
use std::path::PathBuf;

/// What the user says about the camera.
#[derive(Clone, Debug, Default)]
pub struct CameraOptions {
    /// Calibration file, instead of the one that came with the recording.
    pub calibration: Option<PathBuf>,
    /// Inverse response of the sensor.
    pub response: Option<PathBuf>,
    /// Vignette of the lens.
    pub vignette: Option<PathBuf>,
}

/// What is done to an image before tracking.
pub struct ImageCorrection {
    photometric: Option<PhotometricCalibration>,
    undistorter: Undistorter,
    /// Where the calibration came from, for people.
    origin: String,
}

impl ImageCorrection {
    /// The camera of the corrected images.
    pub fn camera(&self) -> Pinhole {
        *self.undistorter.pinhole()
    }

    /// Where the calibration came from, for people.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// Corrects an image, or says why it does not fit.
    pub fn apply(&self, mut image: GrayImage) -> Result<GrayImage, String> {
        if let Some(photometric) = &self.photometric {
            photometric.apply_in_place(&mut image).map_err(|error| error.to_string())?;
        }
        self.undistorter.undistort(&image).map_err(|error| error.to_string())
    }
}

/// The correction for a recording: from the user's calibration if there is one, else from what came with it.
///
/// # Errors
/// When there is no calibration, or it cannot be used.
pub fn correction(options: &CameraOptions, info: &SourceInfo) -> Result<ImageCorrection> {
    let (camera, crop, origin) = match (&options.calibration, &info.calibration) {
        (Some(path), _) | (None, Some(FoundCalibration::File(path))) => {
            let file = read_camera(path)?;
            (file.camera, file.crop.unwrap_or_default(), path.display().to_string())
        }
        (None, Some(FoundCalibration::Inside { origin, camera })) => {
            (Camera::clone(camera), Crop::default(), origin.clone())
        }
        (None, Some(FoundCalibration::Recorded { origin, files })) if files.camera.is_some() => {
            let Some(file) = files.camera().with_context(|| origin.clone())? else {
                bail!("{origin}: no camera")
            };
            (file.camera, file.crop.unwrap_or_default(), origin.clone())
        }
        (None, Some(FoundCalibration::Unusable { origin, reason })) => {
            bail!("{origin}: the calibration cannot be used: {reason}\nhint: give one with --calib FILE")
        }
        (None, None | Some(FoundCalibration::Recorded { .. })) => bail!(
            "{}: no calibration came with this recording\nhint: give one with --calib FILE (a camera.yaml with \
             model, width, height, fx, fy, cx, cy, distortion; Kalibr, ROS, OpenCV and DSO files do too)",
            info.path.display()
        ),
    };
    Ok(ImageCorrection {
        photometric: CalibrationFiles::gather_photometric(options, info)?.photometric()?,
        undistorter: Undistorter::new(&camera, crop).with_context(|| origin.clone())?,
        origin,
    })
}
