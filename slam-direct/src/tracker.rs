//! Tracks the camera from frame to frame: direct alignment, then reprojection of the map's points.

mod keyframes;
mod located;
mod seen;

pub(crate) use located::{Located, match_keyframe};

use crate::align::{AlignmentReference, Brightness};
use crate::frame::LossReason;
use crate::local_map::LocalMap;
use crate::params::Params;
use crate::rival::{Agreement, Evidence};
use crate::rotation_prior::RotationPrior;
use crate::track::{self, Near, View};
use crate::wide;
use geometry::sensor::{Twist, motion};
use geometry::{Pyramid, Se3};
use located::{locate, median_inverse_depth, near, relocate};
use map::PlaceIndex;
use seen::SeenPoints;

/// Inlier share of an alignment above which no further guess is tried.
const GOOD_ALIGNMENT: f32 = 0.6;
/// Keyframes around the reference that a frame's cost depends on.
const NEAR: usize = 40;

/// Share of the points that agreed in the frame before that still do when a camera goes on as it moved.
const SUDDEN: f32 = 0.5;

/// Factor by which the time from frame to frame changes where one is missing, or comes after one that was: halfway from even frames (1) to
/// those with one missing between them (2). Time stamps of frames that come evenly jitter by less, by a factor of up to 1.35 in `fr1_desk`.
const MISSING: f64 = 1.5;
/// Times the last motion that a camera is taken to go on at the most.
const FARTHEST: f64 = 5.0;
/// Seconds without any frame after which a camera may have been carried elsewhere. A slow computer that is busy with a keyframe leaves out
/// frames for one to three, in which the camera goes on.
const PAUSE: f64 = 5.0;

/// What the tracker remembers from frame to frame.
pub(crate) struct Tracker {
    /// Keyframe that frames are aligned with.
    pub reference: usize,
    alignment: AlignmentReference,
    /// Median inverse depth of the reference's points.
    inverse_depth: f64,
    /// Keyframes with about the same view, among which those are chosen whose points are searched.
    near: Vec<Near>,
    /// Points of the keyframes from which the departure of a frame was computed.
    seen: SeenPoints,
    /// Most points that were searched, and found, in a frame tracked against the reference.
    most_searched: usize,
    most_found: usize,
    most_covered: usize,
    /// Pose of the newest tracked frame, `camera_from_world`.
    pub last: Se3,
    /// Motion of the last frame: `last = velocity * the one before`.
    velocity: Se3,
    /// Time stamp of the newest tracked frame, seconds; unknown before there is one.
    time: Option<f64>,
    /// Mean motion from the frame before to it, in map units, and the seconds between.
    mean_motion: (Twist, f64),
    brightness: Brightness,
    /// Frames in a row that were not found.
    lost: usize,
    /// The smallest image of the newest tracked frame.
    rotation_prior: Option<RotationPrior>,
    /// Share of the searched points that agreed in it.
    share: f32,
    /// Why frames have been lost since the newest tracked one.
    loss: LossReason,
    /// How much the frames up to the newest tracked one say that a part of the map moves.
    second_motion: Evidence,
    /// Whether something that was mapped has moved before, so that two motions are no bent image.
    something_moved: bool,
}

impl Tracker {
    /// Tracks against `reference`, from a pose and motion.
    pub fn new(map: &LocalMap, reference: usize, last: Se3, velocity: Se3, params: &Params) -> Self {
        let points = map.reference_points(reference);
        let inverse_depth = median_inverse_depth(&points);
        Self {
            reference,
            near: near(map, reference, inverse_depth),
            seen: SeenPoints::default(),
            alignment: AlignmentReference::new(
                &map.keyframes[reference].pyramid,
                &map.camera,
                &points,
                &params.align,
            ),
            inverse_depth,
            most_searched: 0,
            most_found: 0,
            most_covered: 0,
            last,
            velocity,
            time: None,
            mean_motion: (Twist::zeros(), 0.0),
            brightness: Brightness::default(),
            lost: 0,
            rotation_prior: None,
            share: 0.0,
            loss: LossReason::default(),
            second_motion: Evidence::default(),
            something_moved: false,
        }
    }

