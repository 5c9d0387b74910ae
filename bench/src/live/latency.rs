//! How old an image is when its pose is known, and what dropped frames cost in accuracy.

use super::program::{Pace, Task};
use crate::measure::{Run, Runner};
use anyhow::Result;
use measuring::median;
use std::path::{Path, PathBuf};

/// The sequences of 30 frames a second.
pub const SEQUENCES: [&str; 2] = ["tum_fr1_xyz", "tum_fr1_desk"];

/// A sequence at the speed of its camera, and as fast as it goes.
pub struct Timed {
    /// Its name.
    pub name: String,
    /// With all frames; the run was recorded.
    pub offline: Run,
    /// At the speed of the camera.
    pub live: Vec<Run>,
    /// The ATE of these runs' poses as they were handed out, metres.
    pub handed_out: Vec<Option<f64>>,
}

impl Timed {
    /// Median over the runs at the speed of the camera.
    pub fn median(&self, number: impl Fn(&Run) -> Option<f64>) -> Option<f64> {
        median(self.live.iter().map(number).collect::<Option<_>>()?)
    }

    /// The worst of these runs.
    pub fn worst(&self, number: impl Fn(&Run) -> Option<f64>) -> Option<f64> {
        self.live.iter().map(number).collect::<Option<Vec<_>>>()?.into_iter().reduce(f64::max)
    }
}

/// Where the run with all frames puts its results, and its recording.
pub fn offline(work: &Path, name: &str) -> (PathBuf, PathBuf) {
    let folder = work.join(name);
    (folder.join("offline"), folder.join("offline.mcap"))
}

/// Runs a sequence as fast as it goes, and at the speed of its camera.
///
/// # Errors
/// When a run fails.
pub fn measure(runner: &Runner, sequence: &Path, name: &str) -> Result<Timed> {
    let (out, recording) = offline(&runner.work, name);
    let offline = Task { record: Some(&recording), ..Task::new(sequence, &out, Pace::Every) };
    let offline = offline.evaluated(runner, sequence)?;
    let live = |number: usize| {
        let out = runner.work.join(name).join(format!("live-{number}"));
        let run = Task::new(sequence, &out, Pace::Camera).evaluated(runner, sequence)?;
        Ok((run, runner.ate_handed_out(sequence, &out)?))
    };
    let live: Vec<(Run, Option<f64>)> = (1..=runner.runs).map(live).collect::<Result<_>>()?;
    let (live, handed_out) = live.into_iter().unzip();
    Ok(Timed { name: name.to_owned(), offline, live, handed_out })
}
