//! Joins fragments during the run. A keyframe of the active fragment is recognised in an earlier one, as a lost frame
//! would be. When two such keyframes agree on the relative pose of the fragments, their maps become one.

use super::Atlas;
use crate::agent::{AgentError, FrameReport, Joining, Sighting, TrackingState};
use crate::frame::Frame;
use crate::recognise::Answer;
use std::collections::BTreeMap;

/// Most sightings that are remembered.
const REMEMBERED: usize = 40;

/// How many times the frames of a keyframe's mapping joining takes at the least.
const JOINING: usize = 10;

/// How far it is between the active fragment and those before it.
#[derive(Default)]
pub(super) struct FragmentJoin {
    /// Keyframes of the active fragment that were found in earlier ones, the newest last.
    sightings: Vec<Sighting>,
    joining: Option<PendingJoin>,
    /// Earlier fragments that this one was not joined with, and from how many keyframes of it on that is tried again.
    refused: BTreeMap<usize, usize>,
}

/// Maps being joined.
struct PendingJoin {
    joining: Joining,
    /// The earlier fragment, which takes in the later one.
    into: usize,
    of: usize,
    /// Frames until the result is taken up.
    left: usize,
}

impl Atlas {
    /// A frame of a camera that is tracked in another fragment than the first.
    pub(super) fn follow_apart(&mut self, frame: Frame) -> Result<FrameReport, AgentError> {
        if let Some(pending_join) = &mut self.fragment_join.joining {
            pending_join.left = pending_join.left.saturating_sub(1);
            if pending_join.left == 0 {
                self.end_joining()?;
            }
        }
        let report = self.fragments[self.active].process(frame.clone())?;
        if report.state == TrackingState::Tracking {
            self.detect_join(&frame, report.new_keyframe.is_some());
            return Ok(report);
        }
        self.recognition.pass(self.recognition_lag());
        if self.fragment_join.joining.is_none() {
            return Ok(report);
        }
        // Its map was away, and it was sought in the view of it only.
        let left = self.active;
        self.end_joining()?;
        if self.active == left {
            self.fragments[left].return_deltas(report.deltas);
        }
        self.fragments[self.active].process(frame)
    }

    /// Has keyframes recognised in earlier fragments, and begins to join when what was found suffices.
    fn detect_join(&mut self, frame: &Frame, is_keyframe: bool) {
        if self.fragment_join.joining.is_some() {
            self.recognition.pass(self.recognition_lag());
            return;
        }
        let answer = self.recognition.next(frame, self.recognition_lag());
        if let Some(answer) = answer {
            self.add_sightings(&answer);
        }
        if is_keyframe && self.recognition.is_idle() && self.fragment_join.joining.is_none() {
            self.ask(frame, self.active);
        }
    }

    /// Looks after what was proposed for a keyframe.
    fn add_sightings(&mut self, answer: &Answer) {
        let (earlier, rest) = self.fragments.split_at_mut(self.active);
        let Some(active) = rest.first_mut() else { return };
        for hypothesis in &answer.hypotheses {
            let Some(agent) = earlier.get_mut(hypothesis.fragment) else { continue };
            let keyframes = active.map().keyframes.len();
            if self.fragment_join.refused.get(&hypothesis.fragment).is_some_and(|&from| keyframes < from) {
                continue;
            }
            let Some(sighting) = agent.sight(hypothesis, &answer.frame, active) else { continue };
            let sightings = &mut self.fragment_join.sightings;
            if sightings.len() == REMEMBERED {
                sightings.remove(0);
            }
            sightings.push(sighting);
            if let Some(joining) = agent.begin_joining(active, sightings) {
                let (into, of) = (sighting.fragment, self.active);
                let left = self.params.atlas.joining_lag.max(JOINING * self.params.mapping.lag);
                self.fragment_join.joining = Some(PendingJoin { joining, into, of, left });
                return;
            }
        }
    }

    /// Takes up the map that two fragments were made, or goes on in both as before.
    pub(super) fn end_joining(&mut self) -> Result<(), AgentError> {
        let Some(PendingJoin { joining, into, of, .. }) = self.fragment_join.joining.take() else {
            return Ok(());
        };
        self.fragment_join.sightings.clear();
        let (earlier, rest) = self.fragments.split_at_mut(of);
        let (Some(first), Some(second)) = (earlier.get_mut(into), rest.first_mut()) else { return Ok(()) };
        let keyframes = second.map().keyframes.len();
        let is_joined = first.end_joining(second, joining, (self.new_places)())?;
        if !is_joined {
            // Until there is more to see.
            self.fragment_join.refused.insert(into, keyframes + keyframes / 2);
        } else if self.active == of {
            self.active = into;
        }
        Ok(())
    }
}
