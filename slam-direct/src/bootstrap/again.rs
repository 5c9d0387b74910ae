//! Checks the first map again when there is more parallax. More frames can tell a rotation from a translation where
//! the first few could not (Chiuso et al., IJCV 2000).
//!
//! The points of the start are followed further by themselves, so the result does not depend on the map.

use super::solve::{Solution, acceptable};
use super::{Bootstrap, BootstrapParams, MIN_POINTS, SecondLook, Started};
use crate::params::Params;
use geometry::{Pyramid, Se3};

impl Bootstrap {
    /// Follows the points into a frame that came after the start. `frame_from_first` gives the pose that a frame has in
    /// the map, by its index, in any unit.
    pub fn look_again(
        &mut self,
        pyramid: &Pyramid,
        (timestamp, frame_index): (f64, u64),
        frame_from_first: &dyn Fn(u64) -> Option<Se3>,
        params: &Params,
    ) -> SecondLook {
        let count = self.follow_into(pyramid, timestamp, frame_index, &params.track);
        if count < MIN_POINTS || self.is_over(&params.bootstrap) {
            return SecondLook::Over;
        }
        self.second_look(pyramid, frame_from_first, params).unwrap_or(SecondLook::Nothing)
    }

    /// What the points say now that they have moved further than when they were looked at last.
    fn second_look(
        &mut self,
        pyramid: &Pyramid,
        frame_from_first: &dyn Fn(u64) -> Option<Se3>,
        params: &Params,
    ) -> Option<SecondLook> {
        let (pure_rotation, parallax) = self.parallax();
        if parallax < params.bootstrap.look_again * self.looked {
            return None;
        }
        let indices = self.chosen().into_iter().map(|frame| self.frames[frame].frame_index);
        let poses: Vec<Se3> = indices.map(frame_from_first).collect::<Option<_>>()?;
        self.looked = parallax;
        let solution = self.solve(&pure_rotation, params.mapping.readout_sigma)?;
        if self.has_two_motions(&solution, &pure_rotation, params) {
            return Some(SecondLook::TwoMotions);
        }
        let started = self.contradiction(&solution, &poses, pyramid, &params.bootstrap)?;
        Some(SecondLook::Contradicted(Box::new(started)))
    }

    /// The first map as it is seen now, where it is another than with these poses of the chosen frames.
    fn contradiction(
        &mut self,
        solution: &Solution,
        poses: &[Se3],
        pyramid: &Pyramid,
        p: &BootstrapParams,
    ) -> Option<Started> {
        if !acceptable(&solution.problem, p) {
            return None;
        }
        let (seen, had) = (solution.problem.frames.last()?, poses.last()?);
        // What was mapped of images that are bent while they are read is bent too.
        let is_bent = solution.sensor.is_rolling() && !self.sensor.is_rolling();
        let differs = is_bent
            || seen.translation.angle(&had.translation).to_degrees() > p.other_direction
                && self.cost_of(poses) > p.contradiction * solution.cost;
        differs.then(|| {
            self.sensor = solution.sensor;
            self.finish(solution, pyramid)
        })
    }
}
