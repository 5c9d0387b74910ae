//! One agent's run, from a source of frames to a folder of results.
//!
//! In order: `options` (what is asked for, and the way from there to the results), `session` (one map after another, as long as somebody wants a new one), `runtime` (the loop around the
//! agent), `outlook` and `looking` (what can be said before it), `lens` (a recording without a calibration), `lens_check` (whether the one given fits), `describing` (features of
//! keyframes beside it), `recognising` (a lost camera found by these), `judging` (whether it is the place), `fragments` (what was tracked after losses joined), `output` (the files), `live_map` (the map's on
//! the way), `listening` (who is told how the map grows), `milestones` (how a long run goes), `record` and `fragment_record` (the numbers), `scale_doubt` (where the scale may have changed), `without_depth` (which keyframes have no depth), `file_names` (how the files are called), `saving` (results on the way), `resuming`
//! (a map of an earlier run gone on with), `diagnosis` (why nothing was tracked).

mod describing;
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
