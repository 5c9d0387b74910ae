//! The calibration that goes with a recording: the files as they were given, so that nothing is lost.

use crate::correction::CameraOptions;
use crate::{FoundCalibration, SourceInfo};
use anyhow::{Context, Result};
use calib::{CalibError, CalibrationFile, CameraHint, parse_camera, read_camera_of};
use geometry::PhotometricCalibration;
use std::path::{Path, PathBuf};

/// A file of a calibration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedFile {
    /// Its name, without folders.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl NamedFile {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, bytes })
    }

    fn as_pair(&self) -> (&str, &[u8]) {
        (&self.name, &self.bytes)
    }
}

/// The files of a camera's calibration.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CalibrationFiles {
    /// The camera, in any form that [`calib::parse_camera`] reads.
    pub camera: Option<NamedFile>,
    /// Inverse response of the sensor.
    pub response: Option<NamedFile>,
    /// Vignette of the lens.
    pub vignette: Option<NamedFile>,
}

impl CalibrationFiles {
    /// The files that a run over this source would use: the user's, else those that came with it.
    ///
    /// # Errors
    /// Names the file that cannot be read.
    pub fn gather(options: &CameraOptions, info: &SourceInfo) -> Result<Self> {
        let photometric = Self::gather_photometric(options, info)?;
        let camera = match (&options.calibration, &info.calibration) {
            (Some(path), _) | (None, Some(FoundCalibration::File(path))) => {
                Some(Self::camera_file(path, &info.camera)?)
            }
            (
                None,
                Some(FoundCalibration::Inside { camera, .. } | FoundCalibration::Preset { camera, .. }),
            ) => Some(NamedFile {
                name: "camera.yaml".into(),
                bytes: calib::format_camera(camera, None).into_bytes(),
            }),
            (None, Some(FoundCalibration::Recorded { files, .. })) => files.camera.clone(),
            (
                None,
                None | Some(FoundCalibration::Unusable { .. } | FoundCalibration::Uncalibrated { .. }),
            ) => None,
        };
        Ok(Self { camera, ..photometric })
    }

    /// The file of a camera as it is, or where it holds several the one that `hint` tells, in loopbox's own form.
    fn camera_file(path: &Path, hint: &CameraHint) -> Result<NamedFile> {
        let own = |file: CalibrationFile| NamedFile {
            name: "camera.yaml".into(),
            bytes: calib::format_camera(&file.camera, file.fps).into_bytes(),
        };
        if !path.exists() {
            return Ok(own(read_camera_of(path, hint)?));
        }
        let file = NamedFile::read(path)?;
        match parse_camera(&String::from_utf8_lossy(&file.bytes), &file.name) {
            Err(CalibError::WhichCamera { .. }) => Ok(own(read_camera_of(path, hint)?)),
            _ => Ok(file),
        }
    }

    /// As [`gather`](Self::gather), without the camera.
    ///
    /// # Errors
    /// Names the file that cannot be read.
    pub fn gather_photometric(options: &CameraOptions, info: &SourceInfo) -> Result<Self> {
        let recorded = match &info.calibration {
            Some(FoundCalibration::Recorded { files, .. }) => Self::clone(files),
            _ => Self::default(),
        };
        let own = |path: &Option<PathBuf>, recorded| -> Result<Option<NamedFile>> {
            path.as_deref().map(NamedFile::read).transpose().map(|file| file.or(recorded))
        };
        let response = own(&options.response, recorded.response)?;
        let vignette = own(&options.vignette, recorded.vignette)?;
        Ok(Self { camera: None, response, vignette })
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The camera, where there is one.
    ///
    /// # Errors
    /// When the file is no calibration.
    pub fn camera(&self) -> Result<Option<CalibrationFile>> {
        let Some(NamedFile { name, bytes }) = &self.camera else { return Ok(None) };
        Ok(Some(parse_camera(&String::from_utf8_lossy(bytes), name)?))
    }

    /// Response and vignette, where there are any.
    ///
    /// # Errors
    /// When a file is none.
    pub fn photometric(&self) -> Result<Option<PhotometricCalibration>> {
        if self.response.is_none() && self.vignette.is_none() {
            return Ok(None);
        }
        let part = NamedFile::as_pair;
        let (response, vignette) = (self.response.as_ref(), self.vignette.as_ref());
        Ok(Some(calib::parse_photometric(response.map(part), vignette.map(part))?))
    }
}
