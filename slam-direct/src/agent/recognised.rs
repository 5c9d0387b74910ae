//! Adopts a pose that was proposed by features.

use super::claim::FoundFrame;
use super::{Agent, AgentError, Frame, FrameReport, State, TrackingState};
use crate::local_map::LocalMap;
use crate::recognise::{Answer, Hypothesis, KnownView};
use crate::tracker::{Located, Tracker};
use geometry::sensor::Twist;
use geometry::{GrayImage, Pyramid, Se3};
use map::FramePose;

/// A frame that was found, and how.
struct Relocalised {
    tracker: Box<Tracker>,
    located: Located,
    pyramid: Pyramid,
    newest: Frame,
    /// Of the frames before it.
    before: Vec<FoundFrame>,
}

impl Agent {
    /// Seeks a frame in the map of an agent that other frames were not given to; nothing changes when it is not there.
    ///
    /// # Errors
    /// Those of [`process`](Self::process).
    pub(crate) fn relocalise(&mut self, frame: &Frame) -> Result<Option<FrameReport>, AgentError> {
        self.check_size(frame.index, &frame.image)?;
        self.keep_color(frame.index, frame.color.as_ref());
        let mut tracker = match std::mem::replace(&mut self.state, State::Empty) {
            State::Running(tracker) => tracker,
            other => {
                self.state = other;
                return Ok(None);
            }
        };
        self.processed += 1;
        self.claim = None;
        let pyramid = self.pyramid(frame.image.clone());
        let mut report = FrameReport::of(TrackingState::Tracking);
        self.end_stale_claim(&tracker, frame.timestamp);
        let is_claim = self.is_cut_off(&tracker, frame.timestamp);
        let Some(located) = self.locate(&mut tracker, &pyramid, frame.timestamp, &mut report) else {
            self.state = State::Running(tracker);
            return Ok(None);
        };
        if is_claim {
            let at = (frame.timestamp, frame.index);
            let report = self.try_claim(tracker, &located, pyramid, at, report);
            return Ok((report.state == TrackingState::Tracking).then(|| self.with_deltas(report)));
        }
        let report = self.go_on(tracker, &located, pyramid, (frame.timestamp, frame.index), report);
        Ok(Some(self.with_deltas(report)))
    }

    /// The keyframes with depth, as those of `fragment`, called as in the working map.
    pub(crate) fn known_views(&self, fragment: usize) -> Vec<KnownView> {
        let of_others = self.common.iter().flat_map(|common| common.keyframes.values());
        let of_others = of_others.map(|k| (k.id, self.view.world_from_keyframe(k.id.0 as usize), k));
        let own = self.map.keyframes.values();
        let own = own.map(|k| (self.working_id(k.id), k.world_from_keyframe, k));
        let with_depth = of_others.chain(own).filter(|(.., keyframe)| !keyframe.semi_dense.is_empty());
        let view = |(id, world_from_keyframe, keyframe): (_, _, &map::Keyframe)| KnownView {
            fragment,
            keyframe: id,
            image: keyframe.image.clone(),
            world_from_keyframe,
            semi_dense: keyframe.semi_dense.clone(),
            features: keyframe.features.clone(),
        };
        with_depth.map(view).collect()
    }

    /// An image as the keyframes are: brightened where they are.
    pub(crate) fn toned(&self, image: &GrayImage) -> GrayImage {
        self.tone.as_ref().map_or_else(|| image.clone(), |tone| tone.apply(image))
    }

    /// Finds a frame where it is supposed to have been taken, follows the camera from there to those before and after it, and
    /// takes the newest into the map. Nothing changes when the frame or the newest is not there.
    ///
    /// # Errors
    /// Those of [`process`](Self::process).
    pub(crate) fn adopt_hypothesis(
        &mut self,
        hypothesis: &Hypothesis,
        answer: &Answer,
    ) -> Result<Option<FrameReport>, AgentError> {
        let frame = &answer.frame;
        self.check_size(frame.index, &frame.image)?;
        let mut former = match std::mem::replace(&mut self.state, State::Empty) {
            State::Running(tracker) => tracker,
            other => {
                self.state = other;
                return Ok(None);
            }
        };
        let mut report = FrameReport::of(TrackingState::Tracking);
        let is_claim = self.is_cut_off(&former, frame.timestamp);
        // All that is known of the map is to be sought.
        self.adopt_mapping(&mut former, &mut report);
        let Some(found) = self.find(hypothesis, answer) else {
            self.state = State::Running(former);
            return Ok(None);
        };
        self.processed += 1;
        self.claim = None;
        let Frame { timestamp, index, .. } = found.newest;
        self.keep_color(index, found.newest.color.as_ref());
        if is_claim {
            return Ok(self.begin_claim(found, (timestamp, index), report));
        }
        let known = self.map.frames.len();
        let report = self.go_on(found.tracker, &found.located, found.pyramid, (timestamp, index), report);
        // The newest may have become the keyframe that those before it are told by.
        self.insert_frames(known, found.before.into_iter().map(|frame| frame.pose).collect());
        Ok(Some(self.with_deltas(report)))
    }