    /// Says whether something that was mapped has moved before: what bends images does so from the first one on, so a second motion is none of that.
    pub fn expect_motions(&mut self, something_moved: bool) {
        self.something_moved = something_moved;
    }

    /// The tracker of a camera that may be anywhere.
    pub fn seeking(self) -> Self {
        Self { lost: 1, ..self }
    }

    /// The tracker of a camera whose last pose is of this time, seconds.
    pub fn at(self, time: f64) -> Self {
        Self { time: Some(time), ..self }
    }

    /// Continues against another reference of the same map.
    fn change_to(&mut self, map: &LocalMap, reference: usize, params: &Params) {
        let seen = std::mem::take(&mut self.seen);
        self.refer_to(map, reference, params);
        self.seen = seen;
    }

    /// Continues against another reference, or in another map.
    pub fn refer_to(&mut self, map: &LocalMap, reference: usize, params: &Params) {
        let (time, mean_motion) = (self.time, self.mean_motion);
        let (lost, rotation_prior, share) = (self.lost, self.rotation_prior.take(), self.share);
        let (loss, second_motion, something_moved) = (self.loss, self.second_motion, self.something_moved);
        let fresh = Self::new(map, reference, self.last, self.velocity, params);
        *self = Self {
            time,
            mean_motion,
            lost,
            rotation_prior,
            share,
            loss,
            second_motion,
            something_moved,
            ..fresh
        };
    }

    /// Continues in a map in which keyframes have moved. `last` is the newest frame's pose there, and `factor` the
    /// change of lengths around the reference.
    pub fn follow_reference(&mut self, map: &LocalMap, last: Se3, factor: f64, params: &Params) {
        self.last = last;
        self.velocity.translation *= factor;
        self.mean_motion.0.fixed_rows_mut::<3>(0).scale_mut(factor);
        self.refer_to(map, self.reference, params);
    }

    /// Finds the frame's pose: direct alignment with the reference, then refinement on the points of the map. If the
    /// frame is not where the motion predicts it, this searches widely and among all `places`. `None` when the frame
    /// is lost, also because there are no places to search.
    pub fn track(
        &mut self,
        map: &LocalMap,
        places: Option<&dyn PlaceIndex>,
        pyramid: &Pyramid,
        timestamp: f64,
        params: &Params,
    ) -> Option<Located> {
        let world_from_reference = map.keyframes[self.reference].camera_from_world.inverse();
        let guesses = [self.expected(timestamp) * world_from_reference, self.last * world_from_reference];
        let aligned =
            track::align_from_guesses(&self.alignment, pyramid, &guesses, self.brightness, GOOD_ALIGNMENT);
        let start = aligned.frame_from_reference * map.keyframes[self.reference].camera_from_world;
        let view = View { pyramid, camera_from_world: start, motion: self.mean_motion_to(&start, timestamp) };
        let motion = |pose: &Se3| self.motion_to(pose, timestamp, params);
        let mut located = locate(map, &self.near, &view, motion, aligned.brightness, self.reference, params);
        let is_there = if self.lost > 0 { located.is_found_again(params) } else { located.is_good(params) };
        let is_one = self.is_one_motion(&located, params);
        if !is_there || !is_one || self.drops(&located, params) {
            let places = places?;
            if is_there && self.lost == 0 && self.is_split(&located, params) {
                return self.lose(LossReason::TwoMotions);
            }
            if let Some(found) = self.search_widely(map, pyramid, timestamp, params) {
                located = found;
            } else if let Some((reference, found)) = relocate(map, places, pyramid, self.reference, params)
                && self.is_one_motion(&found, params)
            {
                self.lost += 1;
                self.refer_to(map, reference, params);
                located = found;
            } else if !is_there || !is_one {
                let agrees = located.inliers >= params.keyframes.min_matched;
                let reason = if self.saw_two_motions() {
                    LossReason::TwoMotions
                } else if agrees && !located.carries_scale(params) {
                    LossReason::Scale
                } else {
                    LossReason::NotFound
                };
                return self.lose(reason);
            }
        }
        Some(self.follow(map, located, pyramid, timestamp, params))
    }

