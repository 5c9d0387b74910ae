//! `loopbox`: direct monocular SLAM for recordings and cameras.

mod ahead;
mod camera;
mod commands;
mod diagnosis;
#[cfg(feature = "opencv")]
mod merging;
mod output;
mod pictures;
mod process;
mod progress;
mod record;
mod report;
mod runtime;
mod sources;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = commands::Cli::parse();
    match cli.command.execute() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
