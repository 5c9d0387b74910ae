//! The agent: one camera's tracker and map, and how a frame passes through them.
//!
//! The tracker works on a view of the map; the [`Mapper`] owns the map. The tracker gives a frame that becomes a
//! keyframe to the mapper, and adopts the result [`MappingParams::lag`] frames later. This is a number of frames and
//! not a time, so that results do not depend on the speed of the mapper. Until then the tracker uses the keyframe as
//! it was, with the points by which it was found.
//!
//! [`MappingParams::lag`]: crate::mapping::MappingParams::lag

mod across;
mod before;
mod claim;
mod colors;
mod common;
mod depth_tasks;
mod early;
mod error;
mod joining;
mod joint_optimisation;
mod keyframe_insertion;
mod mapper;
mod masking;
mod output;
mod recognised;
mod report;
mod resume;
mod shutter;
mod splitting;

pub use common::Joint;
pub use error::AgentError;
pub(crate) use joining::{Joining, Sighting};
pub use joint_optimisation::optimise_jointly;
pub use report::{Claim, FrameReport, TrackingState};
pub use resume::{ResumeMode, edges_of};

use crate::bootstrap::Bootstrap;
use crate::dense;
use crate::frame::{Frame, LazyColor, LossReason};
use crate::judge::JudgePlace;
use crate::local_map::{Companions, Counts, LocalMap};
use crate::mask::MaskLearner;
use crate::params::Params;
use crate::tone::Tone;
use crate::track::learn_position_sigma;
use crate::tracker::{Located, Tracker};
use claim::Trial;
use early::EarlyFrame;
use geometry::sensor::Twist;
use geometry::{GrayImage, Pinhole, Pyramid, Swap};
use keyframe_insertion::PendingMapping;
use map::{Edge, FramePose, KeyframeId, Map, MapDelta, PlaceIndex};
use mapper::{MapQuality, Mapper};
use shutter::ShutterQuestion;
use std::collections::BTreeMap;
use std::sync::Arc;

/// One camera's tracker and map. Frames come in order of time.
pub struct Agent {
    camera: Pinhole,
    params: Params,
    /// The map as it is handed out.
    map: Map,
    /// Deltas said of it.
    next_sequence: u64,
    /// Those that no report has told of yet.
    pending_deltas: Vec<MapDelta>,
    /// The map as the tracker knows it.
    view: LocalMap,
    /// Loops closed in it.
    closed: Vec<Edge>,
    state: State,
    /// Who owns the map, when nothing is being mapped.
    mapper: Option<Box<Mapper>>,
    /// What is being mapped.
    pending_mapping: Option<PendingMapping>,
    /// Threads of the mapper when it works beside the tracking.
    threads: Option<Arc<rayon::ThreadPool>>,
    /// Of the frames since the last keyframe.
    counts: Counts,
    /// The keyframe that the newest tracked frame became, if it did, and its mean motion since the frame before.
    fresh: Option<(usize, Twist)>,
    /// Motion of keyframes, now that the frame after is known; the mapper does not know it yet.
    motions: Vec<(usize, Twist)>,
    companions: Companions,
    /// The first keyframe for which companions are of use.
    first_open: usize,
    /// Frames processed.
    processed: u64,
    /// How dark images are brightened; the same for all frames of a map.
    tone: Option<Tone>,
    /// Frames since the start was begun, which the map that comes of it, or of the next, may know.
    early: Vec<EarlyFrame>,
    /// Those from before the first keyframe of the map, and of maps that it took in.
    before_map: Vec<EarlyFrame>,
    /// What moves with the camera.
    learner: MaskLearner,
    /// Whether something that was mapped has moved, in this map or one before it.
    something_moved: bool,
    /// Whether the map is of use, as far as its first keyframes have said.
    map_quality: MapQuality,
    /// The keyframe before the last break of the scale.
    last_break: Option<KeyframeId>,
    /// The start that the map came of, while more frames may contradict it.
    provisional: Option<Box<Bootstrap>>,
    /// What is done with the map, if it was given to the agent.
    resumed: Option<ResumeMode>,
    /// The common map of several agents that it goes on in, as one more of them, as it was given.
    common: Option<Box<Map>>,
    /// No frame was found in it yet.
    is_relocalising: bool,
    /// Who decides on poses that no motion leads to.
    judge: Option<Arc<dyn JudgePlace>>,
    /// A pose that is being decided on.
    trial: Option<Trial>,
    /// Since the camera was lost nothing was decided to be the place that it was found at.
    is_unsettled: bool,
    /// What became of a claim with the newest frame.
    claim: Option<Claim>,
    /// Whether the camera has a rolling shutter.
    shutter: ShutterQuestion,
    /// Where images of keyframes are kept, as far as it has room.
    swap: Option<Arc<dyn Swap>>,
    /// Colours of frames that may become keyframes, by the frames' indices.
    colors: BTreeMap<u64, LazyColor>,
}

