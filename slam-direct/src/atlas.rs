//! Continuing after a loss: a new map begins while the old one is still searched (ORB-SLAM3's Atlas; Campos et al.,
//! T-RO 2021, §VI-C).
//!
//! A run is then a list of *fragments*: maps with a world and a unit of their own, each made by an [`Agent`]. The
//! crate `merge` joins them like the maps of several agents. For that the camera must see one place again.

mod joining;
pub(crate) mod params;
mod splitting;

use crate::agent::{Agent, AgentError, Claim, FrameReport, ResumeMode, TrackingState};
use crate::exposure::Exposure;
use crate::frame::{Frame, LossReason};
use crate::judge::JudgePlace;
use crate::params::Params;
use crate::recognise::{Recognise, Recognition};
use crate::scale::ScaleBreak;
use geometry::{GrayImage, Image, Pinhole, Swap};
use joining::FragmentJoin;
use map::{KeyframeId, Map, MapDelta, PlaceIndex, SharedBytes};
pub use params::AtlasParams;
use std::sync::Arc;

/// A run that survives losses: it gives frames to one agent, and after a loss to the next.
pub struct Atlas {
    camera: Pinhole,
    new_places: fn() -> Box<dyn PlaceIndex>,
    params: Params,
    /// In the order they were begun. There is always one.
    fragments: Vec<Agent>,
    /// The fragment that the newest frame was given to.
    active: usize,
    loss: Option<Loss>,
    /// Who recognises places from elsewhere.
    recognition: Recognition,
    /// Of the active fragment's keyframes in earlier ones, which are joined by them.
    fragment_join: FragmentJoin,
    /// The fragment that is to be parted, and where.
    scale_break: Option<(usize, ScaleBreak)>,
    exposure: Exposure,
    /// Where the keyframes' images and depths are kept, as far as it has room.
    swap: Option<Arc<dyn Swap>>,
    /// Who decides whether a place is the one that it is taken for.
    judge: Option<Arc<dyn JudgePlace>>,
}

/// Seconds for which a camera is not sought in a map that it left because a part of it moved: what left is in view still, most of what is found again is as likely
/// it as what stands still, and a camera that moves begins a map of its own by then, which tells. One at rest is found again where it was.
pub const SPLIT_FOR: f64 = 5.0;

/// What is done about a loss.
struct Loss {
    /// Time stamp of the first frame without a pose, seconds.
    since: f64,
    /// Frames since then.
    frames: usize,
    /// The next fragment, until it has proved itself or the camera is found in an old one.
    next: Option<Box<Agent>>,
    /// Whether what was found in a fragment since then was not believed, or nothing could be compared with it.
    is_evaluated: bool,
}

impl Atlas {
    /// A run without a map. `new_places` makes the index by which a fragment finds its own places again.
    ///
    /// # Errors
    /// When the camera or a parameter cannot be used.
    pub fn new(
        camera: Pinhole,
        new_places: fn() -> Box<dyn PlaceIndex>,
        params: Params,
    ) -> Result<Self, AgentError> {
        let first = Agent::new(camera, new_places(), params.clone())?;
        Ok(Self::resume(first, new_places, params))
    }

    /// A run that continues in the map of `first`, which was resumed. As long as no frame is found there, a new
    /// fragment begins beside the search, as after a loss. An agent that only localises continues to search.
    pub fn resume(first: Agent, new_places: fn() -> Box<dyn PlaceIndex>, params: Params) -> Self {
        Self {
            camera: first.camera(),
            new_places,
            params,
            fragments: vec![first],
            active: 0,
            loss: None,
            recognition: Recognition::none(),
            fragment_join: FragmentJoin::default(),
            scale_break: None,
            exposure: Exposure::default(),
            swap: None,
            judge: None,
        }
    }

    /// The same run, in which `recogniser` proposes where frames were taken.
    pub fn recognising(self, recogniser: Box<dyn Recognise>) -> Self {
        Self { recognition: Recognition::by(recogniser), ..self }
    }

    /// The same run with a judge. Poses that no motion leads to (after a loss, or at the start of a resumed map) are
    /// not published and make no keyframes, and fragments are not joined, until `judge` has decided on what they
    /// show.
    pub fn judge_by(mut self, judge: Arc<dyn JudgePlace>) -> Self {
        self.fragments.iter_mut().for_each(|agent| agent.judge_by(Arc::clone(&judge)));
        Self { judge: Some(judge), ..self }
    }

    /// The same run, which moves keyframes to `swap` (see [`Agent::swap_to`]).
    pub fn swapping_to(mut self, swap: Arc<dyn Swap>) -> Self {
        for agent in &mut self.fragments {
            agent.swap_to(Arc::clone(&swap));
        }
        Self { swap: Some(swap), ..self }
    }

    /// The same run, which ignores these pixels of the images (see [`Agent::leave_out`]); later agents inherit them.
    ///
    /// # Errors
    /// When the mask is not of the camera's size.
    pub fn with_mask(mut self, unused: &Image<bool>) -> Result<Self, AgentError> {
        let unused = Arc::new(unused.clone());
        self.fragments.iter_mut().try_for_each(|agent| agent.leave_out(Arc::clone(&unused)))?;
        Ok(self)
    }

