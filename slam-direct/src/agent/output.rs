//! What is handed out of an agent: deltas, the map, its end.

use super::keyframe_insertion::Before;
use super::{Agent, FrameReport, ResumeMode, State, TrackingState};
use crate::local_map::{Companions, LocalMap};
use crate::publish;
use crate::scale::{CarriedScale, carried_scale};
use geometry::{GrayImage, Se3};
use map::{Described, FramePose, KeyframeId, Map, MapDelta, SharedBytes};
use std::sync::Arc;

impl Agent {
    /// A report that tells all that was said.
    pub(super) fn with_deltas(&mut self, report: FrameReport) -> FrameReport {
        FrameReport { deltas: std::mem::take(&mut self.pending_deltas), claim: self.claim, ..report }
    }

    /// Takes back the deltas of a report that nobody will see: the next report has them.
    pub(crate) fn return_deltas(&mut self, deltas: Vec<MapDelta>) {
        self.pending_deltas.splice(0..0, deltas);
    }

    /// Applies a delta to the map that is handed out, and keeps it for the next report: all is called as there.
    pub(super) fn apply_delta(&mut self, mut delta: MapDelta) {
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
    pub(super) fn refer_newest_frame(&mut self, keyframe: usize, (timestamp, frame_index): (f64, u64)) {
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
    pub fn describe(&mut self, keyframe: KeyframeId, image: &Arc<GrayImage>, features: SharedBytes) -> bool {
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

    /// How the scale of the map is carried from keyframes to those after them, for which each keyframe's points are looked at; of a map that
    /// was resumed or joined nothing is said.
    pub fn carried_scale(&self) -> CarriedScale {
        if !self.is_own_map() {
            return CarriedScale::default();
        }
        carried_scale(&self.view, &self.closed, &self.params)
    }

    /// Whether all of the map is of this run's one camera.
    pub(super) fn is_own_map(&self) -> bool {
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
