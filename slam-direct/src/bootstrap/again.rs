//! Looking at the first map again when there is more parallax: what a few frames could not tell apart, a turn and a way
//! (Chiuso et al., IJCV 2000), more can.
//!
//! The points of the start are followed on, by themselves, so what they say does not depend on the map.

use super::solve::acceptable;
use super::{Bootstrap, BootstrapParams, MIN_POINTS, SecondLook, Started};
use crate::track::TrackParams;
use geometry::{Pyramid, Se3};

impl Bootstrap {
    /// Follows the points into a frame that came after the start. `frame_from_first` gives the pose that a frame has in
    /// the map, by its index, in any unit.
    pub fn look_again(
        &mut self,
        pyramid: &Pyramid,
        (timestamp, frame_index): (f64, u64),
        frame_from_first: &dyn Fn(u64) -> Option<Se3>,
        params: &BootstrapParams,
        track: &TrackParams,
    ) -> SecondLook {
        let count = self.follow_into(pyramid, timestamp, frame_index, track);
        if count < MIN_POINTS || self.frames.len() > params.max_frames {
            return SecondLook::Over;
        }
        match self.contradiction(pyramid, frame_from_first, params) {
            Some(started) => SecondLook::Contradicted(Box::new(started)),
            None => SecondLook::Nothing,
        }
    }

    /// The first map as it is seen now, where it is another.
    fn contradiction(
        &mut self,
        pyramid: &Pyramid,
        frame_from_first: &dyn Fn(u64) -> Option<Se3>,
        params: &BootstrapParams,
    ) -> Option<Started> {
        let (turn, parallax) = self.parallax();
        if parallax < params.look_again * self.looked {
            return None;
        }
        let indices = self.chosen().into_iter().map(|frame| self.frames[frame].frame_index);
        let poses: Vec<Se3> = indices.map(frame_from_first).collect::<Option<_>>()?;
        self.looked = parallax;
        let solution = self.solve(&turn).filter(|solution| acceptable(&solution.problem, params))?;
        let (seen, had) = (solution.problem.frames.last()?, poses.last()?);
        let differs = seen.translation.angle(&had.translation).to_degrees() > params.other_direction
            && self.cost_of(&poses) > params.contradiction * solution.cost;
        differs.then(|| self.finish(&solution.problem, pyramid))
    }
}
