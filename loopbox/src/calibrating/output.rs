//! The files of a calibration: written beside their place and then moved there, all or none.

use super::summary::digits;
use anyhow::{Context, Result};
use calib::{Board, Calibration, format_camera};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A file that is being written.
pub struct Output {
    path: PathBuf,
    partial: PathBuf,
}

impl Output {
    /// Makes sure before the work that the file can be written; what is there stays until [`commit`](Self::commit).
    ///
    /// # Errors
    /// When it cannot.
    pub fn prepare(path: &Path) -> Result<Self> {
        let mut partial = path.to_owned().into_os_string();
        partial.push(".tmp");
        let partial = PathBuf::from(partial);
        std::fs::write(&partial, b"").with_context(|| {
            format!(
                "{}: cannot be written\nhint: name a file in a folder that exists and can be written to",
                path.display()
            )
        })?;
        Ok(Self { path: path.to_owned(), partial })
    }

    /// Writes the content.
    ///
    /// # Errors
    /// When the disk is full, say.
    pub fn write(&self, content: &[u8]) -> Result<()> {
        std::fs::write(&self.partial, content)
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// When it cannot be moved.
    pub fn commit(self) -> Result<()> {
        std::fs::rename(&self.partial, &self.path)
            .with_context(|| format!("{}: cannot be written", self.path.display()))
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        // After a commit there is none.
        let _ = std::fs::remove_file(&self.partial);
    }
}

/// `camera.yaml` with the uncertainties as comments.
pub fn camera_text(board: &Board, calibration: &Calibration) -> String {
    let mut text = format_camera(&calibration.camera, None);
    let used = calibration.views.iter().filter(|view| view.rejected.is_none()).count();
    let _ = writeln!(text, "# loopbox calib --board {board} --model {}", calibration.model);
    let _ = writeln!(
        text,
        "# rms {:.4} px over {} corners of {used} views (root mean square of distances, as OpenCV counts)",
        calibration.rms, calibration.corner_count
    );
    for estimate in &calibration.estimates {
        let digits = digits(estimate.sigma);
        let _ = writeln!(text, "# {} ± {:.digits$}", estimate.name, estimate.sigma);
    }
    text
}
