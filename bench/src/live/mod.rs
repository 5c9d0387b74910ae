//! Measuring what matters with a camera: latency, dropped frames, what watching and recording cost, replays, and
//! calibration. A recording played by its time stamps stands for the camera.

mod calibration;
mod client;
mod latency;
mod long;
mod program;
mod replay;
pub mod report;
mod shares;

use crate::measure::Runner;
use anyhow::{Result, bail};
use calibration::{Calibrated, KNOWN};
use latency::Timed;
use long::Long;
use replay::Replayed;
use shares::Cost;
use std::path::Path;
use std::time::Instant;

/// What to measure.
pub struct Plan<'a> {
    /// Runs the program; its runs are those of which medians are taken.
    pub runner: &'a Runner,
    /// Folder of sequences.
    pub data: &'a Path,
    /// Minutes of the longest run.
    pub minutes: f64,
}

/// What came of each part, or why there is nothing.
pub struct Live {
    /// Calibrations.
    pub calibrations: Part<Vec<Calibrated>>,
    /// Latency and accuracy.
    pub timed: Part<Vec<Timed>>,
    /// The cost of watching and recording.
    pub costs: Part<Vec<Cost>>,
    /// Replays.
    pub replays: Part<Vec<Replayed>>,
    /// The longest run.
    pub long: Part<Long>,
}

/// What a part gave, or why it gave nothing.
pub type Part<T> = Result<T, String>;

impl Live {
    /// What must not be: parts that failed, and replays that differ.
    pub fn problems(&self) -> Vec<String> {
        let parts = [
            self.calibrations.as_ref().err(),
            self.timed.as_ref().err(),
            self.costs.as_ref().err(),
            self.replays.as_ref().err(),
            self.long.as_ref().err(),
        ];
        let replays = self.replays.iter().flatten().filter(|replayed| !replayed.is_same());
        let differ = replays.map(|replayed| format!("not the same when replayed: {}", replayed.what));
        parts.into_iter().flatten().cloned().chain(differ).collect()
    }
}

/// Measures everything. A part that fails does not keep the others from being measured.
///
/// # Errors
/// When data are missing.
pub fn measure(plan: &Plan) -> Result<Live> {
    let needed = latency::SEQUENCES.iter().copied().chain(KNOWN.iter().map(|known| known.name));
    check_data(plan.data, needed)?;
    let runner = runner(plan);
    let sequence = |name: &str| plan.data.join(name);
    let calibrations = calibrations(&runner, plan.data);
    let costs = costs(&runner, plan.data);
    let timed = part("latency", || {
        let time = |name: &&str| latency::measure(&runner, &sequence(name), name);
        latency::SEQUENCES.iter().map(time).collect()
    });
    let replays =
        part("replays", || replay::measure(&runner, &sequence(shares::SEQUENCE), &sequence(long::SEQUENCE)));
    let long = part("the long run", || long::measure(&runner, &sequence(long::SEQUENCE), plan.minutes));
    Ok(Live { calibrations, timed, costs, replays, long })
}

/// Measures calibration alone.
///
/// # Errors
/// When data are missing.
pub fn measure_calibrations(plan: &Plan) -> Result<Part<Vec<Calibrated>>> {
    check_data(plan.data, KNOWN.iter().map(|known| known.name))?;
    Ok(calibrations(&runner(plan), plan.data))
}

/// Measures the cost of recording and watching alone.
///
/// # Errors
/// When data are missing.
pub fn measure_costs(plan: &Plan) -> Result<Part<Vec<Cost>>> {
    check_data(plan.data, std::iter::once(shares::SEQUENCE))?;
    Ok(costs(&runner(plan), plan.data))
}

fn costs(runner: &Runner, data: &Path) -> Part<Vec<Cost>> {
    part("cost of recording and watching", || shares::measure(runner, &data.join(shares::SEQUENCE)))
}

fn calibrations(runner: &Runner, data: &Path) -> Part<Vec<Calibrated>> {
    part("calibration", || KNOWN.iter().map(|known| known.measure(runner, &data.join(known.name))).collect())
}

fn check_data<'a>(data: &Path, needed: impl Iterator<Item = &'a str>) -> Result<()> {
    let missing: Vec<&str> = needed.filter(|name| !data.join(name).is_dir()).collect();
    if !missing.is_empty() {
        bail!("{}: there is no {} to measure", data.display(), missing.join(", "));
    }
    Ok(())
}

/// What runs the program in a folder of its own.
fn runner(plan: &Plan) -> Runner {
    let Runner { loopbox, work, runs } = plan.runner;
    Runner { loopbox: loopbox.clone(), work: work.join("live"), runs: *runs }
}

/// Measures a part, and says how long it took.
fn part<T>(name: &str, measure: impl FnOnce() -> Result<T>) -> Part<T> {
    eprintln!("{name} …");
    let began = Instant::now();
    let measured = measure().map_err(|error| format!("{name}: {error:#}"));
    match &measured {
        Ok(_) => eprintln!("{name}: {:.0} s", began.elapsed().as_secs_f64()),
        Err(reason) => eprintln!("FAILED: {reason}"),
    }
    measured
}
