//! A frame that becomes a keyframe: handed to the mapper, and what became of it adopted frames later.

use super::mapper::Mapper;
use super::mapper::{self, Job, Update};
use super::{Agent, FrameReport};
use crate::background::Task;
use crate::local_map::{KeyframeState, LocalMap, Matched};
use crate::mapping;
use crate::publish;
use crate::scale::newest_scale_break;
use crate::tracker::{Located, Tracker, match_keyframe};
use geometry::sensor::Twist;
use geometry::{Pyramid, Se3};
use map::{KeyframeId, MapDelta};
use std::sync::Arc;

/// A keyframe being mapped beside the tracking.
pub(super) struct PendingMapping {
    pub(super) keyframe: Option<KeyframeId>,
    pub(super) task: Task<(Box<Mapper>, Update)>,
    /// Before which frame its result is taken over, as counted by `Agent::processed`.
    pub(super) due: u64,
}

impl Agent {
    /// Takes the mean of a keyframe's motions before and after it for its own: `after` is that of the frame that follows.
    pub(super) fn learn_motion(&mut self, after: &Twist) {
        let Some((keyframe, before)) = self.fresh.take() else { return };
        let state = &mut self.view.keyframes[keyframe];
        let mut after = *after;
        after.fixed_rows_mut::<3>(0).unscale_mut(state.scale);
        if after != Twist::zeros() && before != Twist::zeros() {
            state.motion = (before + after) * 0.5;
            self.motions.push((keyframe, state.motion));
        }
    }

    /// Makes the newest tracked frame, of this time stamp and index, a keyframe: hands it to the mapper.
    pub(super) fn extend(
        &mut self,
        tracker: &mut Tracker,
        located: &Located,
        mut pyramid: Pyramid,
        at @ (timestamp, frame_index): (f64, u64),
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
        self.refer_newest_frame(index, at);
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
    pub(super) fn adopt_mapping(&mut self, tracker: &mut Tracker, report: &mut FrameReport) {
        let Some(pending_mapping) = self.pending_mapping.take() else { return };
        let before = Before::of(&self.view, tracker.reference);
        let (mapper, update) = pending_mapping.task.join();
        self.mapper = Some(mapper);
        report.adopted = pending_mapping.keyframe;
        self.adopt_update(tracker, update, &before, report);
    }

    /// Goes on in the map as it is after an update; `before` tells of the tracker's reference in the map before.
    pub(super) fn adopt_update(
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
}

/// Where a keyframe was before an update.
pub(super) struct Before {
    camera_from_world: Se3,
    scale: f64,
}

impl Before {
    pub(super) fn of(map: &LocalMap, keyframe: usize) -> Self {
        let state = &map.keyframes[keyframe];
        Self { camera_from_world: state.camera_from_world, scale: state.scale }
    }
}

/// A keyframe that sees what was matched in it, to be tracked against until it is mapped.
fn seeing(mut keyframe: KeyframeState, matched: &[Matched]) -> KeyframeState {
    keyframe.seen = mapping::inlier_matches(matched).map(|m| m.at).collect();
    keyframe
}
