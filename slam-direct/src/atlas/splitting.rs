//! Ends a fragment where its scale is not carried on. What came after it is the next fragment, in a unit of its own: places that both show
//! join them, as after a loss.

use super::Atlas;
use crate::agent::{AgentError, FrameReport, TrackingState};
use crate::scale::ScaleBreak;
use map::KeyframeId;

impl Atlas {
    /// Parts the active fragment where its scale was found not to be carried on, as soon as that may be and if it still is not; the
    /// report is then of the later part, and tells of it.
    pub(super) fn split_at_break(&mut self, mut report: FrameReport) -> Result<FrameReport, AgentError> {
        if let Some(found) = report.scale_break.take() {
            self.scale_break = Some((self.active, found));
        }
        // Where the camera went on in another fragment, the map is parted at the end of the run.
        self.scale_break = self.scale_break.filter(|(fragment, _)| *fragment == self.active);
        let Some((_, ScaleBreak { before, .. })) = self.scale_break else { return Ok(report) };
        let agent = &mut self.fragments[self.active];
        if report.state != TrackingState::Tracking || !agent.may_split_behind(before) {
            return Ok(report);
        }
        self.scale_break = None;
        let Some(found) = agent.scale_break_behind(before) else { return Ok(report) };
        agent.return_deltas(std::mem::take(&mut report.deltas));
        let Some(mut later) = agent.split_behind(before, (self.new_places)())? else { return Ok(report) };
        let report =
            FrameReport { scale_break: Some(found), deltas: later.take_deltas(), ..behind(report, before) };
        self.fragments.push(later);
        self.activate(self.fragments.len() - 1);
        Ok(report)
    }
}

/// A report by the names that keyframes behind this one have in a map of their own.
fn behind(report: FrameReport, before: KeyframeId) -> FrameReport {
    let own = |id: KeyframeId| Some(KeyframeId(id.0.checked_sub(before.0 + 1)?));
    FrameReport {
        new_keyframe: report.new_keyframe.and_then(own),
        settled_keyframes: report.settled_keyframes.iter().copied().filter_map(own).collect(),
        adopted: report.adopted.and_then(own),
        closed_loop: report.closed_loop.and_then(|(newer, older)| Some((own(newer)?, own(older)?))),
        ..report
    }
}
