//! The agent: one camera's tracker and map.

use crate::background::Task;
use crate::bootstrap::{Bootstrap, Progress, Started};
use crate::closing::LoopCloser;
use crate::dense::{self, StereoJob};
use crate::local_map::{KeyframeState, LocalMap};
use crate::mapping::{self, UnitChange};
use crate::params::Params;
use crate::publish;
use crate::track::{Matched, learn_position_sigma};
use crate::tracker::{Tracker, match_keyframe};
use geometry::{GrayImage, Pinhole, Pyramid, Se3};
use map::{FramePose, KeyframeId, Map, PlaceIndex, SemiDense};
use std::sync::Arc;

/// One image to process.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Index in the recording, from 0.
    pub index: u64,
    /// Time stamp, seconds, strictly growing from frame to frame.
    pub timestamp: f64,
    /// Undistorted grey image, of the size of the agent's camera.
    pub image: GrayImage,
}

/// What the agent is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingState {
    /// Waiting for enough parallax to make a first map.
    Starting,
    /// The frame's pose is known.
    Tracking,
    /// The pose is unknown; each new frame is tried against the map.
    Lost,
}

/// What became of one frame.
#[derive(Clone, Debug)]
pub struct FrameReport {
    /// State after the frame.
    pub state: TrackingState,
    /// Pose as known now (later optimisation may move it).
    pub world_from_camera: Option<Se3>,
    /// Keyframe made from this frame.
    pub new_keyframe: Option<KeyframeId>,
    /// Keyframes whose depth became known with this frame; their poses may still move.
    pub settled_keyframes: Vec<KeyframeId>,
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
}

/// One camera's tracker and map: give it frames in order of time.
pub struct Agent {
    camera: Pinhole,
    params: Params,
    map: Map,
    local: LocalMap,
    state: State,
    places: Box<dyn PlaceIndex>,
    closer: LoopCloser,
    /// The first keyframe whose semi-dense depth is not begun.
    next_to_settle: usize,
    /// Semi-dense depths being computed, in order of their keyframes.
    settling: Vec<Settling>,
    /// Frames that came before the first map and are not in it.
    early: Vec<EarlyFrame>,
}

/// A keyframe whose semi-dense depth is computed in the background.
struct Settling {
    keyframe: usize,
    /// Change of its unit since the computation was begun.
    factor: f64,
    depth: Task<SemiDense>,
}

/// A frame from before the first map, kept to be tracked backwards once there is one.
struct EarlyFrame {
    timestamp: f64,
    frame_index: u64,
    image: Arc<GrayImage>,
}

/// Early frames kept at most: two seconds of video.
const MAX_EARLY: usize = 60;

enum State {
    Empty,
    Starting(Box<Bootstrap>),
    Running(Box<Tracker>),
}

impl Agent {
    /// A new agent with an empty map.
    pub fn new(camera: Pinhole, places: Box<dyn PlaceIndex>, params: Params) -> Self {
        let (map, local) = (Map::new(camera), LocalMap::new(camera));
        Self {
            camera,
            params,
            map,
            local,
            state: State::Empty,
            places,
            closer: LoopCloser::default(),
            next_to_settle: 0,
            settling: Vec::new(),
            early: Vec::new(),
        }
    }

    /// Tracks a frame and maps what it adds.
    pub fn process(&mut self, frame: Frame) -> FrameReport {
        let pyramid = Pyramid::new(frame.image, self.params.align.pyramid_levels);
        if !matches!(self.state, State::Running(_)) {
            self.keep_early(frame.timestamp, frame.index, pyramid.shared_base());
        }
        match std::mem::replace(&mut self.state, State::Empty) {
            State::Empty => self.begin(pyramid, frame.timestamp, frame.index, "the camera has not moved yet"),
            State::Starting(bootstrap) => self.start(bootstrap, pyramid, frame.timestamp, frame.index),
            State::Running(tracker) => self.track(tracker, pyramid, frame.timestamp, frame.index),
        }
    }

    fn keep_early(&mut self, timestamp: f64, frame_index: u64, image: Arc<GrayImage>) {
        if self.early.len() == MAX_EARLY {
            self.early.remove(0);
        }
        self.early.push(EarlyFrame { timestamp, frame_index, image });
    }

