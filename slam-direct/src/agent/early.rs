//! The start of a map: before it exists, while it is young, and giving up a useless one.

use super::mapper::MapQuality;
use super::{Agent, FrameReport, State, TrackingState};
use crate::bootstrap::{Bootstrap, Progress, SecondLook, Started, TWO_MOTIONS};
use crate::local_map::{Counts, LocalMap};
use crate::publish;
use crate::tracker::Tracker;
use geometry::{GrayImage, Pyramid, Se3};
use map::{FramePose, Map, MapDelta};
use std::sync::Arc;

/// A frame from before the first map, kept until the map is finished, in which it is sought.
pub(super) struct EarlyFrame {
    pub timestamp: f64,
    pub frame_index: u64,
    pub image: Arc<GrayImage>,
}

/// Bytes of early images that are kept at most: eleven seconds of 640 × 480 pixels at 30 Hz, 3.6 of 1280 × 720.
const MAX_EARLY: usize = 100 << 20;

impl Agent {
    /// Keeps a frame for [`find_early`](Self::find_early).
    pub(super) fn keep_early(&mut self, timestamp: f64, frame_index: u64, image: Arc<GrayImage>) {
        self.early.push(EarlyFrame { timestamp, frame_index, image });
        forget_oldest(&mut self.early);
    }

    /// The early frames of the map and of those that it took in, in order of time.
    pub(super) fn take_early(&mut self) -> Vec<EarlyFrame> {
        self.keep_before_map();
        std::mem::take(&mut self.before_map)
    }

    /// Keeps the frames before the first keyframe, now that there will be no other.
    fn keep_before_map(&mut self) {
        let first = self.view.keyframes.first().map_or(0, |keyframe| keyframe.frame_index);
        let before = self.early.drain(..).filter(|frame| frame.frame_index < first);
        let resting = |frame: EarlyFrame| {
            let swapped = self.swap.as_ref().and_then(|swap| frame.image.swapped_out(&**swap));
            EarlyFrame { image: swapped.map_or(frame.image, Arc::new), ..frame }
        };
        self.before_map.extend(before.map(resting));
    }

    /// Takes over the early frames of an agent whose map was taken in.
    pub(super) fn take_in_early(&mut self, mut other: Vec<EarlyFrame>) {
        self.keep_before_map();
        self.before_map.append(&mut other);
        forget_oldest(&mut self.before_map);
    }

    /// Begins a start with this frame; `reason` says why there is no map yet if the image will do.
    pub(super) fn begin(
        &mut self,
        pyramid: Pyramid,
        timestamp: f64,
        index: u64,
        mut reason: &'static str,
    ) -> FrameReport {
        match self.fresh_start(pyramid, timestamp, index) {
            Some(start) => self.state = State::Starting(Box::new(start)),
            None => reason = "the image has too little texture",
        }
        FrameReport { reason: Some(reason), ..FrameReport::of(TrackingState::Starting) }
    }

    /// A start that begins with a frame; nothing when it has too little texture.
    fn fresh_start(&self, pyramid: Pyramid, timestamp: f64, index: u64) -> Option<Bootstrap> {
        let (mask, block) = (self.learner.mask(), self.params.bootstrap.block);
        let sensor = self.mapper.as_ref().map_or(self.view.sensor, |mapper| mapper.local.sensor);
        Bootstrap::new(sensor, pyramid, timestamp, index, mask, block)
    }

    /// Takes a frame into the start; the first map when it suffices.
    pub(super) fn start(
        &mut self,
        mut start: Box<Bootstrap>,
        pyramid: Pyramid,
        timestamp: f64,
        index: u64,
    ) -> FrameReport {
        start.leave_out(self.learner.mask());
        match start.add(&pyramid, timestamp, index, &self.params) {
            Progress::Waiting(reason) => {
                self.state = State::Starting(start);
                FrameReport { reason: Some(reason), ..FrameReport::of(TrackingState::Starting) }
            }
            Progress::Restart(reason) => self.begin(pyramid, timestamp, index, reason),
            Progress::Done(started) => {
                self.provisional = Some(start);
                self.adopt(*started)
            }
        }
    }

    /// Looks at the map again, now that this frame was tracked in it: a map that is contradicted gives way to what is seen
    /// now, and the frame is then its newest.
    pub(super) fn look_again(
        &mut self,
        mut start: Box<Bootstrap>,
        pyramid: &Pyramid,
        timestamp: f64,
        index: u64,
    ) -> Option<FrameReport> {
        if !matches!(self.state, State::Running(_)) {
            return None;
        }
        start.leave_out(self.learner.mask());
        let look = {
            let first = self.camera_from_world(start.first_frame());
            let frame_from_first = |index: u64| Some(self.camera_from_world(index)? * first?.inverse());
            start.look_again(pyramid, (timestamp, index), &frame_from_first, &self.params)
        };
        match look {
            SecondLook::Over => {
                self.end_early();
                None
            }
            SecondLook::Nothing => {
                self.provisional = Some(start);
                None
            }
            SecondLook::Contradicted(started) => {
                self.abandon_map();
                self.provisional = Some(start);
                Some(self.adopt(*started))
            }
            SecondLook::TwoMotions => Some(self.begin_again(pyramid.clone(), timestamp, index, TWO_MOTIONS)),
        }
    }

