//! Runs of the program as a camera would feed it, or as fast as it goes.

use super::client::{self, Received, Viewer};
use crate::measure::{Run, Runner, finish, make_empty};
use anyhow::Result;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Which frames a run processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// All.
    Every,
    /// Those that come when tracking is ready, by the time stamps.
    Camera,
}

/// A run to make.
pub struct Task<'a> {
    /// The recording.
    pub source: &'a Path,
    /// Folder for the results; what is there goes.
    pub out: &'a Path,
    /// Which frames.
    pub pace: Pace,
    /// Where to record to.
    pub record: Option<&'a Path>,
}

impl<'a> Task<'a> {
    /// A run without a recording.
    pub fn new(source: &'a Path, out: &'a Path, pace: Pace) -> Self {
        Self { source, out, pace, record: None }
    }

    /// The command of the run, for which there is room now.
    ///
    /// # Errors
    /// When what is there from before cannot be removed.
    fn command(&self, runner: &Runner) -> Result<Command> {
        make_empty(self.out)?;
        let mut command = Command::new(&runner.loopbox);
        command.arg("run").arg(self.source).arg("--out").arg(self.out).arg("--quiet");
        if self.pace == Pace::Camera {
            command.arg("--realtime");
        }
        if let Some(record) = self.record {
            if record.exists() {
                std::fs::remove_file(record)?;
            }
            command.arg("--record").arg(record);
        }
        Ok(command)
    }

    /// Makes the run.
    ///
    /// # Errors
    /// When it fails.
    pub fn run(&self, runner: &Runner) -> Result<Run> {
        finish(&mut self.command(runner)?)?;
        Run::read(self.out, Value::Null)
    }

    /// Makes the run and compares it with the truth of `sequence`.
    ///
    /// # Errors
    /// When either fails.
    pub fn evaluated(&self, runner: &Runner, sequence: &Path) -> Result<Run> {
        finish(&mut self.command(runner)?)?;
        Run::read(self.out, runner.evaluate(sequence, self.out)?)
    }

    /// Makes the run while somebody watches.
    ///
    /// # Errors
    /// When it fails or there is nothing to see.
    pub fn watched(&self, runner: &Runner, viewer: Viewer) -> Result<(Run, Received)> {
        let mut command = self.command(runner)?;
        // Port 0 is any free one.
        command.arg(match viewer {
            Viewer::Page => "--view=0",
            Viewer::Foxglove => "--foxglove=0",
        });
        let received = client::watch(&mut command, viewer)?;
        Ok((Run::read(self.out, Value::Null)?, received))
    }
}

/// The nearest-rank percentile of numbers.
pub fn percentile(mut values: Vec<f64>, percent: usize) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get((values.len() * percent).div_ceil(100).saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use measuring::median;

    #[test]
    fn medians_and_percentiles_are_values_that_occurred() {
        let values: Vec<f64> = (1..=200).rev().map(f64::from).collect();
        assert_eq!(percentile(values.clone(), 99), Some(198.0));
        assert_eq!(median(values), Some(101.0));
        assert_eq!((median(vec![]), percentile(vec![], 99)), (None, None));
    }
}
