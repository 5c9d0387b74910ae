//! The inside of the program `loopbox`: commands, sources of frames, what a run writes.
//!
//! A library so that what reads foreign bytes can be fuzzed and measured; the program is a call of
//! [`commands::Command::execute`].

mod ahead;
pub mod bag;
#[cfg(feature = "opencv")]
mod calibrating;
mod camera;
pub mod commands;
mod convert;
mod diagnosis;
#[cfg(feature = "opencv")]
mod merging;
mod output;
pub mod pictures;
mod process;
mod progress;
mod record;
pub mod recording;
mod report;
mod runtime;
mod saving;
mod session;
pub mod sources;
#[cfg(feature = "view")]
pub mod watch;
#[cfg(not(feature = "view"))]
#[path = "watch/off.rs"]
pub mod watch;
