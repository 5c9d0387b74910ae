//! The calibration of a run, and what it does to each image.

use crate::sources::{FoundCalibration, SourceInfo};
use anyhow::{Context, Result, bail};
use geometry::{GrayImage, Pinhole};
use std::path::Path;

/// What is done to an image before tracking.
pub struct ImageCorrection {
    camera: Pinhole,
}

impl ImageCorrection {
    /// The camera of the corrected images.
    pub fn camera(&self) -> Pinhole {
        self.camera
    }

    /// Corrects an image, or says why it does not fit.
    pub fn apply(&mut self, image: GrayImage) -> Result<GrayImage, String> {
        let (width, height) = (image.width(), image.height());
        if (width, height) != (self.camera.width, self.camera.height) {
            return Err(format!(
                "it is {width}×{height}, the calibration is for {}×{}",
                self.camera.width, self.camera.height
            ));
        }
        Ok(image)
    }
}

/// The correction for a recording: from `given` if there is one, else from what came with it.
pub fn correction(given: Option<&Path>, info: &SourceInfo) -> Result<ImageCorrection> {
    let path = match (given, &info.calibration) {
        (Some(path), _) => path,
        (None, Some(FoundCalibration::File(path))) => path,
        (None, None) => {
            bail!("{}: no calibration came with it\nhint: give one with --calib", info.path.display())
        }
    };
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let get = |key: &str| -> Result<f64> {
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))
            .with_context(|| format!("{}: no {key}", path.display()))?;
        Ok(line.trim().parse()?)
    };
    let camera = Pinhole {
        width: get("width")? as usize,
        height: get("height")? as usize,
        fx: get("fx")?,
        fy: get("fy")?,
        cx: get("cx")?,
        cy: get("cy")?,
    };
    Ok(ImageCorrection { camera })
}
