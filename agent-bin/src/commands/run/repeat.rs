//! `loopbox run --repeat`: one run is one draw, and other first frames give other figures.

use super::RunArgs;
use super::images::over_images;
use crate::commands::eval_table::{self, Form, Runs};
use crate::console::warning;
use anyhow::{Result, bail};
use eval::Options;
use sources::Stop;
use std::path::PathBuf;

/// Seconds between the first frames of two runs.
const STEP: f64 = 0.2;

/// Maps a recording so many times, and compares the runs with the truth, where there is one. What one run fails by is told, and does not
/// keep the others from being made.
pub(super) fn repeat(mut args: RunArgs, count: u32, stop: &Stop) -> Result<()> {
    let (home, start) = (args.out().to_owned(), args.part.start.unwrap_or(0.0));
    let (mut made, mut failed) = (Vec::new(), 0);
    for number in 0..count {
        args.part.start = Some(start + STEP * f64::from(number));
        let out = home.join((number + 1).to_string());
        args.out = Some(out.clone());
        match over_images(&args, stop) {
            Ok(()) => made.push(out),
            Err(error) => {
                warning!("{}: {error:#}", out.display());
                failed += 1;
            }
        }
        if stop.requested() {
            break;
        }
    }
    if let Some(truth) = args.truth().filter(|_| !made.is_empty()) {
        let csv = home.join("runs.csv");
        let runs = Runs { estimates: &made, truths: &[truth], frames: &[] };
        eval_table::run(&runs, &Options::default(), &Form { json: false, csv: Some(&csv) })?;
    }
    if failed > 0 {
        bail!("{failed} of {count} runs gave no map, or too little of one");
    }
    Ok(())
}

impl RunArgs {
    /// The truth that lies beside the recording's images.
    fn truth(&self) -> Option<PathBuf> {
        self.source.as_ref().map(|source| source.join("groundtruth.txt")).filter(|truth| truth.is_file())
    }
}