    /// The pose that a frame has in the map.
    fn camera_from_world(&self, frame_index: u64) -> Option<Se3> {
        let frame = self.map.frames.iter().find(|frame| frame.frame_index == frame_index)?;
        let keyframe = frame.reference.0 as usize;
        let is_known = keyframe < self.view.keyframes.len();
        is_known.then(|| self.view.camera_from_world(keyframe, &frame.keyframe_from_frame))
    }

    /// Takes over the first map.
    fn adopt(&mut self, started: Started) -> FrameReport {
        let Started { map, frames } = started;
        let added = (0..map.keyframes.len()).map(|keyframe| publish::keyframe(&map, keyframe)).collect();
        self.apply_delta(MapDelta { added, ..MapDelta::default() });
        let first = &map.keyframes[0];
        let all =
            [(first.timestamp, first.frame_index, Se3::identity())].into_iter().chain(frames.iter().copied());
        self.map.frames = all
            .map(|(timestamp, frame_index, frame_from_first)| FramePose {
                timestamp,
                frame_index,
                reference: LocalMap::id(0),
                keyframe_from_frame: frame_from_first.inverse(),
            })
            .collect();
        let newest = &map.keyframes[1];
        self.refer_newest_frame(1, (newest.timestamp, newest.frame_index));
        if let Some(mapper) = &mut self.mapper {
            let map = LocalMap { mask: Arc::clone(self.learner.mask()), ..map };
            let update = mapper.adopt(map, &self.params);
            self.view = update.view;
            self.apply_delta(update.delta);
        }
        let last = self.view.keyframes[1].camera_from_world;
        let velocity = match frames.as_slice() {
            [.., before, newest] => newest.2 * before.2.inverse(),
            _ => last,
        };
        let time = self.view.keyframes[1].timestamp;
        let tracker = Tracker::new(&self.view, 1, last, velocity, &self.params).at(time);
        self.state = State::Running(Box::new(tracker));
        FrameReport {
            world_from_camera: Some(last.inverse()),
            new_keyframe: Some(LocalMap::id(1)),
            inlier_share: 1.0,
            matched_points: self.view.keyframes[1].seen.len(),
            ..FrameReport::of(TrackingState::Tracking)
        }
    }

    /// Whether a young map has proved useless: nothing that follows fits it.
    pub(super) fn was_bad_start(&self, tracker: &Tracker, timestamp: f64) -> bool {
        let p = &self.params.keyframes;
        let is_given_up =
            tracker.lost_frames() >= p.give_up && tracker.seconds_lost(timestamp) >= p.give_up_after;
        self.is_young() && is_given_up
    }

    /// Gives the map up and begins a start with this frame, which is kept as all frames of a young map are; `None` when it has too little
    /// texture: a dark image says nothing about the map.
    pub(super) fn begin_anew(
        &mut self,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
    ) -> Option<FrameReport> {
        let fresh = self.fresh_start(pyramid, timestamp, frame_index)?;
        self.forget();
        self.state = State::Starting(Box::new(fresh));
        let reason = Some("the first map was of no use");
        Some(FrameReport { reason, ..FrameReport::of(TrackingState::Starting) })
    }

    /// Gives up a map that proves wrong for this reason: it was begun before it was known that something moves with the camera, whose
    /// points said that the camera stands still, or of a motion that was none, or of two. The frames so far are found in the map that comes of this
    /// one.
    pub(super) fn begin_again(
        &mut self,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        why: &'static str,
    ) -> FrameReport {
        self.abandon_map();
        self.begin(pyramid, timestamp, frame_index, why)
    }

    /// Keeps the frames from before the first map alone, once neither it nor what moves with the camera is in question.
    pub(super) fn end_early(&mut self) {
        let is_open = self.learner.is_new() || self.map_quality == MapQuality::Open;
        if self.provisional.is_none() && !is_open && !self.is_young() {
            self.keep_before_map();
        }
    }

    /// Ends the tracking, waits for what is being mapped, and drops the map.
    fn abandon_map(&mut self) {
        if let State::Running(mut tracker) = std::mem::replace(&mut self.state, State::Empty) {
            self.adopt_mapping(&mut tracker, &mut FrameReport::of(TrackingState::Tracking));
        }
        self.forget();
    }

    /// Drops the map to start anew.
    fn forget(&mut self) {
        self.early.splice(0..0, std::mem::take(&mut self.before_map));
        let agents = std::mem::take(&mut self.map.agents);
        self.map = Map { agents, ..Map::new(self.camera) };
        self.next_sequence = 0;
        self.pending_deltas.clear();
        self.view = LocalMap::new(self.camera);
        self.closed.clear();
        self.mapper = self.mapper.take().map(|mapper| Box::new(mapper.forget()));
        self.counts = Counts::default();
        self.fresh = None;
        self.motions.clear();
        self.companions.clear();
        self.first_open = 0;
        self.provisional = None;
        (self.trial, self.is_unsettled) = (None, false);
        self.map_quality = MapQuality::Open;
        self.learner.change_world();
    }
}

/// Leaves out the oldest frames, so that the others, whose images are of one size, have room.
fn forget_oldest(early: &mut Vec<EarlyFrame>) {
    let bytes = early.first().map_or(1, |frame| frame.image.data().len());
    early.drain(..early.len().saturating_sub(MAX_EARLY / bytes));
}
