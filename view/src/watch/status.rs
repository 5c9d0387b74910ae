//! The numbers shown while a run goes on.

use super::Neighbourhood;
use serde::Serialize;
use slam_direct::{FrameReport, ScaleBreak, TrackingState};

/// Where a run stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// `preparing`, `starting`, `tracking`, `lost`, or `done`.
    pub state: &'static str,
    /// Whether no frames are taken until the user says so.
    pub paused: bool,
    /// Whether frames are being recorded; `None` when nothing can record them.
    pub recording: Option<bool>,
    /// Index of the newest frame in the recording.
    pub frame: u64,
    /// Its time stamp, seconds.
    pub timestamp: f64,
    /// Frames of the recording, where known.
    pub frames: Option<u64>,
    /// Frames taken so far.
    pub processed: u64,
    /// Frames tracked so far.
    pub tracked: u64,
    /// Frames dropped because tracking was late.
    pub dropped: u64,
    /// Times that tracking was lost.
    pub losses: u64,
    /// Loops closed.
    pub loops: u64,
    /// Where the scale was not carried on in this run.
    pub scale_break: Option<ScaleBreaks>,
    /// Frames taken per second of late.
    pub frames_per_s: f64,
    /// Time that the newest frame took, milliseconds.
    pub ms: f64,
    /// From capture to pose, milliseconds, where the moment of capture is known.
    pub latency_ms: Option<f64>,
    /// Share of the predicted points that were matched, 0–1.
    pub inlier_share: f32,
    /// Points matched in the newest frame.
    pub matched: usize,
    /// Root mean square photometric residual, grey levels.
    pub rmse: f32,
    /// Keyframes of the map.
    pub keyframes: usize,
    /// Points of the cloud.
    pub points: usize,
    /// Resident memory, bytes.
    pub memory_bytes: Option<u64>,
    /// CPU time of the program over wall time of late; 1 is one core.
    pub cpu: Option<f64>,
    /// Axes and centre of the camera, where its pose is known.
    pub camera: Option<[f32; 12]>,
    /// Why there is no pose, for people.
    pub reason: Option<&'static str>,
    /// What the program has just done, for people.
    pub note: String,
    /// Whether the report is there, beside the page.
    pub report: bool,
    /// The folder that results go to.
    pub folder: String,
    /// Who is near, of an agent that pairs.
    pub neighbourhood: Option<Neighbourhood>,
}

/// Where the scale was not carried on, the newest place last of so many.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScaleBreaks {
    /// How many there are.
    pub count: u64,
    /// Index of the frame when the newest was found, some keyframes after it.
    pub frame: u64,
    /// The time stamp of that frame, seconds.
    pub timestamp: f64,
    /// How little measures the scale there, for people.
    pub why: String,
}

impl ScaleBreaks {
    /// With one more to those before.
    fn after(before: Option<&Self>, found: &FoundBreak) -> Self {
        let FoundBreak { frame, timestamp, of_scale } = *found;
        Self { count: before.map_or(0, |before| before.count) + 1, frame, timestamp, why: of_scale.text() }
    }
}

/// A place where the scale was not carried on, and the frame when that was found.
#[derive(Clone, Copy, Debug)]
pub struct FoundBreak {
    /// Index of the frame in the recording.
    pub frame: u64,
    /// Seconds, as recorded.
    pub timestamp: f64,
    /// What was found.
    pub of_scale: ScaleBreak,
}

impl Status {
    /// Adds where else the scale was not carried on.
    pub fn add_breaks(&mut self, found: &[FoundBreak]) {
        for found in found {
            self.scale_break = Some(ScaleBreaks::after(self.scale_break.as_ref(), found));
        }
    }
}

/// What the tracker says of a frame.
#[derive(Clone, Debug)]
pub struct Facts {
    /// Index of the frame in the recording.
    pub frame: u64,
    /// Seconds, as recorded.
    pub timestamp: f64,
    /// Time spent on it, milliseconds.
    pub ms: f64,
    /// From capture to pose, milliseconds, where known.
    pub latency_ms: Option<f64>,
    /// Frames dropped so far.
    pub dropped: u64,
    /// What became of it.
    pub report: FrameReport,
}

/// The name of a state.
pub fn state_name(state: TrackingState) -> &'static str {
    match state {
        TrackingState::Starting => "starting",
        TrackingState::Tracking => "tracking",
        TrackingState::Lost => "lost",
    }
}