    /// Tracks the frames before the first keyframe backwards from it, as far as they can be followed.
    fn track_early(&mut self) {
        let first = self.map.frames.first().map_or(0, |f| f.frame_index);
        let mut early = std::mem::take(&mut self.early);
        early.retain(|f| f.frame_index < first);
        let world_from_first = self.local.keyframes[0].camera_from_world.inverse();
        let start = self.local.keyframes[0].camera_from_world;
        let mut tracker = Tracker::new(&self.local, 0, start, Se3::identity(), &self.params);
        let mut found = Vec::new();
        for frame in early.iter().rev() {
            let pyramid = Pyramid::new(frame.image.as_ref().clone(), self.params.align.pyramid_levels);
            if tracker.track(&self.local, self.places.as_ref(), &pyramid, &self.params).is_none() {
                break;
            }
            found.push(FramePose {
                timestamp: frame.timestamp,
                frame_index: frame.frame_index,
                reference: LocalMap::id(0),
                keyframe_from_frame: (tracker.last * world_from_first).inverse(),
            });
        }
        found.reverse();
        self.map.frames.splice(0..0, found);
    }

    /// Begins a start with this frame; `reason` says why there is no map yet if the image will do.
    fn begin(
        &mut self,
        pyramid: Pyramid,
        timestamp: f64,
        index: u64,
        mut reason: &'static str,
    ) -> FrameReport {
        match Bootstrap::new(self.camera, pyramid, timestamp, index, &self.params.bootstrap) {
            Some(start) => self.state = State::Starting(Box::new(start)),
            None => reason = "the image has too little texture",
        }
        FrameReport { reason: Some(reason), ..FrameReport::of(TrackingState::Starting) }
    }

    fn start(
        &mut self,
        mut start: Box<Bootstrap>,
        pyramid: Pyramid,
        timestamp: f64,
        index: u64,
    ) -> FrameReport {
        match start.add(&pyramid, timestamp, index, &self.params.bootstrap, &self.params.track) {
            Progress::Waiting(reason) => {
                self.state = State::Starting(start);
                FrameReport { reason: Some(reason), ..FrameReport::of(TrackingState::Starting) }
            }
            Progress::Restart(reason) => self.begin(pyramid, timestamp, index, reason),
            Progress::Done(started) => self.adopt(*started),
        }
    }

    /// Takes over the first map.
    fn adopt(&mut self, started: Started) -> FrameReport {
        let Started { map, frames } = started;
        self.local = map;
        for keyframe in 0..self.local.keyframes.len() {
            publish::add_keyframe(&mut self.map, &self.local, keyframe);
        }
        let first = &self.local.keyframes[0];
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
        self.refer_newest_frame(1);
        self.places.add(LocalMap::id(0), self.local.keyframes[0].pyramid.base());
        self.map_around(1);
        self.track_early();
        let last = self.local.keyframes[1].camera_from_world;
        let velocity = match frames.as_slice() {
            [.., before, newest] => newest.2 * before.2.inverse(),
            _ => last,
        };
        self.state = State::Running(Box::new(Tracker::new(&self.local, 1, last, velocity, &self.params)));
        FrameReport {
            world_from_camera: Some(last.inverse()),
            new_keyframe: Some(LocalMap::id(1)),
            inlier_share: 1.0,
            matched_points: self.local.keyframes[1].seen.len(),
            ..FrameReport::of(TrackingState::Tracking)
        }
    }

