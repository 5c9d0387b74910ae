//! The program `loopbox`: arguments, progress, signals and exit codes. What it does is in the crate `loopbox`.

// Whoever reads what the program says may leave: `console` goes on then, these end the program.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr))]

pub mod allocation;
pub mod commands;
pub mod console;
mod interrupt;
pub mod logging;
mod progress;
pub mod version;
