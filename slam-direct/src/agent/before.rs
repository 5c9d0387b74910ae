//! Frames from before the first keyframe of a map get their poses in the finished one, which knows more of the place than its first
//! two keyframes do.

use super::Agent;
use super::claim::FoundFrame;
use super::early::EarlyFrame;
use crate::tracker::Tracker;
use geometry::{Pyramid, Se3};
use map::FramePose;

/// Frames that were found one after another, the newest first.
struct Stretch {
    frames: Vec<FoundFrame>,
    /// No motion leads to them from what is known.
    is_claim: bool,
}

impl Agent {
    /// Finds frames from before the first keyframe, and from before those of fragments that were taken in, until `stop`. Those that
    /// have a pose keep it.
    pub(super) fn find_early(&mut self, stop: &dyn Fn() -> bool) {
        let early = self.take_early();
        let next =
            |frame: &EarlyFrame| self.view.keyframes.partition_point(|k| k.frame_index <= frame.frame_index);
        let starts: Vec<(usize, &[EarlyFrame])> = early
            .chunk_by(|a, b| next(a) == next(b))
            .map(|frames| (next(&frames[0]), frames))
            .filter(|&(keyframe, _)| keyframe < self.view.keyframes.len())
            .collect();
        for (keyframe, frames) in starts {
            for stretch in self.tracked_backwards(keyframe, frames, stop) {
                let found = self.believed(stretch);
                self.insert_early(found);
            }
        }
    }

    /// Tracks frames backwards in time from a keyframe. What cannot be followed is sought, as after a loss.
    fn tracked_backwards(
        &self,
        keyframe: usize,
        frames: &[EarlyFrame],
        stop: &dyn Fn() -> bool,
    ) -> Vec<Stretch> {
        let start = &self.view.keyframes[keyframe];
        let tracker =
            Tracker::new(&self.view, keyframe, start.camera_from_world, Se3::identity(), &self.params);
        let mut tracker = tracker.at(start.timestamp);
        let places = self.mapper.as_ref().map(|mapper| mapper.places.as_ref());
        let mut stretches = vec![Stretch { frames: Vec::new(), is_claim: false }];
        for frame in frames.iter().rev().take_while(|_| !stop()) {
            let is_claim = self.is_cut_off(&tracker, frame.timestamp);
            let pyramid = Pyramid::new(frame.image.as_ref().clone(), self.params.align.pyramid_levels);
            let Some(located) = tracker.track(&self.view, places, &pyramid, frame.timestamp, &self.params)
            else {
                continue;
            };
            if is_claim {
                stretches.push(Stretch { frames: Vec::new(), is_claim });
            }
            let at = (frame.timestamp, frame.frame_index);
            let found = self.found_at(at, &pyramid, &tracker, located.motion);
            stretches.last_mut().expect("there is a first").frames.push(found);
            tracker.change_reference(&self.view, &located, &self.params);
        }
        stretches
    }

    /// The poses of a stretch in order of time, unless it is a claim that does not hold.
    fn believed(&mut self, stretch: Stretch) -> Vec<FramePose> {
        let Stretch { frames, is_claim } = stretch;
        let in_time = frames.into_iter().rev();
        if is_claim { self.decided(in_time) } else { in_time.map(|found| found.pose).collect() }
    }

    /// Takes frames, in order of time, into the map that is handed out.
    fn insert_early(&mut self, found: Vec<FramePose>) {
        let Some(first) = found.first() else { return };
        let place = self.map.frames.partition_point(|known| known.frame_index < first.frame_index);
        let next = self.map.frames.get(place).map(|known| known.frame_index);
        let is_new = |frame: &FramePose| next.is_none_or(|next| frame.frame_index < next);
        self.insert_frames(place, found.into_iter().take_while(is_new).collect());
    }
}
