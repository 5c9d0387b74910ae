//! `loopbox`: SLAM for recordings and cameras, of one agent and of several.

use agent_bin::commands::Cli;
use agent_bin::{allocation, version};
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    allocation::tune();
    if !version::COMMIT.is_empty() {
        loopbox::program::set_commit(version::COMMIT);
    }
    match Cli::parse().command.execute() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => agent_bin::console::report(&error),
    }
}
