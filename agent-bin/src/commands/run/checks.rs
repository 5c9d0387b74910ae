//! What is refused or told before a run.

use super::RunArgs;
use crate::commands::run_scans::OpenScans;
use crate::commands::survey::Survey;
use crate::progress::Display;
use anyhow::{Result, bail};
use sources::recording::{check_length, check_name};
use std::path::Path;

impl RunArgs {
    /// Refuses numbers that make no sense.
    pub(super) fn check_numbers(&self) -> Result<()> {
        if !(self.part.speed.is_finite() && self.part.speed > 0.0) {
            bail!(
                "--speed {} is not a speed\nhint: 1 is the speed of the recording, 2 twice as fast",
                self.part.speed
            );
        }
        if let Some(width) = self.lens.max_width.filter(|width| *width < 64) {
            bail!("--max-width {width} leaves nothing to track\nhint: 640 and more do");
        }
        if let Some(fov) = self.lens.fov.filter(|fov| !(5.0..=150.0).contains(fov)) {
            bail!("--fov {fov} is not a field of view\nhint: give degrees, such as --fov 65");
        }
        if let Some(share) = self.map.min_tracked.filter(|share| !(0.0..=1.0).contains(share)) {
            bail!("--min-tracked {share} is not a share\nhint: 0.9 asks for 90 % of the frames");
        }
        if let Some(path) = &self.map.record {
            check_name(path)?;
            check_length(path)?;
        }
        if let Some(name) = &self.map.name {
            check_length(Path::new(name))?;
        }
        if let (Some(start), Some(end)) = (self.part.start, self.part.end)
            && start >= end
        {
            bail!("--start {start} is not before --end {end}");
        }
        if let Some(out_of_range) =
            [self.part.start, self.part.end].into_iter().flatten().find(|s| !s.is_finite())
        {
            bail!("--start and --end are seconds into the recording, not {out_of_range}");
        }
        if let Some(variance) = self.map.max_variance.filter(|v| !(v.is_finite() && *v > 0.0)) {
            bail!("--max-variance is {variance}\nhint: give a number above 0");
        }
        self.camera.check()?;
        self.publishing.check()
    }

    /// Whether what was given fits a recording of images or a camera.
    pub(super) fn for_images(&self) -> Result<()> {
        if self.repeat.is_some() {
            self.alone()?;
        }
        if let Some(name) = self.scans.given() {
            bail!(
                "{name} is for scans of a LiDAR\nhint: give a folder of KITTI (.bin), PCD or PLY scans, or a file with them"
            );
        }
        if self.source.is_none() {
            return self.camera.needed();
        }
        self.camera.not_needed()?;
        if self.camera.duration.is_some() {
            bail!("--duration is for cameras\nhint: of a recording, take --start and --end");
        }
        Ok(())
    }

    /// Refuses a run that is repeated and that others see.
    fn alone(&self) -> Result<()> {
        let ros = self.publishing.is_wanted().then_some("--ros2");
        #[cfg(feature = "fleet")]
        let ros = ros.or(self.pairing.is_wanted().then_some("--fleet"));
        match ros.or(self.view.given()) {
            Some(name) => bail!("--repeat makes several runs, and {name} is for one that others see"),
            None => Ok(()),
        }
    }

    /// Prints what scans a run would be over.
    pub(super) fn print_scans(&self, scans: OpenScans) -> Result<()> {
        Survey::of_scans(scans).print(self.display() == Display::Json)
    }

    /// Prints what images a run would be over, and which calibration it would use.
    pub(super) fn print_images(&self) -> Result<()> {
        let path = self.source.as_deref().unwrap_or(Path::new("."));
        let survey = Survey::of_images(self.open()?, path, &self.options()?.camera, self.lens.fov);
        survey.print(self.display() == Display::Json)
    }
}