    fn track(
        &mut self,
        mut tracker: Box<Tracker>,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
    ) -> FrameReport {
        let Some(located) = tracker.track(&self.local, self.places.as_ref(), &pyramid, &self.params) else {
            if self.was_bad_start(&tracker) {
                let image = pyramid.shared_base();
                let fresh =
                    Bootstrap::new(self.camera, pyramid, timestamp, frame_index, &self.params.bootstrap);
                // A dark image says nothing about the map.
                if let Some(fresh) = fresh {
                    self.forget();
                    self.keep_early(timestamp, frame_index, image);
                    self.state = State::Starting(Box::new(fresh));
                    let reason = Some("the first map was of no use");
                    return FrameReport { reason, ..FrameReport::of(TrackingState::Starting) };
                }
            }
            self.state = State::Running(tracker);
            return FrameReport {
                reason: Some("the view matches no part of the map"),
                ..FrameReport::of(TrackingState::Lost)
            };
        };
        self.params.track.position_sigma = learn_position_sigma(&self.params.track, located.excess);
        self.local.count_sought(&located.sought, &located.matched);
        let world_from_reference = self.local.keyframes[tracker.reference].camera_from_world.inverse();
        self.map.frames.push(FramePose {
            timestamp,
            frame_index,
            reference: LocalMap::id(tracker.reference),
            keyframe_from_frame: (tracker.last * world_from_reference).inverse(),
        });
        let mut report = FrameReport {
            inlier_share: located.inlier_share(),
            rmse: located.rmse(),
            matched_points: located.inliers,
            ..FrameReport::of(TrackingState::Tracking)
        };
        tracker.change_reference(&self.local, &located, &self.params);
        if tracker.wants_keyframe(&self.local, &located, &self.params) {
            let (camera_from_world, matched) = match_keyframe(&self.local, &pyramid, &located, &self.params);
            let state = KeyframeState::new(timestamp, frame_index, pyramid, camera_from_world);
            let keyframe = self.add_keyframe(state, &matched);
            tracker.last = self.local.keyframes[keyframe].camera_from_world;
            tracker.refer_to(&self.local, keyframe, &self.params);
            report.new_keyframe = Some(LocalMap::id(keyframe));
            report.settled_keyframes = self.take_up_depths();
            report.closed_loop = self.take_up_loop(&mut tracker);
            self.seek_loop(&report.settled_keyframes);
            self.begin_depths(self.params.mapping.settle_after);
        } else if tracker.reference >= self.next_to_settle {
            let parallax = tracker.parallax(&self.local);
            let state = &mut self.local.keyframes[tracker.reference];
            dense::keep_companion(state, pyramid.shared_base(), &tracker.last, parallax);
        }
        report.world_from_camera = Some(tracker.last.inverse());
        self.state = State::Running(tracker);
        report
    }

    /// Whether a young map has proved useless: nothing that follows fits it.
    fn was_bad_start(&self, tracker: &Tracker) -> bool {
        let p = &self.params.keyframes;
        self.local.keyframes.len() <= p.young_map && tracker.lost_frames() >= p.give_up
    }

    /// Drops the map to start anew.
    fn forget(&mut self) {
        let agents = std::mem::take(&mut self.map.agents);
        self.map = Map { agents, ..Map::new(self.camera) };
        self.local = LocalMap::new(self.camera);
        self.places.clear();
        self.closer = LoopCloser::default();
        self.settling.clear();
        self.next_to_settle = 0;
    }

    /// Makes the newest tracked frame a keyframe.
    fn add_keyframe(&mut self, state: KeyframeState, matched: &[Matched]) -> usize {
        let keyframe = self.local.keyframes.len();
        self.local.keyframes.push(state);
        publish::add_keyframe(&mut self.map, &self.local, keyframe);
        self.refer_newest_frame(keyframe);
        mapping::add_observations(&mut self.local, keyframe, matched);
        self.map_around(keyframe);
        keyframe
    }

    /// The newest tracked frame is this keyframe.
    fn refer_newest_frame(&mut self, keyframe: usize) {
        if let Some(frame) = self.map.frames.last_mut() {
            frame.reference = LocalMap::id(keyframe);
            frame.keyframe_from_frame = Se3::identity();
        }
    }

    /// New points for a keyframe and its nearest neighbour, then the joint optimisation around it.
    fn map_around(&mut self, keyframe: usize) {
        let p = &self.params;
        let mut others: Vec<usize> = self.local.covisible(keyframe).into_iter().map(|c| c.0).collect();
        others.truncate(p.mapping.search_views);
        if let Some(&nearest) = others.first() {
            mapping::add_points(&mut self.local, nearest, &[keyframe], &p.mapping, &p.triangulate, &p.track);
        }
        mapping::add_points(&mut self.local, keyframe, &others, &p.mapping, &p.triangulate, &p.track);
        let changes = mapping::optimise_around(&mut self.local, keyframe, &p.mapping);
        mapping::cull_unfound(&mut self.local, 0.25);
        self.places.add(LocalMap::id(keyframe), self.local.keyframes[keyframe].pyramid.base());
        self.absorb(&changes);
    }

    /// Brings what hangs on the keyframes to where an optimisation has moved them.
    fn absorb(&mut self, changes: &[UnitChange]) {
        publish::scale_surroundings(&mut self.map, changes);
        self.closer.absorb(changes);
        for change in changes {
            for settling in self.settling.iter_mut().filter(|s| s.keyframe == change.keyframe) {
                settling.factor *= change.factor;
            }
            for companion in &mut self.local.keyframes[change.keyframe].companions {
                companion.frame_from_keyframe.translation *= change.factor;
            }
        }
        publish::update_poses(&mut self.map, &self.local);
    }

