//! LiDAR agents: a recording of scans into a map, and maps of several agents into one.
//!
//! [`run`] maps a recording ([`mapper`]: a scan at a time), [`merge`](fn@merging::merge) brings maps together; `convert` is the way
//! between [`map::Map`] and [`slam_lidar`]. [`map_recording`] and [`merge_maps`] do the same from files into a folder of
//! results. Nothing here prints: whoever calls is told by callbacks.

mod convert;
mod fragments;
pub mod guessed;
pub mod mapper;
pub mod merging;
mod notifying;
pub mod outlook;
mod output;
pub(crate) mod page;
pub mod poses;
pub mod record;
mod report;
pub mod run;
pub mod scan_row;
pub mod sweep_timing;

pub(crate) use output::read_inputs;
#[cfg(feature = "fleet")]
pub(crate) use output::write_merged;
pub use output::{LidarMergeOptions, LidarMerged, LidarOptions, Mapped, map_recording, merge_maps};

#[cfg(test)]
mod tests;
