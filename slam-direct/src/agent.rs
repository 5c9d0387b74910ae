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
mod frame;
mod joining;
mod joint_optimisation;
mod mapper;
mod masking;
mod recognised;
mod resume;
mod shutter;

pub use claim::Claim;
pub use common::Joint;
pub use error::AgentError;
pub use frame::{Frame, FrameReport, LazyColor, LossReason, TrackingState};
pub(crate) use joining::{Joining, Sighting};
pub use joint_optimisation::optimise_jointly;
pub use resume::{ResumeMode, edges_of};

use crate::background::Task;
use crate::bootstrap::Bootstrap;
use crate::dense;
use crate::judge::JudgePlace;
use crate::local_map::{Companions, Counts, KeyframeState, LocalMap};
use crate::mapping;
use crate::mask::MaskLearner;
use crate::params::Params;
use crate::publish;
use crate::scale::{ScaleBreak, newest_scale_break, scale_breaks};
use crate::tone::Tone;
use crate::track::{Matched, learn_position_sigma};
use crate::tracker::{Located, Tracker, match_keyframe};
use claim::Trial;
use early::EarlyFrame;
use geometry::sensor::Twist;
use geometry::{GrayImage, Pinhole, Pyramid, Se3, Swap};
use map::{Described, Edge, FramePose, KeyframeId, Map, MapDelta, PlaceIndex};
use mapper::{Job, MapQuality, Mapper, Update};
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

/// A keyframe being mapped beside the tracking.
struct PendingMapping {
    keyframe: Option<KeyframeId>,
    task: Task<(Box<Mapper>, Update)>,
    /// Before which frame its result is taken over, as counted by `Agent::processed`.
    due: u64,
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

    /// A report that tells all that was said.
    fn with_deltas(&mut self, report: FrameReport) -> FrameReport {
        FrameReport { deltas: std::mem::take(&mut self.pending_deltas), claim: self.claim, ..report }
    }

