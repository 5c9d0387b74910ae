//! Direct monocular SLAM: tracking, depth, keyframes and their graph, from pixel intensities.
//!
//! Everything here is plain functions and types; files, clocks and threads of the user's program
//! live in `agent-bin`.

mod agent;
pub mod align;
mod bootstrap;
mod keyframes;
mod local_map;
mod mapping;
mod params;
mod patch;
mod select;
mod track;
mod triangulate;
mod warp;
mod window;

pub use agent::{Agent, Frame, FrameReport, TrackingState};
pub use params::Params;
