//! `loopbox`: SLAM for recordings and cameras, of one agent and of several.

use agent_bin::commands::Cli;
use agent_bin::{allocation, console, logging, version};
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    allocation::tune();
    if !version::COMMIT.is_empty() {
        loopbox::program::set_commit(version::COMMIT);
    }
    let cli = Cli::parse();
    match console::usage(logging::check_environment()).and_then(|()| cli.command.execute()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => console::report(&error),
    }
}
