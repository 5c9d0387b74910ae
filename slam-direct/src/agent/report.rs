//! The report of the agent on a frame.

use crate::frame::LossReason;
use crate::scale::ScaleBreak;
use geometry::Se3;
use map::{KeyframeId, MapDelta};
use nalgebra::Matrix6;

/// The state of the agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingState {
    /// Waiting for enough parallax to make a first map.
    Starting,
    /// The frame's pose is known.
    Tracking,
    /// The pose is unknown; each new frame is tried against the map.
    Lost,
}

/// The state of a claim after a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// It is on trial.
    Pending,
    /// It is the place; the poses of the frames since it was found are in the map.
    Accepted,
    /// It is another place.
    Refused,
    /// The frames so far do not decide; it stays on trial.
    Undecided,
}

/// The report on one frame.
#[derive(Clone, Debug)]
pub struct FrameReport {
    /// State after the frame.
    pub state: TrackingState,
    /// The index of the fragment whose world and unit the report is in, if an [`Atlas`](crate::Atlas) made it; 0 for
    /// one agent.
    pub fragment: usize,
    /// Pose as known now (later optimisation may move it).
    pub world_from_camera: Option<Se3>,
    /// Covariance of that pose relative to the keyframes around it, of a right perturbation `(υ, ω)`: in the axes of the camera (x right,
    /// y down, z forward), map units and radians. `None` for frames that begin a map. What the map errs from one place to another
    /// is not in it.
    pub covariance: Option<Matrix6<f64>>,
    /// Keyframe made from this frame.
    pub new_keyframe: Option<KeyframeId>,
    /// Keyframes whose depth is known since this frame; their poses may still move.
    pub settled_keyframes: Vec<KeyframeId>,
    /// Keyframe whose mapping was adopted before this frame was tracked, if it ran in the background.
    pub adopted: Option<KeyframeId>,
    /// The changes of the map since the report before, in order; a delta of number 0 begins a map. The frames' poses
    /// are not in it: a map only ever gets more of them, and each is relative to its keyframe.
    pub deltas: Vec<MapDelta>,
    /// Where the scale was not carried on, some keyframes ago: what was mapped since has a unit of its own. An [`Atlas`](crate::Atlas)
    /// makes a fragment of it, in which this report is, and goes on there. Each break is reported once.
    pub scale_break: Option<ScaleBreak>,
    /// Loop closed after this frame: `(newer, older)` keyframe.
    pub closed_loop: Option<(KeyframeId, KeyframeId)>,
    /// Share of the predicted points that were matched, 0–1.
    pub inlier_share: f32,
    /// Root mean square photometric residual of the matched points, grey levels.
    pub rmse: f32,
    /// Points matched in the frame.
    pub matched_points: usize,
    /// Why the frame was not tracked, for people.
    pub reason: Option<&'static str>,
    /// Why the frame is lost, if it is.
    pub loss: Option<LossReason>,
    /// The state of a claim, if there is one: a pose that no motion leads to, after a loss or at the start of a
    /// resumed map.
    pub claim: Option<Claim>,
}

impl FrameReport {
    /// A report on a frame that is lost.
    pub(crate) fn lost(loss: LossReason) -> Self {
        Self { reason: Some(loss.text()), loss: Some(loss), ..Self::of(TrackingState::Lost) }
    }

    /// A report that says no more than the state.
    pub(super) fn of(state: TrackingState) -> Self {
        Self {
            state,
            fragment: 0,
            world_from_camera: None,
            covariance: None,
            scale_break: None,
            new_keyframe: None,
            settled_keyframes: Vec::new(),
            adopted: None,
            deltas: Vec::new(),
            closed_loop: None,
            inlier_share: 0.0,
            rmse: 0.0,
            matched_points: 0,
            reason: None,
            loss: None,
            claim: None,
        }
    }
}
