//! Direct monocular SLAM: tracking, depth, keyframes and their graph, from pixel intensities.
//!
//! Everything here is plain functions and types; files, clocks and threads of the user's program
//! live in `agent-bin`.

mod agent;
mod depth;
mod params;

pub use agent::{Agent, Frame, FrameReport, TrackingState};
pub use depth::{DepthFilter, DepthParams, SeedPoint, StereoFrame, UpdateStats, choose_references};
pub use params::Params;