    /// The newest frame, tracked from the one that is supposed to be at a place.
    fn find(&self, hypothesis: &Hypothesis, answer: &Answer) -> Option<Relocalised> {
        let reference = hypothesis.keyframe.0 as usize;
        if reference >= self.view.keyframes.len() {
            return None;
        }
        let Answer { frame, before, after, .. } = answer;
        let supposed = self.view.camera_from_world(reference, &hypothesis.keyframe_from_frame);
        let tracker = Tracker::new(&self.view, reference, supposed, Se3::identity(), &self.params);
        let mut tracker = Box::new(tracker.seeking());
        let mut pyramid = self.pyramid(frame.image.clone());
        let mut located = tracker.find_at(&self.view, &supposed, &pyramid, frame.timestamp, &self.params)?;
        let mut poses = self.followed_back(&tracker, frame, before);
        poses.push(self.on_trial(frame, &pyramid, &tracker, located.motion));
        for frame in after {
            tracker.change_reference(&self.view, &located, &self.params);
            pyramid = self.pyramid(frame.image.clone());
            let places = self.mapper.as_ref().map(|mapper| mapper.places.as_ref());
            located = tracker.track(&self.view, places, &pyramid, frame.timestamp, &self.params)?;
            if !located.is_of_most() {
                return None;
            }
            poses.push(self.on_trial(frame, &pyramid, &tracker, located.motion));
        }
        // The newest gets its place in the map by going on from it.
        poses.pop();
        let newest = after.last().unwrap_or(frame).clone();
        Some(Relocalised { tracker, located, pyramid, newest, before: poses })
    }

    /// Poses of the frames before one that was found, as far as the camera can be followed back.
    fn followed_back(&self, found: &Tracker, frame: &Frame, before: &[Frame]) -> Vec<FoundFrame> {
        let still = Se3::identity();
        let tracker = Tracker::new(&self.view, found.reference, found.last, still, &self.params);
        let mut tracker = tracker.at(frame.timestamp);
        let places = self.mapper.as_ref().map(|mapper| mapper.places.as_ref());
        let follow = |frame: &Frame| {
            let pyramid = self.pyramid(frame.image.clone());
            let located = tracker.track(&self.view, places, &pyramid, frame.timestamp, &self.params)?;
            Some(self.on_trial(frame, &pyramid, &tracker, located.motion))
        };
        let mut poses: Vec<FoundFrame> = before.iter().rev().map_while(follow).collect();
        poses.reverse();
        poses
    }

    /// Puts frames that were found while nothing leads to them on trial.
    fn begin_claim(
        &mut self,
        found: Relocalised,
        at: (f64, u64),
        report: FrameReport,
    ) -> Option<FrameReport> {
        let Relocalised { tracker, located, pyramid, before, .. } = found;
        self.trial = None;
        self.put_on_trial(before);
        let report = self.try_claim(tracker, &located, pyramid, at, report);
        (report.state == TrackingState::Tracking).then(|| self.with_deltas(report))
    }

    /// A frame with the newest pose of a tracker.
    fn on_trial(&self, frame: &Frame, pyramid: &Pyramid, tracker: &Tracker, motion: Twist) -> FoundFrame {
        self.found_at((frame.timestamp, frame.index), pyramid, tracker, motion)
    }

    /// A frame of this time and index with the newest pose of a tracker.
    pub(super) fn found_at(
        &self,
        at: (f64, u64),
        pyramid: &Pyramid,
        tracker: &Tracker,
        motion: Twist,
    ) -> FoundFrame {
        let pose = self.pose_of(at, tracker);
        FoundFrame { pose, image: pyramid.shared_base(), motion }
    }

    /// The newest pose of a tracker, which is that of a frame of this time and index.
    pub(super) fn pose_of(&self, (timestamp, frame_index): (f64, u64), tracker: &Tracker) -> FramePose {
        FramePose {
            timestamp,
            frame_index,
            reference: LocalMap::id(tracker.reference),
            keyframe_from_frame: self.view.keyframe_from_frame(tracker.reference, &tracker.last),
        }
    }
}
