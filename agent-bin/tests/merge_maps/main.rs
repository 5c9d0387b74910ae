//! `loopbox merge` and `loopbox unmerge` through the binary, on maps that `loopbox run` made of rendered recordings.
//!
//! Whatever a command refuses it must name, and leave nothing behind.

mod bad_input;
#[cfg(feature = "object-store")]
#[path = "../common/bucket.rs"]
mod bucket;
mod buckets;
mod continuing;
#[path = "../common/documented.rs"]
mod documented;
mod importing;
mod manifest;
mod merging;
mod support;
mod unmerging;
mod verdicts;
mod workers;