    /// Takes back the deltas of a report that nobody will see: the next report has them.
    pub(crate) fn return_deltas(&mut self, deltas: Vec<MapDelta>) {
        self.pending_deltas.splice(0..0, deltas);
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
            Some(located) => self.go_on(tracker, &located, pyramid, timestamp, frame_index, report),
            None => self.lose(tracker, pyramid, timestamp, frame_index, report),
        }
    }

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
        let report = self.go_on(tracker, &located, pyramid, frame.timestamp, frame.index, report);
        Ok(Some(self.with_deltas(report)))
    }

    /// Takes over what another agent with this camera learnt of its sensor, before there is a map.
    pub(crate) fn know_sensor_of(&mut self, other: &Agent) {
        if let Some(mapper) = &mut self.mapper {
            mapper.local.sensor = other.view.sensor;
        }
        self.learner = other.learner.clone();
        self.learner.change_world();
    }

    /// Whether the map has not come beyond its start, so that it may prove useless yet.
    pub(crate) fn is_young(&self) -> bool {
        self.resumed.is_none() && self.view.keyframes.len() <= self.params.keyframes.young_map
    }

    /// Takes a frame that was found into the map.
    fn go_on(
        &mut self,
        mut tracker: Box<Tracker>,
        located: &Located,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
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
            self.extend(&mut tracker, located, pyramid, timestamp, frame_index, &mut report);
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

    /// Takes the mean of a keyframe's motions before and after it for its own: `after` is that of the frame that follows.
    fn learn_motion(&mut self, after: &Twist) {
        let Some((keyframe, before)) = self.fresh.take() else { return };
        let state = &mut self.view.keyframes[keyframe];
        let mut after = *after;
        after.fixed_rows_mut::<3>(0).unscale_mut(state.scale);
        if after != Twist::zeros() && before != Twist::zeros() {
            state.motion = (before + after) * 0.5;
            self.motions.push((keyframe, state.motion));
        }
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
        let lost = FrameReport::lost(tracker.loss());
        self.state = State::Running(tracker);
        FrameReport { adopted: report.adopted, ..lost }
    }

    /// Makes the newest tracked frame a keyframe: hands it to the mapper.
    fn extend(
        &mut self,
        tracker: &mut Tracker,
        located: &Located,
        mut pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        report: &mut FrameReport,
    ) {
        let Some(mut mapper) = self.mapper.take() else { return };
        if let Some(swap) = &self.swap {
            pyramid.swap_out(&**swap);
        }
        let (camera_from_world, matched) = match_keyframe(&self.view, &pyramid, located, &self.params);
        let keyframe = KeyframeState {
            motion: located.motion,
            ..KeyframeState::new(timestamp, frame_index, pyramid, camera_from_world)
        };
        let index = self.view.push(seeing(keyframe.clone(), &matched));
        let added = vec![publish::keyframe(&self.view, index)];
        self.apply_delta(self.own_delta(MapDelta { added, ..MapDelta::default() }));
        self.refer_newest_frame(index, (timestamp, frame_index));
        let id = self.own_id(LocalMap::id(index));
        report.new_keyframe = id;
        (tracker.last, tracker.reference) = (camera_from_world, index);
        self.fresh = Some((index, located.mean_motion));
        let (counts, motions) = (std::mem::take(&mut self.counts), std::mem::take(&mut self.motions));
        let (companions, params) = (self.companions.clone(), self.params.clone());
        let mask = Arc::clone(self.learner.mask());
        let readout = self.shutter.answer.take();
        let job = Job { keyframe, matched, counts, motions, companions, mask, readout, params };
        let p = &self.params.mapping;
        let times = if readout.is_some() || mapper.has_much_to_do(&self.params) { p.whole_lag } else { 1 };
        let lag = (p.lag * times) as u64;
        if lag == 0 {
            let before = Before::of(&self.view, index);
            // What nobody else holds is changed in place.
            self.view = LocalMap::new(self.camera);
            let update = mapper.extend(job);
            self.mapper = Some(mapper);
            self.adopt_update(tracker, update, &before, report);
        } else {
            tracker.refer_to(&self.view, index, &self.params);
            if self.threads.is_none() {
                self.threads = mapper::own_threads().map(Arc::new);
            }
            let threads = self.threads.clone();
            let task = Task::spawn(move || {
                let update = match threads {
                    Some(threads) => threads.install(|| mapper.extend(job)),
                    None => mapper.extend(job),
                };
                (mapper, update)
            });
            self.pending_mapping = Some(PendingMapping { keyframe: id, task, due: self.processed + lag });
        }
    }

    /// Waits for what is being mapped and takes it over.
    fn adopt_mapping(&mut self, tracker: &mut Tracker, report: &mut FrameReport) {
        let Some(pending_mapping) = self.pending_mapping.take() else { return };
        let before = Before::of(&self.view, tracker.reference);
        let (mapper, update) = pending_mapping.task.join();
        self.mapper = Some(mapper);
        report.adopted = pending_mapping.keyframe;
        self.adopt_update(tracker, update, &before, report);
    }

    /// Goes on in the map as it is after an update; `before` tells of the tracker's reference in the map before.
    fn adopt_update(
        &mut self,
        tracker: &mut Tracker,
        update: Update,
        before: &Before,
        report: &mut FrameReport,
    ) {
        self.view = update.view;
        // What was learnt while it was mapped is not in it yet.
        for &(keyframe, motion) in &self.motions {
            self.view.keyframes[keyframe].motion = motion;
        }
        let state = &self.view.keyframes[tracker.reference];
        let factor = state.scale / before.scale;
        let last = if tracker.last == before.camera_from_world {
            state.camera_from_world
        } else {
            let relative = tracker.last * before.camera_from_world.inverse();
            Se3::new(relative.rotation, relative.translation * factor) * state.camera_from_world
        };
        tracker.follow_reference(&self.view, last, factor, &self.params);
        self.first_open = update.first_open;
        self.map_quality = update.map_quality;
        self.companions = self.companions.split_off(&update.first_open);
        self.closed = update.closed;
        if self.is_own_map() {
            let found = newest_scale_break(&self.view, &self.closed, &self.params);
            report.scale_break =
                found.filter(|found| found.is_apart_from(self.last_break.replace(found.before)));
        }
        let delta = self.own_delta(update.delta);
        report.settled_keyframes = delta.settled.iter().map(|settled| settled.keyframe).collect();
        report.closed_loop = update.closed_loop.and_then(|closed| self.own_loop(closed));
        self.apply_delta(delta);
    }

    /// Applies a delta to the map that is handed out, and keeps it for the next report: all is called as there.
    fn apply_delta(&mut self, mut delta: MapDelta) {
        if delta.is_empty() {
            return;
        }
        for (key, value) in map::sensor_entries(&self.view.sensor) {
            if self.map.agents.values().all(|about| about.provenance.get(key) != Some(&value)) {
                delta.provenance.insert(key.into(), value);
            }
        }
        self.paint(&mut delta.added);
        delta.sequence = self.next_sequence;
        self.next_sequence += 1;
        self.pending_deltas.push(delta.clone());
        // The points are in the working map; they are handed out with it, at the end or in a snapshot.
        delta.settled.iter_mut().for_each(|settled| settled.points = Vec::new());
        delta.added.iter_mut().for_each(|added| added.points = Vec::new());
        self.map.take_in(delta);
    }

    /// The newest tracked frame, of this time and index, is this keyframe of the working map.
    fn refer_newest_frame(&mut self, keyframe: usize, (timestamp, frame_index): (f64, u64)) {
        let Some(reference) = self.own_id(LocalMap::id(keyframe)) else { return };
        // The agent's first keyframe in a common map is the first frame that it has a pose of.
        self.map.frames.pop_if(|frame| frame.frame_index == frame_index);
        let keyframe_from_frame = Se3::identity();
        self.map.frames.push(FramePose { timestamp, frame_index, reference, keyframe_from_frame });
    }

    /// Ends the run: adopts the work in the background, computes depth and loops of the last keyframes, and optimises
    /// the whole map. Returns the loops that this closed, `(newer, older)` keyframe.
    pub fn finish(&mut self) -> Vec<(KeyframeId, KeyframeId)> {
        self.finish_until(&|| false)
    }

    /// The same, but ends early and leaves the map as it is then, once `stop` returns true. `stop` is called often,
    /// and at least before each step of the last optimisation.
    pub fn finish_until(&mut self, stop: &dyn Fn() -> bool) -> Vec<(KeyframeId, KeyframeId)> {
        let mut report = FrameReport::of(TrackingState::Tracking);
        let mut loops = Vec::new();
        if self.resumed.is_some_and(|mode| mode == ResumeMode::Localising || self.is_relocalising) {
            return loops;
        }
        if let State::Running(mut tracker) = std::mem::replace(&mut self.state, State::Empty) {
            self.adopt_mapping(&mut tracker, &mut report);
            loops.extend(report.closed_loop);
            if let Some(mut mapper) = self.mapper.take() {
                let before = Before::of(&self.view, tracker.reference);
                self.view = LocalMap::new(self.camera);
                let (update, closed) = mapper.finish(&self.motions, &self.companions, &self.params, stop);
                self.mapper = Some(mapper);
                self.adopt_update(&mut tracker, update, &before, &mut report);
                loops.extend(closed.into_iter().filter_map(|closed| self.own_loop(closed)));
            }
            self.state = State::Running(tracker);
            self.find_early(stop);
        }
        let (edges, first) = (self.edges(), self.others());
        publish::complete(&mut self.map, &self.view, first, edges.clone());
        self.apply_delta(MapDelta { edges: Some(edges), ..MapDelta::default() });
        loops
    }

    /// Stores the features of the keyframe with this image (see [`map::Keyframe::features`]); the next report
    /// contains them. False when the map has no such keyframe.
    pub fn describe(&mut self, keyframe: KeyframeId, image: &Arc<GrayImage>, features: Arc<[u8]>) -> bool {
        let known = self.map.keyframes.get(&keyframe).is_some_and(|known| Arc::ptr_eq(&known.image, image));
        if known {
            let described = vec![Described { keyframe, features }];
            self.apply_delta(MapDelta { described, ..MapDelta::default() });
        }
        known
    }

    /// The changes of the map since the last report: the end of the run, or new features of keyframes. A copy of the
    /// map that follows the reports' deltas needs them after [`finish`](Self::finish).
    pub fn take_deltas(&mut self) -> Vec<MapDelta> {
        std::mem::take(&mut self.pending_deltas)
    }

    /// Where the scale of the map is not carried from keyframes to those after them, in order, for which each keyframe's points are looked at;
    /// of a map that was resumed or joined nothing is said.
    pub fn scale_breaks(&self) -> Vec<ScaleBreak> {
        if !self.is_own_map() {
            return Vec::new();
        }
        scale_breaks(&self.view, &self.closed, &self.params)
    }

    /// Whether all of the map is of this run's one camera.
    fn is_own_map(&self) -> bool {
        self.resumed.is_none() && self.common.is_none()
    }

    /// Returns the map.
    pub fn into_map(mut self) -> Map {
        self.take_map()
    }

    /// Returns the map and frees the memory that mapping used. The agent has no map afterwards.
    pub fn take_map(&mut self) -> Map {
        (self.state, self.mapper, self.pending_mapping, self.provisional) = (State::Empty, None, None, None);
        self.common = None;
        (self.view, self.companions) = (LocalMap::new(self.camera), Companions::new());
        (self.early, self.before_map) = (Vec::new(), Vec::new());
        std::mem::replace(&mut self.map, Map::new(self.camera))
    }

    /// The current map: poses, and the depth of keyframes whose depth is known. [`finish`](Self::finish) and
    /// [`snapshot`](Self::snapshot) add edges and points.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// The current map with its edges and all its points, to save it or to merge it with another agent's map during
    /// the run. The latest keyframes have no semi-dense depth yet.
    pub fn snapshot(&self) -> Map {
        let mut map = self.map.clone();
        publish::complete(&mut map, &self.view, self.others(), self.edges());
        map
    }
}

/// Where a keyframe was before an update.
struct Before {
    camera_from_world: Se3,
    scale: f64,
}

impl Before {
    fn of(map: &LocalMap, keyframe: usize) -> Self {
        let state = &map.keyframes[keyframe];
        Self { camera_from_world: state.camera_from_world, scale: state.scale }
    }
}

/// A keyframe that sees what was matched in it, to be tracked against until it is mapped.
fn seeing(mut keyframe: KeyframeState, matched: &[Matched]) -> KeyframeState {
    keyframe.seen = mapping::inlier_matches(matched).map(|m| m.at).collect();
    keyframe
}

#[cfg(test)]
mod tests;
