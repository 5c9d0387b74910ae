//! Runs loopbox over sequences with ground truth and writes what came out into documents.
//!
//! It knows the program only from outside: its command line and the files it writes.

mod document;
mod measure;
mod report;
mod targets;

use anyhow::{Context, Result, bail};
use clap::Parser;
use measure::{Measurement, Runner};
use std::path::{Path, PathBuf};

/// Measure loopbox on sequences with ground truth and write the results into documents
#[derive(Debug, Parser)]
struct Args {
    /// Folder of sequences: each with images/, times.txt, camera.yaml, groundtruth.txt, maybe depth/
    #[arg(long)]
    data: PathBuf,
    /// The loopbox program
    #[arg(long)]
    loopbox: PathBuf,
    /// Folder for the runs' outputs
    #[arg(long)]
    work: PathBuf,
    /// Runs of each sequence with all cores
    #[arg(long, default_value_t = 3)]
    runs: usize,
    /// Measure only these sequences; by default all
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Documents to write the results into, between their markers
    documents: Vec<PathBuf>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    if args.runs == 0 {
        bail!("--runs 0 measures nothing");
    }
    let sequences = sequences(&args.data, &args.only)?;
    let runner = Runner { loopbox: args.loopbox, work: args.work, runs: args.runs };
    let mut measurements: Vec<Measurement> = Vec::new();
    for sequence in &sequences {
        let measurement = runner.measure(sequence)?;
        eprintln!("{}", report::line(&measurement));
        measurements.push(measurement);
    }
    let sections = [
        ("results", report::results(&measurements, args.runs)),
        ("summary", report::summary(&measurements)),
        ("machine", report::machine()),
    ];
    for path in &args.documents {
        document::update(path, &sections)?;
    }
    let failed: Vec<&str> =
        measurements.iter().filter(|m| m.failure.is_some()).map(|m| m.name.as_str()).collect();
    if !failed.is_empty() {
        bail!("no figures for {}: see the messages above", failed.join(", "));
    }
    Ok(())
}

/// The folders of `data` that are sequences with ground truth, by name.
fn sequences(data: &Path, only: &[String]) -> Result<Vec<PathBuf>> {
    let unreadable = || format!("{}: the folder of sequences cannot be read", data.display());
    let mut found = Vec::new();
    for entry in std::fs::read_dir(data).with_context(unreadable)? {
        let path = entry.with_context(unreadable)?.path();
        let complete = path.join("groundtruth.txt").is_file() && path.join("times.txt").is_file();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if complete && (only.is_empty() || only.contains(&name)) {
            found.push(path);
        }
    }
    if found.is_empty() {
        bail!("{}: holds no sequence with times.txt and groundtruth.txt to measure", data.display());
    }
    found.sort();
    Ok(found)
}