enum State {
    Empty,
    Starting(Box<Bootstrap>),
    Running(Box<Tracker>),
}

impl Agent {
    /// A new agent with an empty map.
    ///
    /// # Errors
    /// When the camera or a parameter cannot be worked with.
    pub fn new(camera: Pinhole, places: Box<dyn PlaceIndex>, params: Params) -> Result<Self, AgentError> {
        params.validate()?;
        error::check_camera(&camera)?;
        let params = params.for_images_of(&camera);
        Ok(Self {
            camera,
            params,
            map: Map::new(camera),
            next_sequence: 0,
            pending_deltas: Vec::new(),
            view: LocalMap::new(camera),
            closed: Vec::new(),
            state: State::Empty,
            mapper: Some(Box::new(Mapper::new(camera, places))),
            pending_mapping: None,
            threads: None,
            counts: Counts::default(),
            fresh: None,
            motions: Vec::new(),
            companions: Companions::new(),
            first_open: 0,
            processed: 0,
            tone: None,
            early: Vec::new(),
            before_map: Vec::new(),
            learner: MaskLearner::default(),
            something_moved: false,
            map_quality: MapQuality::Open,
            last_break: None,
            provisional: None,
            resumed: None,
            common: None,
            is_relocalising: false,
            judge: None,
            trial: None,
            is_unsettled: false,
            claim: None,
            shutter: ShutterQuestion::default(),
            swap: None,
            colors: BTreeMap::new(),
        })
    }

    /// Moves images and depths of new keyframes to `swap`, as far as it has room. Those of distant keyframes are then
    /// not in memory until they are used. Results do not depend on it.
    pub fn swap_to(&mut self, swap: Arc<dyn Swap>) {
        if let Some(mapper) = &mut self.mapper {
            mapper.swap_to(Arc::clone(&swap));
        }
        self.swap = Some(swap);
    }

    /// Tracks a frame and maps what it adds.
    ///
    /// # Errors
    /// When the image is not of the camera's size; the agent is as if there had been no frame.
    pub fn process(&mut self, frame: Frame) -> Result<FrameReport, AgentError> {
        self.check_size(frame.index, &frame.image)?;
        self.keep_color(frame.index, frame.color.as_ref());
        self.processed += 1;
        self.claim = None;
        if !matches!(self.state, State::Running(_)) || self.is_relocalising && self.trial.is_none() {
            self.tone = Tone::following(self.tone.take(), &frame.image);
        }
        let pyramid = self.pyramid(frame.image);
        let (is_new, is_open) = (self.learner.is_new(), self.map_quality == MapQuality::Open);
        // Copies share what is made of an image.
        let seen = pyramid.clone();
        if is_new || is_open || self.is_young() || !matches!(self.state, State::Running(_)) {
            self.keep_early(frame.timestamp, frame.index, pyramid.shared_base());
        }
        let report = match std::mem::replace(&mut self.state, State::Empty) {
            State::Empty => self.begin(pyramid, frame.timestamp, frame.index, "the camera has not moved yet"),
            State::Starting(bootstrap) => self.start(bootstrap, pyramid, frame.timestamp, frame.index),
            State::Running(tracker) => match self.provisional.take() {
                None => self.track(tracker, pyramid, frame.timestamp, frame.index),
                Some(start) => {
                    let report = self.track(tracker, pyramid.clone(), frame.timestamp, frame.index);
                    self.look_again(start, &pyramid, frame.timestamp, frame.index).unwrap_or(report)
                }
            },
        };
        let rotation = report.world_from_camera.map(|pose| pose.rotation.inverse());
        let is_spoilt = self.learner.look(&seen, &self.camera, rotation) && is_new && self.resumed.is_none();
        let wrong = is_spoilt
            .then_some("something in the image moves with the camera")
            .or((self.map_quality == MapQuality::Broken).then_some("its first keyframes found no depth"));
        let report = match wrong.filter(|_| matches!(self.state, State::Running(_))) {
            Some(why) => self.begin_again(seen, frame.timestamp, frame.index, why),
            None => report,
        };
        if !self.early.is_empty() && matches!(self.state, State::Running(_)) {
            self.end_early();
        }
        Ok(self.with_deltas(report))
    }

    fn pyramid(&self, image: GrayImage) -> Pyramid {
        let image = match &self.tone {
            Some(tone) => tone.apply(&image),
            None => image,
        };
        Pyramid::new(image, self.params.align.pyramid_levels)
    }

    fn track(
        &mut self,
        mut tracker: Box<Tracker>,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
    ) -> FrameReport {
        let mut report = FrameReport::of(TrackingState::Tracking);
        self.end_stale_claim(&tracker, timestamp);
        let is_claim = self.is_cut_off(&tracker, timestamp);
        match self.locate(&mut tracker, &pyramid, timestamp, &mut report) {
            Some(located) if is_claim => {
                self.try_claim(tracker, &located, pyramid, (timestamp, frame_index), report)
            }
            Some(located) => self.go_on(tracker, &located, pyramid, (timestamp, frame_index), report),
            None => self.lose(tracker, pyramid, timestamp, frame_index, report),
        }
    }

