//! The agent: one camera's tracker and map.

use crate::bootstrap::{Bootstrap, Progress, Started};
use crate::dense;
use crate::local_map::{KeyframeState, LocalMap};
use crate::mapping::{self, UnitChange};
use crate::params::Params;
use crate::publish;
use crate::track::{Matched, learn_position_sigma};
use crate::tracker::Tracker;
use geometry::{GrayImage, Pinhole, Pyramid, Se3};
use map::{FramePose, KeyframeId, Map, PlaceIndex};

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
    /// The first keyframe without semi-dense depth.
    next_to_settle: usize,
}

enum State {
    Empty,
    Starting(Box<Bootstrap>),
    Running(Box<Tracker>),
}

impl Agent {
    /// A new agent with an empty map.
    pub fn new(camera: Pinhole, places: Box<dyn PlaceIndex>, params: Params) -> Self {
        let (map, local) = (Map::new(camera), LocalMap::new(camera));
        Self { camera, params, map, local, state: State::Empty, places, next_to_settle: 0 }
    }

    /// Tracks a frame and maps what it adds.
    pub fn process(&mut self, frame: Frame) -> FrameReport {
        let pyramid = Pyramid::new(frame.image, self.params.align.pyramid_levels);
        match std::mem::replace(&mut self.state, State::Empty) {
            State::Empty => {
                self.begin(pyramid, frame.timestamp, frame.index, "the image has too little texture")
            }
            State::Starting(bootstrap) => self.start(bootstrap, pyramid, frame.timestamp, frame.index),
            State::Running(tracker) => self.track(tracker, pyramid, frame.timestamp, frame.index),
        }
    }

    fn begin(&mut self, pyramid: Pyramid, timestamp: f64, index: u64, reason: &'static str) -> FrameReport {
        if let Some(start) = Bootstrap::new(self.camera, pyramid, timestamp, index, &self.params.bootstrap) {
            self.state = State::Starting(Box::new(start));
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
        self.places.add(LocalMap::id(0), self.local.keyframes[0].pyramid.base());
        self.map_around(1);
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
            let state = KeyframeState::new(timestamp, frame_index, pyramid, tracker.last);
            let keyframe = self.add_keyframe(state, &located.matched);
            tracker.last = self.local.keyframes[keyframe].camera_from_world;
            tracker.refer_to(&self.local, keyframe, &self.params);
            report.new_keyframe = Some(LocalMap::id(keyframe));
            report.settled_keyframes = self.settle(self.params.mapping.settle_after);
        }
        report.world_from_camera = Some(tracker.last.inverse());
        self.state = State::Running(tracker);
        report
    }

    /// Makes the newest tracked frame a keyframe.
    fn add_keyframe(&mut self, state: KeyframeState, matched: &[Matched]) -> usize {
        let keyframe = self.local.keyframes.len();
        self.local.keyframes.push(state);
        publish::add_keyframe(&mut self.map, &self.local, keyframe);
        if let Some(frame) = self.map.frames.last_mut() {
            frame.reference = LocalMap::id(keyframe);
            frame.keyframe_from_frame = Se3::identity();
        }
        mapping::add_observations(&mut self.local, keyframe, matched);
        self.map_around(keyframe);
        keyframe
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
        publish::update_poses(&mut self.map, &self.local);
    }

    /// Computes the semi-dense depth of the keyframes that are at least `behind` keyframes old.
    fn settle(&mut self, behind: usize) -> Vec<KeyframeId> {
        let ready = self.local.keyframes.len().saturating_sub(behind);
        let keyframes: Vec<usize> = (self.next_to_settle..ready).collect();
        for &keyframe in &keyframes {
            let depth = dense::semi_dense(&self.local, keyframe, &self.params.depth);
            publish::set_depth(&mut self.map, &self.local, keyframe, depth);
        }
        self.next_to_settle = self.next_to_settle.max(ready);
        keyframes.into_iter().map(LocalMap::id).collect()
    }

    /// Ends the run: depth of the last keyframes, last optimisation of the whole map.
    pub fn finish(&mut self) {
        if self.local.keyframes.len() > 1 {
            let changes = mapping::optimise_all(&mut self.local, self.params.mapping.final_iterations);
            self.absorb(&changes);
        }
        self.settle(0);
        publish::complete(&mut self.map, &self.local);
    }

    /// Gives the map away.
    pub fn into_map(self) -> Map {
        self.map
    }

    /// The map as it stands.
    pub fn map(&self) -> &Map {
        &self.map
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
