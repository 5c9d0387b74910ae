//! Joins two fragments that show one place: the earlier one's agent absorbs the later one's map and continues in its
//! place.

use super::keyframe_insertion::Before;
use super::mapper::{Absorbed, Joined, Link, Mapper, Update};
use super::{Agent, AgentError, Frame, FrameReport, ResumeMode, State, TrackingState};
use crate::background::Task;
use crate::local_map::LocalMap;
use crate::publish;
use crate::recognise::Hypothesis;
use crate::tracker::Tracker;
use geometry::{Se3, Sim3};
use map::{FramePose, Keyframe, MapDelta, PlaceIndex};
use std::sync::Arc;

/// A keyframe of one fragment found in another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sighting {
    /// The fragment that it was found in.
    pub fragment: usize,
    /// A keyframe there.
    own: usize,
    /// Its pose relative to that one, in its unit.
    own_from_keyframe: Se3,
    /// The frame that became the keyframe that was found: a map that is given up and begun again numbers its keyframes anew.
    frame: u64,
}

/// Largest difference of the turn between two keyframes in both fragments, degrees: a frame that is found again is turned
/// right to a few pixels, which is a third of a degree.
const MAX_ROTATION: f64 = 2.0;
/// Largest angle between the ways from one to the other in both, degrees.
const MAX_COURSE: f64 = 10.0;
/// Least length of that way over the distance of what is seen: positions are known to some thousandths of it, and so the
/// scale to some hundredths.
const MIN_PARALLAX: f64 = 0.05;

/// Two maps being made one.
pub(crate) struct Joining {
    task: Task<Absorbed>,
    /// Keyframes of the map that takes in.
    count: usize,
}

impl Agent {
    /// Searches a keyframe of the agent `other`, which this frame became, at its proposed pose in this agent's map.
    pub(crate) fn sight(&self, hypothesis: &Hypothesis, frame: &Frame, other: &Agent) -> Option<Sighting> {
        other.keyframe_of(frame.index)?;
        let own = hypothesis.keyframe.0 as usize;
        if own >= self.view.keyframes.len() || !matches!(self.state, State::Running(_)) {
            return None;
        }
        let supposed = self.view.camera_from_world(own, &hypothesis.keyframe_from_frame);
        let tracker = Tracker::new(&self.view, own, supposed, Se3::identity(), &self.params);
        let pyramid = self.pyramid(frame.image.clone());
        let mut tracker = tracker.seeking();
        tracker.find_at(&self.view, &supposed, &pyramid, frame.timestamp, &self.params)?;
        let own_from_keyframe = self.view.keyframe_from_frame(own, &tracker.last);
        Some(Sighting { fragment: hypothesis.fragment, own, own_from_keyframe, frame: frame.index })
    }

    /// The keyframe that this frame became.
    fn keyframe_of(&self, frame: u64) -> Option<usize> {
        self.view.keyframes.iter().rposition(|state| state.frame_index == frame)
    }

    /// The relative pose of the two worlds, from the newest sighting of the keyframes of `other` and an earlier one
    /// that agrees; of keyframes that `other` has no more, nothing is known.
    fn link(&self, other: &Agent, sightings: &[Sighting]) -> Option<Link> {
        let (newest, earlier) = sightings.split_last()?;
        let poses = |sighting: &Sighting| {
            let own = self.view.camera_from_world(sighting.own, &sighting.own_from_keyframe);
            let keyframe = other.keyframe_of(sighting.frame)?;
            Some((keyframe, own, other.view.keyframes[keyframe].camera_from_world))
        };
        let (keyframe, own, there) = poses(newest)?;
        let depth = self.view.median_depth(newest.own)?;
        let scales =
            earlier.iter().filter(|before| before.fragment == newest.fragment).filter_map(|before| {
                let (_, own_before, there_before) = poses(before)?;
                let moved = [own * own_before.inverse(), there * there_before.inverse()];
                let [a, b] = moved.map(|moved| moved.translation);
                let agree = moved[0].rotation.angle_to(&moved[1].rotation) <= MAX_ROTATION.to_radians()
                    && a.norm() >= MIN_PARALLAX * depth
                    && a.angle(&b) <= MAX_COURSE.to_radians();
                agree.then(|| (a.norm(), a.norm() / b.norm()))
            });
        // The longest way tells the scale best.
        let (_, scale) = scales.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let scaling = Sim3::new(Default::default(), Default::default(), scale);
        let own_from_other = Sim3::from(own.inverse()) * scaling * Sim3::from(there);
        Some(Link { own: newest.own, other: keyframe, own_from_other })
    }

