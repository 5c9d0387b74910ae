//! `loopbox merge` and `loopbox unmerge` through the binary, on maps that `loopbox run` made of rendered recordings.
//!
//! Whatever a command refuses it must name, and leave nothing behind.

mod bad_input;
#[path = "../common/documented.rs"]
mod documented;
mod going_on;
mod importing;
mod merging;
mod support;
mod unmerging;
mod verdicts;
