//! The inside of the program `loopbox`: commands, sources of frames, what a run writes.
//!
//! A library so that what reads foreign bytes can be fuzzed and measured; the program is a call of
//! [`commands::Command::execute`].

mod ahead;
#[cfg(feature = "opencv")]
mod calibrating;
mod camera;
pub mod commands;
mod diagnosis;
#[cfg(feature = "opencv")]
mod merging;
mod output;
pub mod pictures;
mod process;
mod progress;
mod record;
mod report;
mod runtime;
pub mod sources;
