//! What recording and watching cost a run: in CPU time, with every frame processed, so that all runs do the same work.

use super::client::{Received, Viewer};
use super::program::{Pace, Task};
use crate::measure::{Run, Runner};
use anyhow::{Context, Result};
use measuring::median;
use std::path::{Path, PathBuf};

/// The sequence: one that takes about as long to process as to record, so that a second of work is a second watched.
pub const SEQUENCE: &str = "tum_fr1_desk";

/// What else a run does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extra {
    /// Nothing.
    Nothing,
    /// It records.
    Record,
    /// It is watched.
    Watched(Viewer),
}

impl Extra {
    /// All of them; that without anything first.
    pub const ALL: [Self; 4] =
        [Self::Nothing, Self::Record, Self::Watched(Viewer::Page), Self::Watched(Viewer::Foxglove)];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "plain",
            Self::Record => "record",
            Self::Watched(Viewer::Page) => "view",
            Self::Watched(Viewer::Foxglove) => "foxglove",
        }
    }
}

/// The runs with one extra.
pub struct Cost {
    /// Which.
    pub extra: Extra,
    /// The runs.
    pub runs: Vec<Run>,
    /// What its viewers got, in each run.
    pub received: Vec<Received>,
    /// Bytes of the recordings.
    pub recorded: Vec<u64>,
}

impl Cost {
    /// Median over the runs.
    pub fn median(&self, number: impl Fn(&Run) -> Option<f64>) -> Option<f64> {
        median(self.runs.iter().map(number).collect::<Option<_>>()?)
    }

    /// CPU seconds.
    pub fn cpu_s(&self) -> Option<f64> {
        self.median(|run| run.record("/cost/cpu_s"))
    }

    /// By how much its runs took more CPU time than the plain runs of their turns, percent: least, median, most.
    pub fn added(&self, plain: &Self) -> Option<[f64; 3]> {
        let cpu = |run: &Run| run.record("/cost/cpu_s");
        let pairs = self.runs.iter().zip(&plain.runs);
        let added = pairs.map(|(with, without)| Some(100.0 * (cpu(with)? / cpu(without)? - 1.0)));
        let mut added: Vec<f64> = added.collect::<Option<_>>()?;
        added.sort_by(f64::total_cmp);
        Some([*added.first()?, median(added.clone())?, *added.last()?])
    }

    /// Bytes that the recorder wrote for a frame.
    pub fn bytes_per_frame(&self) -> Option<f64> {
        let per_frame =
            self.runs.iter().zip(&self.recorded).map(|(r, &b)| Some(b as f64 / r.record("/frames/offered")?));
        median(per_frame.collect::<Option<_>>()?)
    }

    /// What viewers got a second: messages, images, bytes.
    pub fn received_a_second(&self) -> Option<[f64; 3]> {
        let of = |number: fn(&Received) -> u64| {
            let rates = self.runs.iter().zip(&self.received);
            let rates = rates.map(|(run, got)| Some(number(got) as f64 / run.record("/cost/wall_s")?));
            median(rates.collect::<Option<_>>()?)
        };
        Some([of(|got| got.messages)?, of(|got| got.pictures)?, of(|got| got.bytes)?])
    }
}

/// The folder of a run's results, and its recording.
fn place(work: &Path, extra: Extra, number: usize) -> (PathBuf, PathBuf) {
    let folder = work.join(SEQUENCE).join(extra.name());
    (folder.join(format!("run-{number}")), folder.join(format!("run-{number}.mcap")))
}

/// Runs the sequence with each extra so many times, in turns, so that what else the machine does meets all alike.
///
/// # Errors
/// When a run fails.
pub fn measure(runner: &Runner, sequence: &Path) -> Result<Vec<Cost>> {
    let empty = |extra| Cost { extra, runs: Vec::new(), received: Vec::new(), recorded: Vec::new() };
    let mut costs: Vec<Cost> = Extra::ALL.map(empty).into();
    for number in 1..=runner.runs {
        for cost in &mut costs {
            add_run(runner, sequence, cost, number)?;
            eprintln!("  {} {number} of {}", cost.extra.name(), runner.runs);
        }
    }
    Ok(costs)
}

fn add_run(runner: &Runner, sequence: &Path, cost: &mut Cost, number: usize) -> Result<()> {
    let (out, recording) = place(&runner.work, cost.extra, number);
    let plain = Task::new(sequence, &out, Pace::Every);
    cost.runs.push(match cost.extra {
        Extra::Nothing => plain.run(runner)?,
        Extra::Record => {
            let run = Task { record: Some(&recording), ..plain }.run(runner)?;
            let about = std::fs::metadata(&recording);
            cost.recorded
                .push(about.with_context(|| format!("{}: cannot be read", recording.display()))?.len());
            run
        }
        Extra::Watched(viewer) => {
            let (run, received) = plain.watched(runner, viewer)?;
            cost.received.push(received);
            run
        }
    });
    Ok(())
}
