//! The first map. Patches of the first frame are followed until they have moved enough; then one optimisation, from
//! several starts, gives the poses and inverse depths of all frames so far.
//!
//! No essential matrix is needed: with inverse depths and small motions the joint problem converges from constant
//! depth (Yu & Gallup, CVPR 2014). Several directions of travel guard against its mirror solutions.

mod again;
mod finish;
mod follow;
pub(crate) mod params;
mod pure_rotation;
mod rival;
mod solve;

use crate::local_map::LocalMap;
use crate::mask::Mask;
use crate::params::Params;
use crate::track::TrackParams;
use follow::Track;
use geometry::sensor::Sensor;
use geometry::{Pinhole, Pyramid, Se3};
use params::BootstrapParams;
use solve::acceptable;

pub(crate) use pure_rotation::Turned;

/// A frame of the start.
struct Followed {
    timestamp: f64,
    frame_index: u64,
    /// How the camera turned since the first frame.
    pure_rotation: Se3,
    /// Per followed point: where it is.
    seen: Vec<Option<([f32; 2], [f32; 3])>>,
}

/// A start in progress.
pub(crate) struct Bootstrap {
    camera: Pinhole,
    /// What is known of it.
    sensor: Sensor,
    first: Pyramid,
    timestamp: f64,
    frame_index: u64,
    tracks: Vec<Track>,
    frames: Vec<Followed>,
    /// Parallax at which a map was made or looked at again last, pixels.
    looked: f32,
}

/// What a frame did to the start.
pub(crate) enum Progress {
    /// More frames are needed.
    Waiting(&'static str),
    /// The first frame is of no use any more: begin with this one.
    Restart(&'static str),
    /// There is a map: two keyframes, and the poses of the frames between relative to the first.
    Done(Box<Started>),
}

/// What a frame after the start says of the map that came of it.
pub(crate) enum SecondLook {
    /// Nothing new.
    Nothing,
    /// That no more can be learnt: too few of the points are still seen.
    Over,
    /// That it is wrong, and what is right.
    Contradicted(Box<Started>),
    /// That its points move in two ways.
    TwoMotions,
}

/// The first map.
pub(crate) struct Started {
    pub map: LocalMap,
    /// `(timestamp, frame index, frame_from_first)` of the frames after the first, the last one included.
    pub frames: Vec<(f64, u64, Se3)>,
}

/// Why there is no map of points that move in two ways.
pub(crate) const TWO_MOTIONS: &str = "something moves in the view, and nothing tells what stands still";

/// Points without which there is no first map.
const MIN_POINTS: usize = 60;

impl Bootstrap {
    /// Begins with a frame, of which one point in each block of `block` pixels is followed; `None` when it has too little
    /// texture.
    pub fn new(
        sensor: Sensor,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        mask: &Mask,
        block: usize,
    ) -> Option<Self> {
        let tracks = follow::choose(&pyramid, block, mask);
        (tracks.len() >= MIN_POINTS).then_some(Self {
            camera: sensor.lens.camera,
            sensor,
            first: pyramid,
            timestamp,
            frame_index,
            tracks,
            frames: Vec::new(),
            looked: 0.0,
        })
    }

    /// Follows the points into a frame and tries for a map when they have moved enough.
    pub fn add(&mut self, pyramid: &Pyramid, timestamp: f64, frame_index: u64, params: &Params) -> Progress {
        let count = self.follow_into(pyramid, timestamp, frame_index, &params.track);
        let all_params = params;
        let params = &params.bootstrap;
        if (count as f32) < params.min_followed * self.tracks.len() as f32 || count < MIN_POINTS {
            return Progress::Restart("the view changed before the first map was made");
        }
        let (pure_rotation, parallax) = self.parallax();
        if parallax < params.min_parallax * self.camera.width as f32 {
            if self.is_over(params) {
                return Progress::Restart("the camera hardly moved");
            }
            return Progress::Waiting("waiting for the camera to move sideways");
        }
        let solution = self.solve(&pure_rotation, all_params.mapping.readout_sigma);
        let solution = solution.filter(|solution| acceptable(&solution.problem, params));
        match solution {
            Some(solution) if self.has_two_motions(&solution, &pure_rotation, all_params) => {
                match self.is_over(params) {
                    true => Progress::Restart(TWO_MOTIONS),
                    false => Progress::Waiting(TWO_MOTIONS),
                }
            }
            Some(solution) => {
                self.looked = parallax;
                self.sensor = solution.sensor;
                Progress::Done(Box::new(self.finish(&solution, pyramid)))
            }
            None if self.is_over(params) => Progress::Restart("no consistent first map"),
            None => Progress::Waiting("the first map is not certain yet"),
        }
    }

    /// Whether the start has had its time.
    fn is_over(&self, params: &BootstrapParams) -> bool {
        let last = self.frames.last().map_or(self.timestamp, |frame| frame.timestamp);
        self.frames.len() >= params.least_frames && last - self.timestamp >= params.max_seconds
    }

    /// Leaves out the points that prove to move with the camera.
    pub fn leave_out(&mut self, mask: &Mask) {
        self.tracks
            .iter_mut()
            .filter(|track| mask.covers_at(track.pixel))
            .for_each(|track| track.lost = true);
    }

    /// Index of the frame that the start began with.
    pub fn first_frame(&self) -> u64 {
        self.frame_index
    }

    /// Follows the points into a frame; how many it shows.
    fn follow_into(
        &mut self,
        pyramid: &Pyramid,
        timestamp: f64,
        frame_index: u64,
        track: &TrackParams,
    ) -> usize {
        follow::follow(&mut self.tracks, pyramid, track);
        let seen: Vec<_> = self.tracks.iter().map(|t| t.seen.filter(|_| !t.lost)).collect();
        let count = seen.iter().flatten().count();
        self.frames.push(Followed { timestamp, frame_index, pure_rotation: Se3::identity(), seen });
        count
    }
}

#[cfg(test)]
mod tests;
