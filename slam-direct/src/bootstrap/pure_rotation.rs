//! Detects from the points of a start whether a rotating camera has a rolling shutter.

use super::{Bootstrap, MIN_POINTS};
use crate::params::Params;
use geometry::Pyramid;
use std::ops::RangeInclusive;

/// What a frame did to the question.
pub(crate) enum Turned {
    /// More frames may tell more.
    On,
    /// The view changed too soon to tell.
    Nothing,
    /// The readout times; zeros if all of an image is read at once.
    Readout([f64; 2]),
}

/// Frames that tell something at the least, and that are followed at most.
const FRAMES: RangeInclusive<usize> = 5..=16;
/// Share of the points that must still be seen.
const SEEN: f32 = 0.4;

impl Bootstrap {
    /// Follows the points into a frame; the answer comes when many of them are gone.
    pub fn track_rotation(
        &mut self,
        pyramid: &Pyramid,
        timestamp: f64,
        frame_index: u64,
        params: &Params,
    ) -> Turned {
        let count = self.follow_into(pyramid, timestamp, frame_index, &params.track);
        let continues = count >= MIN_POINTS && count as f32 >= SEEN * self.tracks.len() as f32;
        if continues {
            self.parallax();
            if self.frames.len() < *FRAMES.end() {
                return Turned::On;
            }
        } else {
            self.frames.pop();
        }
        let newest = self.frames.last().filter(|_| FRAMES.contains(&self.frames.len()));
        let solution =
            newest.and_then(|newest| self.solve(&newest.pure_rotation, params.mapping.readout_sigma));
        solution.map_or(Turned::Nothing, |solution| Turned::Readout(solution.sensor.readout))
    }
}