    /// Frames after which what was proposed is taken up. Where mapping takes time, so does this: five times as much.
    fn recognition_lag(&self) -> usize {
        self.params.atlas.recognition_lag.max(5 * self.params.mapping.lag)
    }

    /// Tracks a frame in the active fragment, or in the one where it is found again, and maps what it adds. The
    /// report names the fragment.
    ///
    /// # Errors
    /// Those of [`Agent::process`].
    pub fn process(&mut self, frame: Frame) -> Result<FrameReport, AgentError> {
        let frame = Frame { image: self.exposure.even(frame.image), ..frame };
        let report = match self.loss.take() {
            None => self.follow(frame),
            Some(loss) => self.recover(loss, frame),
        };
        let report = self.split_at_break(report?)?;
        Ok(FrameReport { fragment: self.active, ..report })
    }

    /// A frame of a camera that was not lost.
    fn follow(&mut self, frame: Frame) -> Result<FrameReport, AgentError> {
        let timestamp = frame.timestamp;
        let report = if self.active == 0 {
            self.recognition.pass(self.recognition_lag());
            self.fragments[0].process(frame)?
        } else {
            self.follow_apart(frame)?
        };
        if report.state == TrackingState::Lost {
            self.loss = Some(Loss { since: timestamp, frames: 1, next: None, is_evaluated: false });
        }
        Ok(report)
    }

    /// A frame of a lost camera: sought in the fragments, and given to the one that may come next.
    fn recover(&mut self, mut loss: Loss, frame: Frame) -> Result<FrameReport, AgentError> {
        let report = self.search_fragments(&mut loss, &frame)?;
        if report.state != TrackingState::Lost {
            return Ok(report);
        }
        loss.frames += 1;
        let may_begin = self.fragments[self.active].resumed() != Some(ResumeMode::Localising);
        if may_begin && loss.next.is_none() && frame.timestamp - loss.since >= self.params.atlas.begin_after {
            let mut next = Agent::new(self.camera, (self.new_places)(), self.params.clone())?;
            next.know_sensor_of(&self.fragments[self.active]);
            if let Some(swap) = &self.swap {
                next.swap_to(Arc::clone(swap));
            }
            if let Some(judge) = &self.judge {
                next.judge_by(Arc::clone(judge));
            }
            loss.next = Some(Box::new(next));
        }
        let Some(next) = &mut loss.next else {
            self.loss = Some(loss);
            return Ok(report);
        };
        let of_next = next.process(frame)?;
        // What was found elsewhere is heard first.
        let may_begin = loss.is_evaluated || self.fragments.iter().all(|agent| !agent.is_on_trial());
        if may_begin && of_next.state == TrackingState::Tracking && !next.is_young() {
            self.fragments[self.active].return_deltas(report.deltas);
            self.begin_fragment(loss);
            return Ok(of_next);
        }
        next.return_deltas(of_next.deltas);
        self.loss = Some(loss);
        Ok(report)
    }

    /// Seeks the frame of a lost camera in the fragments: while it was found in one and that is on trial, there alone; rarely while the
    /// one that may come next is tracked.
    fn search_fragments(&mut self, loss: &mut Loss, frame: &Frame) -> Result<FrameReport, AgentError> {
        if let Some(fragment) = self.claimed() {
            self.recognition.pass(self.recognition_lag());
            let report = self.follow_claim(fragment, frame)?;
            loss.is_evaluated |= matches!(report.claim, Some(Claim::Refused | Claim::Undecided));
            return Ok(report);
        }
        if let Some(found) = self.recognised(loss, frame)? {
            return Ok(found);
        }
        if self.claimed().is_some() {
            return Ok(FrameReport::on_trial());
        }
        let is_tracked = loss.next.as_ref().is_some_and(|next| !next.map().frames.is_empty());
        if is_tracked && !loss.frames.is_multiple_of(self.params.atlas.search_interval.max(1)) {
            return Ok(FrameReport::lost(LossReason::NotFound));
        }
        let (left, report) = (self.active, self.fragments[self.active].process(frame.clone())?);
        if report.state != TrackingState::Lost || report.claim.is_some() {
            return Ok(report);
        }
        let Some(found) = self.search_other_fragments(loss, frame)? else { return Ok(report) };
        self.fragments[left].return_deltas(report.deltas);
        Ok(found)
    }

    /// The fragment in which the camera was found, where that is on trial.
    fn claimed(&self) -> Option<usize> {
        self.fragments.iter().position(Agent::is_on_trial)
    }

    /// A frame of a camera that was found in a fragment, which is on trial.
    fn follow_claim(&mut self, fragment: usize, frame: &Frame) -> Result<FrameReport, AgentError> {
        if fragment == self.active {
            return self.fragments[fragment].process(frame.clone());
        }
        let found = self.fragments[fragment].relocalise(frame)?;
        if found.is_some() {
            self.activate(fragment);
        }
        let claim = self.fragments[fragment].claim();
        Ok(found.unwrap_or(FrameReport { claim, ..FrameReport::on_trial() }))
    }

