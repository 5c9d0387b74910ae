//! When a run finds its lens by itself, and what is said of it.

use super::{FoundLens, Recording, find_lens, find_live_lens};
use crate::run::outlook::{is_calibrated, uncalibrated};
use crate::run::{Progress, RunOptions};
use anyhow::Result;
use sources::{FoundCalibration, FrameSource, SourceInfo, Stop, sidecar_calibrations};

impl RunOptions {
    /// Where no calibration is given and none came with `source`, or what came is to be left aside, finds one from it, the
    /// `recording`; `fov` is its horizontal field of view in degrees, where that is known, and also leaves aside what came. Says so where the calibration of a public data set is taken.
    ///
    /// # Errors
    /// When the recording cannot be read, or says nothing about its lens.
    pub fn without_calibration(
        &mut self,
        source: &SourceInfo,
        recording: Recording,
        fov: Option<f64>,
        stop: &Stop,
        progress: &dyn Progress,
    ) -> Result<()> {
        let is_calibrated = is_calibrated(source, &self.camera, fov);
        if let (None, true, Some(FoundCalibration::Preset { origin, .. })) =
            (&self.camera.calibration, is_calibrated, &source.calibration)
        {
            progress.note(&format!("{}: {origin}; --calib FILE takes another", source.path.display()));
        }
        if is_calibrated {
            self.recording = Some(recording);
            return Ok(());
        }
        uncalibrated(source).iter().for_each(|text| progress.note(text));
        // Who says to leave aside what there is knows of it.
        if fov.is_none() && !self.camera.leave_found {
            sidecar_calibrations(source).iter().for_each(|text| progress.warn(text));
        }
        let lens = find_lens(&recording, fov, self, stop, progress)?;
        self.set_lens(source, lens, progress);
        Ok(())
    }

    /// Where no calibration is given for a live `source`, finds its lens from what it sees now; `fov` is its horizontal field of view in
    /// degrees, where that is known.
    ///
    /// # Errors
    /// When the source gives no image.
    pub fn live_without_calibration(
        &mut self,
        source: &mut dyn FrameSource,
        fov: Option<f64>,
        stop: &Stop,
        progress: &dyn Progress,
    ) -> Result<()> {
        if is_calibrated(source.info(), &self.camera, fov) {
            return Ok(());
        }
        let lens = find_live_lens(source, fov, self, stop, progress)?;
        let info = source.info().clone();
        self.set_lens(&info, lens, progress);
        Ok(())
    }

    /// Sets a lens that was found, and says what it is.
    fn set_lens(&mut self, source: &SourceInfo, lens: FoundLens, progress: &dyn Progress) {
        let message = format!("{}: {}", source.path.display(), lens.text());
        if lens.is_determined() {
            progress.note(&message)
        } else {
            progress.warn(&message)
        }
        self.lens = Some(lens);
    }
}
