//! The inside of the program `loopbox`: commands, sources of frames, what a run writes.
//!
//! A library so that what reads foreign bytes can be fuzzed and measured; the program is a call of
//! [`commands::Command::execute`].

// Whoever reads what the program says may leave: `console` goes on then, these end the program.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr))]

mod ahead;
pub mod bag;
#[cfg(feature = "opencv")]
mod calibrating;
mod camera;
pub mod commands;
pub mod console;
mod convert;
mod diagnosis;
mod fragments;
#[cfg(feature = "opencv")]
mod merging;
mod output;
pub mod pictures;
mod process;
mod progress;
mod record;
pub mod recording;
mod report;
mod results;
mod runtime;
mod saving;
mod session;
pub mod sources;
#[cfg(feature = "view")]
pub mod watch;
#[cfg(not(feature = "view"))]
#[path = "watch/off.rs"]
pub mod watch;
