//! `loopbox`: direct monocular SLAM for recordings and cameras.

use agent_bin::allocation;
use agent_bin::commands::Cli;
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    allocation::tune();
    match Cli::parse().command.execute() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => agent_bin::console::report(&error),
    }
}