    /// Begins the semi-dense depth of the keyframes that are at least `behind` keyframes old.
    fn begin_depths(&mut self, behind: usize) {
        let ready = self.local.keyframes.len().saturating_sub(behind);
        for keyframe in self.next_to_settle..ready {
            let job = StereoJob::new(&self.local, keyframe, &self.params.depth);
            self.local.keyframes[keyframe].companions = Vec::new();
            self.settling.push(Settling { keyframe, factor: 1.0, depth: Task::spawn(move || job.run()) });
        }
        self.next_to_settle = self.next_to_settle.max(ready);
    }

    /// Takes up the semi-dense depths begun before, waiting for them.
    fn take_up_depths(&mut self) -> Vec<KeyframeId> {
        let take_up = |settling: Settling| {
            let mut depth = settling.depth.join();
            publish::scale_depth(&mut depth, settling.factor);
            publish::set_depth(&mut self.map, &self.local, settling.keyframe, depth);
            LocalMap::id(settling.keyframe)
        };
        self.settling.drain(..).map(take_up).collect()
    }

    /// Seeks a loop from keyframes that have just settled, and begins to close it.
    fn seek_loop(&mut self, settled: &[KeyframeId]) {
        if self.closer.is_busy() {
            return;
        }
        let found = settled.iter().find_map(|id| {
            self.closer.find(&self.local, &self.map, self.places.as_ref(), id.0 as usize, &self.params)
        });
        if let Some(found) = found {
            self.closer.start(&self.local, found, &self.params);
        }
    }

    /// Takes up the loop being closed, if there is one.
    fn take_up_loop(&mut self, tracker: &mut Tracker) -> Option<(KeyframeId, KeyframeId)> {
        let (found, changes) = self.closer.finish(&mut self.local, &self.params)?.ok()?;
        self.absorb(&changes);
        let reference = changes.iter().find(|c| c.keyframe == tracker.reference);
        tracker.follow_reference(&self.local, reference.map_or(1.0, |c| c.factor), &self.params);
        Some(found.keyframes())
    }

    /// Ends the run: what is in the background, depth and loops of the last keyframes, the last optimisation of
    /// the whole map. Gives the loops closed in doing so, `(newer, older)` keyframe.
    pub fn finish(&mut self) -> Vec<(KeyframeId, KeyframeId)> {
        let mut settled = self.take_up_depths();
        let mut loops: Vec<_> = self.finish_loop().into_iter().collect();
        self.begin_depths(0);
        settled.extend(self.take_up_depths());
        for id in settled {
            self.seek_loop(&[id]);
            loops.extend(self.finish_loop());
        }
        if self.local.keyframes.len() > 1 {
            let changes = mapping::optimise_all(&mut self.local, self.params.mapping.final_iterations);
            self.absorb(&changes);
        }
        publish::complete(&mut self.map, &self.local, self.closer.edges(&self.local));
        loops
    }

    /// Takes up the loop being closed when nothing is tracked any more.
    fn finish_loop(&mut self) -> Option<(KeyframeId, KeyframeId)> {
        let (found, changes) = self.closer.finish(&mut self.local, &self.params)?.ok()?;
        self.absorb(&changes);
        Some(found.keyframes())
    }

    /// Gives the map away.
    pub fn into_map(self) -> Map {
        self.map
    }

    /// The map as it stands: poses, and the depth of the keyframes that have settled. Edges and the points of the
    /// latest keyframes come with [`finish`](Self::finish), or in a [`snapshot`](Self::snapshot).
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// The map as it stands with its edges and all its points: to save, or to merge with another agent's, while
    /// this one goes on. The latest keyframes have no semi-dense depth yet.
    pub fn snapshot(&self) -> Map {
        let mut map = self.map.clone();
        publish::complete(&mut map, &self.local, self.closer.edges(&self.local));
        map
    }
}

impl FrameReport {
    fn of(state: TrackingState) -> Self {
        Self {
            state,
            world_from_camera: None,
            new_keyframe: None,
            settled_keyframes: Vec::new(),
            closed_loop: None,
            inlier_share: 0.0,
            rmse: 0.0,
            matched_points: 0,
            reason: None,
        }
    }
}

#[cfg(test)]
mod tests;