    /// Begins to absorb the map of `other` in the background, if the sightings of its keyframes agree. Tracking
    /// continues in `other`.
    pub(crate) fn begin_joining(&mut self, other: &mut Agent, sightings: &[Sighting]) -> Option<Joining> {
        if self.resumed == Some(ResumeMode::Localising) {
            return None;
        }
        let link = self.link(other, sightings)?;
        // Keyframes and frames are in order of time.
        let first = other.map.frames.first()?.frame_index;
        let is_behind = self.map.frames.last().is_none_or(|last| last.frame_index < first);
        if !is_behind || other.provisional.is_some() {
            return None;
        }
        if let State::Running(mut tracker) = std::mem::replace(&mut self.state, State::Empty) {
            self.adopt_mapping(&mut tracker, &mut FrameReport::of(TrackingState::Tracking));
            self.state = State::Running(tracker);
        }
        let other_mapper = other.mapper.take()?;
        let Some(mapper) = self.mapper.take() else {
            other.mapper = Some(other_mapper);
            return None;
        };
        let (companions, params) = (self.companions.clone(), other.params.clone());
        let count = self.view.keyframes.len();
        let judge = self.judge.clone();
        let with = Joined { companions, params, judge };
        let task = Task::spawn(move || mapper.absorb(other_mapper, &link, &with));
        Some(Joining { task, count })
    }

    /// Waits for the join and adopts it. This agent continues with the map and at the pose of `other`, which is left
    /// empty, with `places` as its new index. Both stay as they were if the maps proved not to fit. Returns whether
    /// they are one.
    ///
    /// # Errors
    /// Those of [`new`](Self::new).
    pub(crate) fn end_joining(
        &mut self,
        other: &mut Agent,
        joining: Joining,
        places: Box<dyn PlaceIndex>,
    ) -> Result<bool, AgentError> {
        match joining.task.join() {
            Absorbed::Two([own, others]) => {
                (self.mapper, other.mapper) = (Some(own), Some(others));
                Ok(false)
            }
            Absorbed::One(mapper, update) => {
                let mut empty = Agent::new(self.camera, places, self.params.clone())?;
                if let Some(swap) = &self.swap {
                    empty.swap_to(Arc::clone(swap));
                }
                empty.judge.clone_from(&self.judge);
                let other = std::mem::replace(other, empty);
                self.go_on_for(other, mapper, *update, joining.count);
                Ok(true)
            }
        }
    }

    /// Goes on from where `other` is, whose keyframes came behind the `count` of this agent.
    fn go_on_for(&mut self, mut other: Agent, mapper: Box<Mapper>, update: Update, count: usize) {
        self.mapper = Some(mapper);
        self.take_in_early(other.take_early());
        // Who was joined was tracking.
        let State::Running(mut tracker) = other.state else { return };
        let before = Before::of(&other.view, tracker.reference);
        tracker.reference += count;
        let keyframe = |(id, keyframe): (usize, Keyframe)| Keyframe {
            id: LocalMap::id(id),
            world_from_keyframe: update.view.world_from_keyframe(id),
            points: publish::points(&update.view, id),
            ..keyframe
        };
        let added = (count..).zip(other.map.keyframes.into_values()).map(keyframe).collect();
        let behind = |keyframe: usize| keyframe + count;
        self.companions.extend(other.companions.into_iter().map(|(k, kept)| (behind(k), kept)));
        self.motions.extend(other.motions.into_iter().map(|(k, motion)| (behind(k), motion)));
        self.fresh = other.fresh.map(|(k, motion)| (behind(k), motion));
        self.counts = Default::default();
        (self.params, self.tone) = (other.params, other.tone);
        self.threads = self.threads.take().or(other.threads);
        (self.processed, self.is_relocalising) = (self.processed.max(other.processed), false);
        // Where the camera is was decided by joining.
        (self.trial, self.is_unsettled) = (None, false);
        self.view = update.view.clone();
        self.apply_delta(self.own_delta(MapDelta { added, ..MapDelta::default() }));
        let frames = other.map.frames.into_iter().filter_map(|frame| {
            self.own_frame(FramePose { reference: LocalMap::id(behind(frame.reference.0 as usize)), ..frame })
        });
        let frames: Vec<FramePose> = frames.collect();
        self.map.frames.extend(frames);
        let mut report = FrameReport::of(TrackingState::Tracking);
        self.adopt_update(&mut tracker, update, &before, &mut report);
        self.state = State::Running(tracker);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::tests::{agent, as_it_is, drive, feed};
    use map::KeyframeId;

    fn mapped() -> Agent {
        let mut agent = agent();
        feed(&mut agent, as_it_is);
        agent
    }

    fn frame(index: u64) -> Frame {
        let shot = &drive().shots[index as usize];
        Frame { index, timestamp: shot.timestamp, image: shot.image.as_ref().clone(), color: None }
    }

    #[test]
    fn what_was_found_of_a_map_that_was_given_up_joins_nothing() {
        let (agent, mut other) = (mapped(), mapped());
        let sight = |k: usize| {
            let frame = frame(other.view.keyframes[k].frame_index);
            let keyframe = KeyframeId(k as u32);
            let hypothesis = Hypothesis { fragment: 0, keyframe, keyframe_from_frame: Se3::identity() };
            agent.sight(&hypothesis, &frame, &other).expect("both show the same")
        };
        let last = other.view.keyframes.len() - 1;
        let sightings = [sight(2), sight(last)];
        let link = agent.link(&other, &sightings).expect("both agree");
        assert!((link.own_from_other.scale - 1.0).abs() < 0.02, "{link:?}");
        let last = frame(drive().shots.len() as u64 - 1);
        other.begin_again(agent.pyramid(last.image), last.timestamp, last.index, "of no use");
        assert!(agent.link(&other, &sightings).is_none());
    }
}
