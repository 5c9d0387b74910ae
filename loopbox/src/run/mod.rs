//! One agent's run, from a source of frames to a folder of results.
//!
//! In order:
//!
//! - `options`: what is asked for, and the way from there to the results; `session`: one map after another, as long as somebody
//!   wants a new one; `runtime`: the loop around the agent; `resuming`: a run that goes on in the map of an earlier one;
//! - `outlook` and `frame_survey`: what can be said before the run; `lens`: a recording without a calibration; `lens_check`:
//!   whether the given one fits;
//! - `describing`: the features of keyframes, found beside the run; `recognising`: a lost camera is found by these;
//!   `surface_judge`: whether it is at the same place; `revisits`: loops that features find; `fragments`: what was tracked after losses is joined;
//! - `listeners`: who is told how the map grows; `milestones`: how a long run goes;
//! - `output`, `file_names`, `live_map` and `saving`: the files, at the end and on the way;
//! - `record` and `fragment_record`: the numbers; `scale_doubt`: where the scale may have changed; `without_depth`: which
//!   keyframes have no depth; `diagnosis`: why nothing was tracked.

pub(crate) mod describing;
mod diagnosis;
mod file_names;
mod fragment_record;
mod fragments;
mod frame_survey;
mod lens;
mod lens_check;
mod listeners;
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

pub use describing::complete as find_features;
pub(crate) use describing::lower_priority;
pub use file_names::LIVE_TRAJECTORY;
pub(crate) use file_names::{TRAJECTORY, numbered};
pub(crate) use fragments::{in_order, most_frames_first};
pub use lens::{FoundLens, Recording, find_lens, find_live_lens};
pub use listeners::{Listeners, MapListener, ProcessedFrame};
pub use live_map::free_bytes;
pub use options::{PreparedRun, RunOptions, run};
pub use outlook::{CameraNumbers, Outlook};
pub use output::TrajectoryFormat;
pub use progress::{Progress, Silent};
pub use record::{Cost, FrameCounts, FrameRow, Latency, MapCounts, RunRecord, state_name};
pub use resuming::{Resume, Resumed};
pub use session::Mapped;
pub use slam_direct::ResumeMode;
