//! LiDAR agents: a recording of scans into a map, and maps of several agents into one.
//!
//! [`run`] maps a recording ([`mapper`]: a scan at a time), [`merge`](fn@merging::merge) brings maps together; `convert` is the way
//! between [`map::Map`] and [`slam_lidar`]. Nothing here prints: whoever calls is told by callbacks.

mod convert;
pub mod mapper;
pub mod merging;
pub mod poses;
pub mod record;
pub mod run;

#[cfg(test)]
mod tests;