    /// Has it proposed by features where a lost frame was taken, and takes up what was proposed for an earlier one.
    fn recognised(&mut self, loss: &Loss, frame: &Frame) -> Result<Option<FrameReport>, AgentError> {
        let is_split =
            self.fragments[self.active].saw_two_motions() && frame.timestamp - loss.since < SPLIT_FOR;
        if let Some(answer) = self.recognition.next(frame, self.recognition_lag()) {
            for hypothesis in &answer.hypotheses {
                if is_split && hypothesis.fragment == self.active {
                    continue;
                }
                let Some(agent) = self.fragments.get_mut(hypothesis.fragment) else { continue };
                if let Some(found) = agent.adopt_hypothesis(hypothesis, &answer)? {
                    self.activate(hypothesis.fragment);
                    return Ok(Some(found));
                }
                if agent.is_on_trial() {
                    return Ok(None);
                }
            }
        }
        if self.recognition.is_idle() {
            self.ask(frame, self.fragments.len());
        }
        Ok(None)
    }

    /// Has a frame recognised in the first so many fragments.
    fn ask(&mut self, frame: &Frame, fragments: usize) {
        let views = |(fragment, agent): (usize, &Agent)| agent.known_views(fragment);
        let views = self.fragments.iter().enumerate().take(fragments).flat_map(views).collect();
        let image = self.fragments[self.active].toned(&frame.image);
        self.recognition.ask(frame, image, self.camera, views);
    }

    /// Seeks the frame in one of the fragments that the camera has left, another one with every search.
    fn search_other_fragments(
        &mut self,
        loss: &Loss,
        frame: &Frame,
    ) -> Result<Option<FrameReport>, AgentError> {
        let others = self.fragments.len() - 1;
        if others == 0 {
            return Ok(None);
        }
        let number = loss.frames % others;
        let index = if number < self.active { number } else { number + 1 };
        let report = self.fragments[index].relocalise(frame)?;
        if report.is_some() {
            self.activate(index);
        }
        Ok(report)
    }

    /// The next fragment has proved itself. A map that did not come beyond its start is not worth keeping beside it.
    fn begin_fragment(&mut self, loss: Loss) {
        self.fragments.iter_mut().for_each(Agent::drop_claim);
        if self.fragments[self.active].is_young() {
            self.fragments.remove(self.active);
        }
        self.fragments.extend(loss.next.map(|next| *next));
        self.activate(self.fragments.len() - 1);
    }

    /// Goes on in a fragment.
    fn activate(&mut self, fragment: usize) {
        self.active = fragment;
        self.fragment_join = FragmentJoin::default();
    }

    /// The agent of the active fragment, which got the newest frame.
    pub fn active(&self) -> &Agent {
        &self.fragments[self.active]
    }

    /// The index of the active fragment, in the order in which they began.
    pub fn active_index(&self) -> usize {
        self.active
    }

    /// The fragments in the order in which they began; without a map there is one empty fragment.
    pub fn fragments(&self) -> &[Agent] {
        &self.fragments
    }

    /// The same, to take their maps.
    pub fn fragments_mut(&mut self) -> &mut [Agent] {
        &mut self.fragments
    }

    /// Ends the run: adopts the work in the background, and optimises every fragment a last time, until `stop` (see
    /// [`Agent::finish_until`]).
    pub fn finish_until(&mut self, stop: &dyn Fn() -> bool) {
        // A start that was tracked but had no time to prove itself holds poses that no other fragment has.
        let is_decided = self.claimed().is_some_and(|fragment| self.fragments[fragment].decide_claim());
        if let Some(loss) = self.loss.take().filter(|_| !is_decided)
            && loss.next.as_ref().is_some_and(|next| !next.map().frames.is_empty())
        {
            self.begin_fragment(loss);
        }
        // What cannot be made anew for want of an agent stays apart.
        let _ = self.end_joining();
        for fragment in &mut self.fragments {
            fragment.finish_until(stop);
        }
    }

    /// Stores the features of the keyframe with this image, whichever fragment has it; the next report of that
    /// fragment contains them.
    pub fn describe(&mut self, keyframe: KeyframeId, image: &Arc<GrayImage>, features: &SharedBytes) {
        self.fragments.iter_mut().any(|agent| agent.describe(keyframe, image, features.clone()));
    }

    /// The changes of the active fragment's map since its last report (see [`Agent::take_deltas`]).
    pub fn take_deltas(&mut self) -> Vec<MapDelta> {
        self.fragments[self.active].take_deltas()
    }

    /// Returns the maps of the fragments, in the order in which they began.
    pub fn into_maps(self) -> Vec<Map> {
        let maps = self.fragments.into_iter().map(Agent::into_map);
        // Of a fragment that was joined with an earlier one nothing is left.
        maps.filter(|map| !map.keyframes.is_empty()).collect()
    }
}

#[cfg(test)]
mod tests;
