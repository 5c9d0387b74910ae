//! Direct monocular SLAM: tracking, depth, keyframes and their graph, from pixel intensities.
//!
//! Everything here is plain functions and types; files, clocks and threads of the user's program
//! live in `agent-bin`.

mod agent;
pub mod align;
mod atlas;
mod background;
mod bootstrap;
mod closing;
mod dense;
mod depth;
mod keyframes;
mod local_map;
pub mod loops;
mod mapping;
mod params;
mod patch;
mod publish;
pub mod relocalise;
mod select;
#[cfg(test)]
mod test_data;
#[cfg(test)]
mod test_scene;
mod track;
mod tracker;
mod triangulate;
mod warp;
mod window;

pub use agent::{Agent, Frame, FrameReport, TrackingState};
pub use atlas::{Atlas, AtlasParams};
pub use backend::{DocumentedParameter, Parameter, ParameterValue};
pub use depth::{DepthFilter, DepthParams, SeedPoint, StereoFrame, UpdateStats, choose_references};
pub use params::Params;
