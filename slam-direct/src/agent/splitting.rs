//! Parts the map where its scale is not carried on: what came after goes on as a fragment of its own, in a unit of its own.

use super::mapper::{MapQuality, Mapper};
use super::{Agent, AgentError, State};
use crate::local_map::Counts;
use crate::publish;
use crate::scale::{ScaleBreak, scale_break_behind};
use crate::tracker::Tracker;
use geometry::Se3;
use map::{KeyframeId, MapDelta, PlaceIndex};

impl Agent {
    /// The break of the scale behind a keyframe, as the map knows it now; `None` where it is carried.
    pub(crate) fn scale_break_behind(&self, before: KeyframeId) -> Option<ScaleBreak> {
        scale_break_behind(&self.view, &self.closed, before, &self.params)
    }

    /// Whether the map may be parted behind a keyframe: the camera is behind it, nothing is being mapped, and no loop is being closed, which
    /// may carry the scale.
    pub(crate) fn may_split_behind(&self, before: KeyframeId) -> bool {
        let is_behind =
            matches!(&self.state, State::Running(tracker) if tracker.reference > before.0 as usize);
        let is_idle =
            self.pending_mapping.is_none() && self.mapper.as_ref().is_some_and(|m| !m.closes_a_loop());
        is_behind && is_idle && self.is_own_map() && self.provisional.is_none() && self.trial.is_none()
    }

    /// Ends the map behind a keyframe; gives the agent that goes on in what came after it, from where the camera is, with `places` as its
    /// index. `None` where that [may not be](Self::may_split_behind).
    ///
    /// # Errors
    /// Those of [`new`](Self::new).
    pub(crate) fn split_behind(
        &mut self,
        before: KeyframeId,
        places: Box<dyn PlaceIndex>,
    ) -> Result<Option<Agent>, AgentError> {
        let mut later = Agent::new(self.camera, places, self.params.clone())?;
        let (true, Some(empty)) = (self.may_split_behind(before), later.mapper.take()) else {
            return Ok(None);
        };
        let State::Running(tracker) = std::mem::replace(&mut self.state, State::Empty) else {
            return Ok(None);
        };
        let Some(mut mapper) = self.mapper.take() else { return Ok(None) };
        self.end_early();
        let update = mapper.adopt_pending(&std::mem::take(&mut self.motions));
        self.apply_delta(update.delta);
        let count = before.0 as usize + 1;
        let mapper_of_later = mapper.split_off(count, empty.places);
        self.adopt_part(mapper);
        later.adopt_part(Box::new(mapper_of_later));
        self.hand_over(&mut later, count);
        self.split_handed_out(&mut later, before);
        self.state = self.seeking().map_or(State::Empty, State::Running);
        later.follow_on(tracker, count);
        Ok(Some(later))
    }

    /// Takes over the mapper of a part of a map.
    fn adopt_part(&mut self, mapper: Box<Mapper>) {
        self.view = mapper.local.clone();
        self.closed = mapper.closed().to_vec();
        self.first_open = mapper.first_open();
        self.mapper = Some(mapper);
        (self.counts, self.last_break) = (Counts::default(), None);
    }

    /// Hands over to the agent of the keyframes behind the first `count` what belongs to them, and what was learnt.
    fn hand_over(&mut self, later: &mut Agent, count: usize) {
        let companions = self.companions.split_off(&count).into_iter();
        later.companions = companions.map(|(keyframe, kept)| (keyframe - count, kept)).collect();
        later.fresh = self.fresh.take().and_then(|(k, motion)| Some((k.checked_sub(count)?, motion)));
        later.params.clone_from(&self.params);
        (later.tone, later.learner) = (self.tone.clone(), self.learner.clone());
        later.something_moved = self.something_moved;
        (later.threads, later.processed) = (self.threads.clone(), self.processed);
        (later.judge, later.swap) = (self.judge.clone(), self.swap.clone());
        (later.colors, later.shutter) = (std::mem::take(&mut self.colors), std::mem::take(&mut self.shutter));
        later.map_quality = MapQuality::Kept;
    }

    /// Parts the map that is handed out; of that of `later` all is told.
    fn split_handed_out(&mut self, later: &mut Agent, before: KeyframeId) {
        let later_ids = self.map.keyframes.keys().filter(|id| **id > before);
        let removed = later_ids.copied().collect();
        [self.map, later.map] = self.map.cut_in_two(before);
        self.apply_delta(MapDelta { removed, ..MapDelta::default() });
        let mut all = MapDelta::whole(&later.map);
        for keyframe in &mut all.added {
            keyframe.points = publish::points(&later.view, keyframe.id.0 as usize);
        }
        later.apply_delta(all);
    }

    /// The tracker of a camera that left the map at its end; `None` of a map without points to track against.
    fn seeking(&self) -> Option<Box<Tracker>> {
        let last = (0..self.view.keyframes.len()).rev().find(|&k| self.view.has_points(k))?;
        let state = &self.view.keyframes[last];
        let tracker = Tracker::new(&self.view, last, state.camera_from_world, Se3::identity(), &self.params);
        Some(Box::new(tracker.seeking().at(state.timestamp)))
    }

    /// Goes on with the tracker of a map whose first keyframes, `count`, are not in this one.
    fn follow_on(&mut self, mut tracker: Box<Tracker>, count: usize) {
        let reference = tracker.reference - count;
        tracker.refer_to(&self.view, reference, &self.params);
        self.state = State::Running(tracker);
    }

    /// Forgets what each side of a keyframe observes of the other's points, so that nothing carries the scale behind it.
    #[cfg(test)]
    pub(crate) fn forget_across(&mut self, before: KeyframeId) {
        for local in self.mapper.iter_mut().map(|mapper| &mut mapper.local).chain([&mut self.view]) {
            let later = local.split_off(before.0 as usize + 1);
            local.append(later, &geometry::Sim3::identity());
        }
    }
}
