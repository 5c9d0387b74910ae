//! Run agents, merge their maps, evaluate what came of it: what the program `loopbox` does, for other programs. Prints
//! nothing, installs no signal handlers and starts no global pool of threads.
//!
//! The three things people do, in a few lines (`examples/two_agents.rs` does all of them, `examples/own_frames.rs` maps frames of another program):
//! [`run()`], [`merge_maps`] and [`evaluate`].
//!
//! [`mod@run`] takes frames from a source through an agent into a folder of results, [`merging`] brings maps of several
//! agents together, [`calibrating`] makes a camera's calibration from images of a board; [`results`] keeps folders of
//! results whole, [`importing`] makes maps of posed images from elsewhere, [`placing`] brings maps to metres and upright, [`write_report`] makes the report of a map alone. [`lidar`] does the same for LiDAR agents; `fleet` lets
//! agents pair over a network, [`ros`] publishes a run to ROS 2. [`pairs`] proposes pairs of maps and finds the verdict on one, [`verdicts`] keeps what pairs made of each other, as [`blobs`]; [`store`] has maps beside them, whose pairs workers ask. [`unattended`] runs an agent for ever, session after session.

pub mod blobs;
pub mod calibrating;
mod common_map;
mod counting;
mod describing;
pub mod evaluating;
mod explaining;
#[cfg(feature = "fleet")]
pub mod fleet;
mod fragments;
pub mod importing;
mod level;
pub mod lidar;
mod listeners;
pub mod merging;
pub mod open;
pub mod pairs;
pub mod placing;
pub mod program;
mod reporting;
pub mod results;
pub mod ros;
pub mod run;
pub mod store;
mod swapping;
pub mod unattended;
pub mod verdicts;

pub use counting::counted;
pub use evaluating::evaluate;
pub use explaining::explained;
pub use level::Level;
pub use merging::{MergeOptions, merge_maps};
pub use reporting::write_report;
pub use run::{RunOptions, run};
pub use sources::pictures::Picture;
pub use sources::{FrameSource, SourceFrame, SourceInfo, Stop};
pub use swapping::SwapFiles;
pub use view::watch::Watch;