    /// Notes that a frame was not found.
    fn lose(&mut self, loss: LossReason) -> Option<Located> {
        self.lost += 1;
        self.loss = loss;
        self.velocity = Se3::identity();
        None
    }

    /// Share of a frame's points that move against the rest.
    fn moving(&self, agreement: &Agreement) -> f32 {
        let is_bent = agreement.is_bent && !self.something_moved;
        if is_bent { 0.0 } else { agreement.second_motion }
    }

    /// Whether what was mapped moves in two ways, by this frame and those before it. After a loss one frame is enough to be searched further, bent
    /// or not.
    fn is_split(&self, located: &Located, params: &Params) -> bool {
        let (agreement, most) = (&located.agreement, params.track.max_rival);
        if self.lost > 0 {
            agreement.second_motion >= most
        } else {
            self.second_motion.with(self.moving(agreement), most).is_enough(most)
        }
    }

    /// Whether what was mapped moves as one, and always did: a pose that both sides agree with may be one between them.
    fn is_one_motion(&self, located: &Located, params: &Params) -> bool {
        !self.saw_two_motions() && !self.is_split(located, params)
    }

    /// Finds a frame around a pose that was proposed elsewhere, as strictly as after a loss.
    pub fn find_at(
        &mut self,
        map: &LocalMap,
        supposed: &Se3,
        pyramid: &Pyramid,
        timestamp: f64,
        params: &Params,
    ) -> Option<Located> {
        let located = self.search_from(map, supposed, pyramid, timestamp, params)?;
        Some(self.follow(map, located, pyramid, timestamp, params))
    }

    /// Continues from a frame that was found.
    fn follow(
        &mut self,
        map: &LocalMap,
        mut located: Located,
        pyramid: &Pyramid,
        timestamp: f64,
        params: &Params,
    ) -> Located {
        located.mean_motion = self.mean_motion_to(&located.camera_from_world, timestamp);
        // Of a rolling shutter the rows have told it.
        if !map.sensor.is_rolling() {
            located.motion = self.motion_at(&located.mean_motion, timestamp);
        }
        self.velocity =
            if self.lost > 0 { Se3::identity() } else { located.camera_from_world * self.last.inverse() };
        let before = if self.lost > 0 { Evidence::default() } else { self.second_motion };
        self.second_motion = before.with(self.moving(&located.agreement), params.track.max_rival);
        self.lost = 0;
        self.loss = LossReason::default();
        self.mean_motion = (located.mean_motion, self.time.map_or(0.0, |before| timestamp - before));
        self.time = Some(timestamp);
        self.last = located.camera_from_world;
        self.brightness = located.brightness;
        self.rotation_prior = Some(RotationPrior::of(pyramid));
        self.share = located.inlier_share();
        self.most_searched = self.most_searched.max(located.searched.len());
        self.most_found = self.most_found.max(located.inliers);
        self.most_covered = self.most_covered.max(located.covered);
        located
    }

    /// The predicted pose at a time, by constant velocity.
    fn expected(&self, timestamp: f64) -> Se3 {
        let times = self.time.map_or(1.0, |before| timestamp - before) / self.mean_motion.1;
        let is_even = !times.is_finite() || (MISSING.recip()..MISSING).contains(&times);
        let motion = if is_even {
            self.velocity
        } else {
            Se3::exp(&(self.velocity.log() * times.clamp(0.0, FARTHEST)))
        };
        motion * self.last
    }

    /// Mean motion from the newest tracked frame to a pose; zero for a camera that was lost.
    fn mean_motion_to(&self, camera_from_world: &Se3, timestamp: f64) -> Twist {
        let since = self.time.filter(|_| self.lost == 0).map(|before| timestamp - before);
        since.map_or(Twist::zeros(), |since| motion(&self.last, camera_from_world, since))
    }

