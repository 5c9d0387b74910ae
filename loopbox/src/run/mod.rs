//! One agent's run, from a source of frames to a folder of results.
//!
//! In order:
//!
//! - `options`: what is asked for, and the way from there to the results; `session`: one map after another, as long as somebody
//!   wants a new one; `runtime`: the loop around the agent; `resuming`: a run that goes on in the map of an earlier one;
//! - `outlook` and `frame_survey`: what can be said before the run; `lens`: a recording without a calibration; `lens_check`:
//!   whether the given one fits;
//! - `recognising`: a lost camera is found by the features of keyframes; `surface_judge`: whether it is at the same place; `revisits`: loops that features find; `fragments`: what was tracked after losses is joined;
//! - `milestones`: how a long run goes; `output`, `live_map` and `saving`: the files, at the end and on the way;
//! - `record` and `fragment_record`: the numbers; `scale_doubt`: where the scale may have changed; `without_depth`: which
//!   keyframes have no depth; `diagnosis`: why nothing was tracked.

mod diagnosis;
mod fragment_record;
mod fragments;
mod frame_survey;
mod lens;
mod lens_check;
mod live_map;
mod milestones;
mod options;
mod outlook;
mod output;
mod progress;
mod recognising;
mod record;
mod resuming;
mod revisits;
mod runtime;
mod saving;
mod scale_doubt;
mod session;
mod surface_judge;
mod without_depth;

pub use crate::describing::complete as find_features;
pub use crate::listeners::{Listeners, MapListener, ProcessedFrame};
pub use crate::results::file_names::LIVE_TRAJECTORY;
pub use crate::swapping::free_bytes;
pub use lens::{FoundLens, Recording, find_lens, find_live_lens};
pub use options::{PreparedRun, RunOptions, run};
pub use outlook::{CameraNumbers, Outlook};
pub use output::TrajectoryFormat;
pub use progress::{Progress, Silent};
pub use record::{Cost, FrameCounts, FrameRow, Latency, MapCounts, RunRecord, state_name};
pub use resuming::{Resume, Resumed};
pub use session::Mapped;
pub use slam_direct::ResumeMode;
