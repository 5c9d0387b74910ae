//! The agent: one camera's tracker and map, and how a frame goes through them.

mod early;
mod frame;
mod settle;

pub use frame::{Frame, FrameReport, TrackingState};

use crate::bootstrap::Bootstrap;
use crate::closing::LoopCloser;
use crate::dense;
use crate::local_map::{KeyframeState, LocalMap};
use crate::mapping::{self, UnitChange};
use crate::params::Params;
use crate::publish;
use crate::track::{Matched, learn_position_sigma};
use crate::tracker::{Located, Tracker, match_keyframe};
use early::EarlyFrame;
use geometry::{Pinhole, Pyramid, Se3};
use map::{FramePose, KeyframeId, Map, PlaceIndex};
use settle::Settler;

/// One camera's tracker and map: give it frames in order of time.
pub struct Agent {
    camera: Pinhole,
    params: Params,
    map: Map,
    local: LocalMap,
    state: State,
    places: Box<dyn PlaceIndex>,
    closer: LoopCloser,
    settler: Settler,
    /// Frames that came before the first map and are not in it.
    early: Vec<EarlyFrame>,
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
        Self {
            camera,
            params,
            map,
            local,
            state: State::Empty,
            places,
            closer: LoopCloser::default(),
            settler: Settler::default(),
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

    fn track(
        &mut self,
        mut tracker: Box<Tracker>,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
    ) -> FrameReport {
        match tracker.track(&self.local, self.places.as_ref(), &pyramid, &self.params) {
            Some(located) => self.go_on(tracker, &located, pyramid, timestamp, frame_index),
            None => self.lose(tracker, pyramid, timestamp, frame_index),
        }
    }

    /// Seeks a frame in the map of an agent that other frames were not given to; nothing changes when it is not there.
    pub(crate) fn relocalise(&mut self, frame: &Frame) -> Option<FrameReport> {
        let State::Running(mut tracker) = std::mem::replace(&mut self.state, State::Empty) else {
            return None;
        };
        let pyramid = Pyramid::new(frame.image.clone(), self.params.align.pyramid_levels);
        let Some(located) = tracker.track(&self.local, self.places.as_ref(), &pyramid, &self.params) else {
            self.state = State::Running(tracker);
            return None;
        };
        Some(self.go_on(tracker, &located, pyramid, frame.timestamp, frame.index))
    }

    /// Whether the map has not come beyond its start, so that it may prove useless yet.
    pub(crate) fn is_young(&self) -> bool {
        self.local.keyframes.len() <= self.params.keyframes.young_map
    }

    /// Takes a frame that was found into the map.
    fn go_on(
        &mut self,
        mut tracker: Box<Tracker>,
        located: &Located,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
    ) -> FrameReport {
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
        tracker.change_reference(&self.local, located, &self.params);
        if tracker.wants_keyframe(&self.local, located, &self.params) {
            self.extend(&mut tracker, located, pyramid, timestamp, frame_index, &mut report);
        } else if self.settler.is_open(tracker.reference) {
            let parallax = tracker.parallax(&self.local);
            let state = &mut self.local.keyframes[tracker.reference];
            dense::keep_companion(state, pyramid.shared_base(), &tracker.last, parallax);
        }
        report.world_from_camera = Some(tracker.last.inverse());
        self.state = State::Running(tracker);
        report
    }

    /// What becomes of a frame that was not found.
    fn lose(
        &mut self,
        tracker: Box<Tracker>,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
    ) -> FrameReport {
        if self.was_bad_start(&tracker)
            && let Some(report) = self.begin_anew(pyramid, timestamp, frame_index)
        {
            return report;
        }
        self.state = State::Running(tracker);
        FrameReport::lost()
    }

    /// Extends the map by the newest tracked frame, and takes up and begins what is done in the background.
    fn extend(
        &mut self,
        tracker: &mut Tracker,
        located: &Located,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        report: &mut FrameReport,
    ) {
        let (camera_from_world, matched) = match_keyframe(&self.local, &pyramid, located, &self.params);
        let state = KeyframeState::new(timestamp, frame_index, pyramid, camera_from_world);
        let keyframe = self.add_keyframe(state, &matched);
        tracker.last = self.local.keyframes[keyframe].camera_from_world;
        tracker.refer_to(&self.local, keyframe, &self.params);
        report.new_keyframe = Some(LocalMap::id(keyframe));
        report.settled_keyframes = self.settler.take_up(&mut self.map, &self.local);
        report.closed_loop = self.take_up_loop(tracker);
        self.seek_loop(&report.settled_keyframes);
        self.settler.begin(&mut self.local, self.params.mapping.settle_after, &self.params.depth);
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
            self.settler.absorb(change);
            for companion in &mut self.local.keyframes[change.keyframe].companions {
                companion.frame_from_keyframe.translation *= change.factor;
            }
        }
        publish::update_poses(&mut self.map, &self.local);
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
        let mut settled = self.settler.take_up(&mut self.map, &self.local);
        let mut loops: Vec<_> = self.finish_loop().into_iter().collect();
        self.settler.begin(&mut self.local, 0, &self.params.depth);
        settled.extend(self.settler.take_up(&mut self.map, &self.local));
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

#[cfg(test)]
mod tests;
