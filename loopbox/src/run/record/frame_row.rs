//! What became of a frame, a line of `frames.csv`.

use geometry::Se3;
use serde::{Serialize, Serializer};
use slam_direct::{Claim, FrameReport, TrackingState};
use view::report;
/// One processed frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameRow {
    /// Index in the recording.
    pub index: u64,
    /// Seconds, as recorded.
    pub timestamp: f64,
    /// The fragment it was given to, in the order in which they were begun.
    pub fragment: usize,
    /// State after the frame.
    #[serde(serialize_with = "state_as_name")]
    pub state: TrackingState,
    /// Time the agent took, milliseconds.
    pub ms: f64,
    /// From the moment the image was taken or due until its pose was known, milliseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency_ms: Option<f64>,
    /// Share of the predicted points that were matched, 0–1.
    pub inlier_share: f32,
    /// Root mean square photometric residual, grey levels.
    pub rmse: f32,
    /// Points matched.
    pub matched_points: usize,
    /// Keyframe made from it.
    pub keyframe: Option<u32>,
    /// Loop closed after it: newer and older keyframe.
    pub loop_closed: Option<(u32, u32)>,
    /// Whether it was found where no motion leads to, and is not decided yet to show the place: it has a pose once it is.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub on_trial: bool,
    /// world_from_camera as it was handed out after the frame, in the fragment's world as it was then; nothing where the frame
    /// was not found. Later frames and loops move poses; who steers a robot has had this one.
    #[serde(skip)]
    pub handed_out: Option<Se3>,
}

impl FrameRow {
    /// The row of a frame and its report.
    pub fn new(index: u64, timestamp: f64, ms: f64, report: &FrameReport) -> Self {
        Self {
            index,
            timestamp,
            fragment: report.fragment,
            state: report.state,
            ms,
            latency_ms: None,
            inlier_share: report.inlier_share,
            rmse: report.rmse,
            matched_points: report.matched_points,
            keyframe: report.new_keyframe.map(|id| id.0),
            loop_closed: report.closed_loop.map(|(newer, older)| (newer.0, older.0)),
            on_trial: report.claim.is_some_and(|claim| claim != Claim::Accepted),
            handed_out: report.world_from_camera,
        }
    }

    /// The row as the report plots it.
    pub fn for_report(&self) -> report::FrameRow {
        report::FrameRow {
            frame_index: self.index,
            timestamp: self.timestamp,
            ms: self.ms as f32,
            matched_points: self.matched_points,
            inlier_share: self.inlier_share,
            rmse: self.rmse,
            state: self.state,
        }
    }
}

fn state_as_name<S: Serializer>(state: &TrackingState, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(state_name(*state))
}

/// The state as people and logs read it.
pub fn state_name(state: TrackingState) -> &'static str {
    match state {
        TrackingState::Starting => "starting",
        TrackingState::Tracking => "tracking",
        TrackingState::Lost => "lost",
    }
}
