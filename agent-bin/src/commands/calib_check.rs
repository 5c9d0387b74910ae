//! `loopbox calib --check`.

use anyhow::{Result, bail};
use calib::{Board, CalibrationFile, check};
use loopbox::calibrating::Collected;
use serde::Serialize;
use std::path::Path;

/// How well a calibration fits the images.
#[derive(Serialize)]
pub struct Checked {
    checked: String,
    /// Root mean square and median distance of the corners from where the camera would see them, pixels.
    rms: f64,
    median: f64,
    corners: usize,
    /// Images that show enough of the board, and given.
    used: usize,
    images: usize,
}

impl Checked {
    /// Checks the calibration in a file.
    ///
    /// # Errors
    /// When it is one of another image size or cannot be checked, or no image shows enough of the board.
    pub fn new(path: &Path, file: &CalibrationFile, board: &Board, collected: &Collected) -> Result<Self> {
        let intrinsics = file.camera.intrinsics();
        let (own, seen) = ((intrinsics.width, intrinsics.height), collected.size);
        if own != seen {
            bail!(
                "{}: is for images of {}×{} pixels, these have {}×{}\nhint: check it with images of its own mode",
                path.display(),
                own.0,
                own.1,
                seen.0,
                seen.1
            );
        }
        let found = check(board, &collected.views(), &file.camera)?;
        Ok(Self {
            checked: path.display().to_string(),
            rms: found.rms(),
            median: found.median(),
            corners: found.corner_count(),
            used: found.distances.iter().filter(|view| !view.is_empty()).count(),
            images: collected.given,
        })
    }

    /// For people.
    pub fn text(&self) -> String {
        format!(
            "rms   {:>10.3} px, median {:.3} px over {} corners of {} of {} images, with the board placed in each of them\n",
            self.rms, self.median, self.corners, self.used, self.images
        )
    }
}
