//! Semi-direct monocular SLAM: tracking, depth, keyframes and their graph, from pixel intensities.
//!
//! As in SVO (Forster, Pizzoli, Scaramuzza, ICRA 2014), patches around points are aligned with a new image directly:
//! first all at once for the pose, then each by itself. The reprojection errors of the patches that were found then
//! refine the pose, and later the points. Keyframes, covisibility, local and whole-map optimisation, and loop closing
//! are arranged as in ORB-SLAM (Mur-Artal, Montiel, Tardós, T-RO 2015). Semi-dense depth is filtered per keyframe as
//! in LSD-SLAM (Engel, Schöps, Cremers, ECCV 2014).
//!
//! Everything here is plain functions and types; the program that uses them has the files and clocks. Only
//! `background` starts threads, and the agent adopts their results at fixed frames. Loops over pixels and points run
//! on rayon's pool.

mod agent;
pub mod align;
mod atlas;
mod background;
mod bootstrap;
mod closing;
mod dense;
mod depth;
mod exposure;
mod frame;
mod judge;
mod keyframes;
mod local_map;
pub mod loops;
mod mapping;
mod mask;
mod params;
mod patch;
mod publish;
mod recognise;
pub mod relocalise;
mod rival;
mod rotation_prior;
mod scale;
mod select;
pub mod self_calibration;
#[cfg(test)]
mod test_data;
#[cfg(test)]
mod test_scene;
mod tone;
mod track;
mod tracker;
mod triangulate;
mod warp;
mod wide;
mod window;

pub use agent::{
    Agent, AgentError, Claim, FrameReport, Joint, ResumeMode, TrackingState, edges_of, optimise_jointly,
};
pub use atlas::{Atlas, AtlasParams, SPLIT_FOR};
pub use backend::{DocumentedParameter, Parameter, ParameterError, ParameterValue};
pub use closing::{ClosingParams, NoLoop, Trajectory, close_loop};
pub use depth::{
    DepthFilter, DepthParams, SeedPoint, StereoFrame, UpdateStats, candidate_pixels, choose_references,
    has_hardly_any as has_hardly_any_depth,
};
pub use frame::{Frame, LazyColor, LossReason};
pub use judge::{ClaimedPlace, JudgePlace, PlacedView};
pub use mask::LeftOut;
pub use params::Params;
pub use recognise::{Hypothesis, KnownView, Recognise};
pub use scale::{CarriedScale, ScaleBreak, ScaleDeviation};