    /// The same, and the standard deviation of its rotation, radians a second: a mean belongs to the middle of its
    /// time, and the rotation may have changed since.
    fn motion_to(&self, camera_from_world: &Se3, timestamp: f64, params: &Params) -> (Twist, f64) {
        let since = self.time.map_or(0.0, |before| timestamp - before);
        let sigma = 0.5 * since.abs() * f64::from(params.track.rotation_change);
        (self.mean_motion_to(camera_from_world, timestamp), sigma)
    }

    /// The motion of the camera now, from the `mean` motion since the frame before, if it changes as evenly as it
    /// did: means belong to the middle of their time.
    fn motion_at(&self, mean: &Twist, timestamp: f64) -> Twist {
        let (earlier, span) = self.mean_motion;
        match self.time.map(|before| timestamp - before) {
            Some(since) if *mean != Twist::zeros() && earlier != Twist::zeros() => {
                mean + (mean - earlier) * (since / (since + span))
            }
            _ => *mean,
        }
    }

    /// Whether so many fewer points agree than in the frame before that the camera may have jumped, and the few agree
    /// by chance. Then the frame is searched elsewhere too.
    fn drops(&self, located: &Located, params: &Params) -> bool {
        !located.is_found_again(params) && located.inlier_share() < SUDDEN * self.share
    }

    /// Searches the frame's patches one by one around three poses: the predicted one, the last one, and the last one
    /// rotated by the rotation prior.
    fn search_widely(
        &self,
        map: &LocalMap,
        pyramid: &Pyramid,
        timestamp: f64,
        params: &Params,
    ) -> Option<Located> {
        let rotation =
            self.rotation_prior.as_ref().and_then(|before| before.rotation_to(pyramid, &map.camera));
        let turned = rotation.map(|rotation| rotation * self.last);
        let starts = [Some(self.expected(timestamp)), Some(self.last), turned];
        let search = |start| self.search_from(map, start, pyramid, timestamp, params);
        starts
            .iter()
            .flatten()
            .find_map(|start| search(start).filter(|found| self.is_one_motion(found, params)))
    }

    /// Searches the frame's patches one by one around a pose.
    fn search_from(
        &self,
        map: &LocalMap,
        start: &Se3,
        pyramid: &Pyramid,
        timestamp: f64,
        params: &Params,
    ) -> Option<Located> {
        let hosts = track::choose_hosts(map, &self.near, start, self.reference, params.track.max_hosts);
        let motion = |pose: &Se3| self.motion_to(pose, timestamp, params);
        let view = View { pyramid, camera_from_world: *start, motion: motion(start).0 };
        let least = params.keyframes.min_matched;
        let pose = wide::search(map, &hosts, &view, &params.track, &params.wide, least)?;
        let brightness = Brightness::default();
        let view = View { camera_from_world: pose, motion: motion(&pose).0, ..view };
        let located = locate(map, &self.near, &view, motion, brightness, self.reference, params);
        located.is_found_again(params).then_some(Located { wide_search: true, ..located })
    }

    /// Why the frame that was lost last is lost.
    pub fn loss(&self) -> LossReason {
        self.loss
    }

    /// Whether tracking ended because a part of the map moved. It is not found again by motion: only a claim tells what stands still.
    pub fn saw_two_motions(&self) -> bool {
        self.lost > 0 && self.loss == LossReason::TwoMotions
    }

    /// Frames in a row that were not found.
    pub fn lost_frames(&self) -> usize {
        self.lost
    }

    /// Seconds since the newest tracked frame, or until it where frames come backwards; 0 where there is no such frame.
    pub fn seconds_lost(&self, now: f64) -> f64 {
        self.time.map_or(0.0, |tracked| (now - tracked).abs())
    }

    /// Whether a frame of this time comes at least `seconds` after the newest tracked one, and no motion bridges the
    /// gap: frames in between were lost, or none came for `PAUSE` seconds and for longer than the motion can be
    /// extrapolated.
    pub fn is_cut_off(&self, now: f64, seconds: f64) -> bool {
        let (since, step) = (self.seconds_lost(now), self.mean_motion.1.abs());
        let is_gap = step > 0.0 && since > FARTHEST * step && since >= PAUSE;
        since >= seconds && (self.lost > 0 || is_gap)
    }
}

#[cfg(test)]
mod tests;