    /// Takes over what another agent with this camera learnt of its sensor and of its surroundings, before there is a map.
    pub(crate) fn know_sensor_of(&mut self, other: &Agent) {
        if let Some(mapper) = &mut self.mapper {
            mapper.local.sensor = other.view.sensor;
        }
        self.learner = other.learner.clone();
        self.learner.change_world();
        self.something_moved = other.something_moved;
    }

    /// Whether the map has not come beyond its start, so that it may prove useless yet.
    pub(crate) fn is_young(&self) -> bool {
        self.resumed.is_none() && self.view.keyframes.len() <= self.params.keyframes.young_map
    }

    /// Whether the camera left the map because a part of it moved, and may begin another one.
    pub(crate) fn saw_two_motions(&self) -> bool {
        self.resumed != Some(ResumeMode::Localising)
            && matches!(&self.state, State::Running(tracker) if tracker.saw_two_motions())
    }

    /// Takes a frame that was found into the map; `at` its time stamp and index.
    fn go_on(
        &mut self,
        mut tracker: Box<Tracker>,
        located: &Located,
        pyramid: Pyramid,
        at @ (timestamp, frame_index): (f64, u64),
        mut report: FrameReport,
    ) -> FrameReport {
        if self.tells_too_little(located) {
            self.state = State::Running(tracker);
            return FrameReport::tells_too_little();
        }
        self.params.track.position_sigma = learn_position_sigma(&self.params.track, located.residual_scale);
        self.counts.add(&located.searched, &located.matched);
        self.learn_motion(&located.mean_motion);
        self.is_relocalising = false;
        self.map.frames.extend(self.own_frame(FramePose {
            timestamp,
            frame_index,
            reference: LocalMap::id(tracker.reference),
            keyframe_from_frame: self.view.keyframe_from_frame(tracker.reference, &tracker.last),
        }));
        self.ask_for_shutter(&pyramid, timestamp, frame_index, &located.mean_motion);
        report.inlier_share = located.inlier_share();
        report.rmse = located.rmse();
        report.matched_points = located.inliers;
        report.covariance = located.covariance(&self.view);
        tracker.change_reference(&self.view, located, &self.params);
        if self.resumed == Some(ResumeMode::Localising) {
            // The map stays as it is.
        } else if self.mapper.is_some()
            && (self.lacks_keyframes()
                || tracker.needs_keyframe(&self.view, located, &self.params)
                    && !tracker.returns(&self.view, located, &self.params))
        {
            self.extend(&mut tracker, located, pyramid, at, &mut report);
        } else if tracker.reference >= self.first_open {
            let frame_from_keyframe =
                self.view.keyframe_from_frame(tracker.reference, &tracker.last).inverse();
            let companions = self.companions.entry(tracker.reference).or_default();
            let parallax = tracker.parallax(&self.view);
            let mut motion = located.motion;
            motion.fixed_rows_mut::<3>(0).unscale_mut(self.view.keyframes[tracker.reference].scale);
            let image = pyramid.shared_base();
            dense::keep_companion(companions, image, frame_from_keyframe, motion, parallax);
        }
        report.world_from_camera = Some(tracker.last.inverse());
        self.state = State::Running(tracker);
        report
    }

    /// Finds the frame in the map. What is being mapped is taken over before when it is time, or when the frame is not
    /// found without.
    fn locate(
        &mut self,
        tracker: &mut Tracker,
        pyramid: &Pyramid,
        timestamp: f64,
        report: &mut FrameReport,
    ) -> Option<Located> {
        tracker.expect_motions(self.something_moved);
        if self.pending_mapping.as_ref().is_some_and(|pending_mapping| pending_mapping.due <= self.processed)
        {
            self.adopt_mapping(tracker, report);
        }
        if self.pending_mapping.is_some() {
            let located = tracker.track(&self.view, None, pyramid, timestamp, &self.params);
            if located.is_some() {
                return located;
            }
            self.adopt_mapping(tracker, report);
        }
        let places = self.mapper.as_ref().map(|mapper| mapper.places.as_ref());
        tracker.track(&self.view, places, pyramid, timestamp, &self.params)
    }

    /// What becomes of a frame that was not found.
    fn lose(
        &mut self,
        tracker: Box<Tracker>,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        report: FrameReport,
    ) -> FrameReport {
        if self.was_bad_start(&tracker, timestamp)
            && let Some(report) = self.begin_anew(pyramid, timestamp, frame_index)
        {
            return report;
        }
        self.something_moved |= tracker.saw_two_motions();
        let lost = FrameReport::lost(tracker.loss());
        self.state = State::Running(tracker);
        FrameReport { adopted: report.adopted, ..lost }
    }
}

#[cfg(test)]
mod tests;
