//! The default odometry: each sweep's motion against a local map of planes, in continuous time.
//!
//! Stage one of the paper's compensation is the prediction, in which the sensor keeps its motion; stage two is the
//! motion found, with which the points enter the map. In between the motion within the sweep is part of what is
//! estimated, so that a prediction that is wrong (a car that is already driving, a robot that turns hard) costs
//! nothing.

mod guess;
mod search;
mod wandering;

pub use guess::Guess;
use guess::Guessing;
use wandering::Wandering;

use crate::degeneracy::{Conditioning, WEAK_TRANSLATION, conditioning, translations};
use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::registration::{Prediction, Registration, RegistrationParams, false_information, register_by};
use crate::start::first_displacement;
use crate::surfaces::{SurfaceMap, SurfaceParams};
use crate::velocity::Velocity;
use crate::voxels::{VoxelTable, first_of_each_voxel};
use geometry::{Se3, median};
use nalgebra::{Matrix6, Vector6};
use scans::Scan;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// How sweeps are tracked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryParams {
    /// Nearest and farthest range used, metres.
    pub range: (f32, f32),
    /// Edge of the smallest voxels of the map as a share of the median range of the first sweep: small rooms have
    /// fine structure, and far points lie apart. 0: as [`SurfaceParams::voxel`] says.
    pub voxel_of_range: f32,
    /// Smallest and largest voxels that are taken so, metres.
    pub voxel_bounds: (f32, f32),
    /// Grid on which the points are thinned that find the motion, in voxels of the map. Coarser is faster.
    pub registered: f32,
    /// Grid on which the points are thinned that enter the map, in voxels of the map.
    pub mapped: f32,
    /// What lies farther is forgotten, metres.
    pub radius: f32,
    /// The local map.
    pub surfaces: SurfaceParams,
    /// How a sweep is registered.
    pub registration: RegistrationParams,
}

impl Default for OdometryParams {
    fn default() -> Self {
        Self {
            range: (0.5, 100.0),
            voxel_of_range: 0.04,
            voxel_bounds: (0.25, 0.5),
            registered: 1.6,
            mapped: 0.4,
            radius: 120.0,
            surfaces: SurfaceParams { long: true, ..SurfaceParams::default() },
            registration: RegistrationParams::default(),
        }
    }
}

impl OdometryParams {
    /// Edge of the smallest voxels of a map whose first sweep has these points, metres.
    pub fn voxel_for(&self, points: &[[f32; 3]]) -> f32 {
        let (least, most) = self.voxel_bounds;
        (median_range(points) * self.voxel_of_range).clamp(least, most.max(least))
    }
}

/// A sweep's pose, with its instant and its evidence.
#[derive(Clone, Copy, Debug)]
pub struct TrackedSweep {
    /// The instant to which the pose belongs: the middle of the sweep, seconds on the recording's clock.
    pub instant: f64,
    /// The sensor's pose at that instant; the world is the sensor's frame at the first.
    pub world_from_sensor: Se3,
    /// The motion during the sweep.
    pub motion: SweepMotion,
    /// Information of the points on the pose, tangent (υ, ω) at the sensor in the axes of the world; where they say little without what
    /// they say only because normals lean by chance.
    pub information: Matrix6<f64>,
    /// How well the points determine the pose.
    pub conditioning: Conditioning,
    /// Share of the points that agree with the map.
    pub inlier_share: f64,
    /// Root mean square distance of those from their surfaces, metres.
    pub rmse: f64,
    /// Gauss–Newton steps taken.
    pub steps: usize,
    /// What of the motion since the sweep before the points do not tell, but the motion model, or tell badly.
    pub guess: Guess,
    /// Whether the sensor is not where it should be: the pose is none, and the map has nothing of the sweep.
    pub lost: bool,
}

/// Tracks a sensor, sweep after sweep.
#[derive(Clone, Debug)]
pub struct Odometry {
    params: OdometryParams,
    map: SurfaceMap,
    last: Option<Last>,
    /// The first sweep, until the motion that distorted it is known.
    first: Option<Sweep>,
    /// The velocity, from the second sweep on.
    velocity: Option<Velocity>,
    guessing: Guessing,
    wandering: Wandering,
    /// Whether sweeps that contradict the map are sought elsewhere.
    seeks: bool,
    swept: usize,
    /// Of the newest sweeps that were tracked, the share of the points that agreed, and of those that could.
    shares: VecDeque<(f64, f64)>,
    table: VoxelTable,
    kept: Vec<u32>,
}

/// The sweep before.
#[derive(Clone, Copy, Debug)]
struct Last {
    motion: SweepMotion,
    /// Twist per second in the sensor's frame.
    twist: Vector6<f64>,
    instants: (f64, f64),
    middle: f64,
}

/// The first motion is found in so many rounds: each undistorts the first sweep with the motion of the last round.
const STARTING_ROUNDS: usize = 3;
/// What the first motion may err by, metres and radians a second.
const STARTING_DOUBT: (f64, f64) = (1.0, 1.0);
/// Grid on which the points are thinned that find the first motion, in voxels of the map.
const STARTING_GRID: f32 = 2.0;
/// Sweeps follow each other without a gap when their instants leave less than this share of a sweep between them.
const CONTIGUOUS: f64 = 0.3;
/// Over a longer time than this, seconds, no sensor keeps its motion: a recording pauses, or its clock was set ahead, and the sensor is sought
/// where it would be without.
const LONGEST_GAP: f64 = 3.0;
/// Standard deviation that points claim, metres, above which what they claim is looked at: a tenth of what is weak. What normals that lean by
/// chance claim is a hundredth of that information.
const LOOKED_AT: f64 = 0.1 * WEAK_TRANSLATION;
/// Sweeps after which what lies far away is forgotten, again and again.
const FORGET_EVERY: usize = 50;

impl Odometry {
    /// Tracking with an empty map.
    pub fn new(params: OdometryParams) -> Self {
        let map = SurfaceMap::new(params.surfaces);
        let (table, kept) = (VoxelTable::default(), Vec::new());
        Self {
            params,
            map,
            last: None,
            first: None,
            velocity: None,
            guessing: Guessing::default(),
            wandering: Wandering::default(),
            seeks: true,
            swept: 0,
            shares: VecDeque::new(),
            table,
            kept,
        }
    }

    /// The same, where sweeps that contradict the map stay where they are: how much agrees then tells whether points have the right times.
    #[must_use]
    pub fn without_search(self) -> Self {
        Self { seeks: false, ..self }
    }

    /// The local map.
    pub fn map(&self) -> &SurfaceMap {
        &self.map
    }

    /// Tracks the next scan, which must come after those before. One that is [`lost`](TrackedSweep::lost) changes nothing.
    pub fn track(&mut self, scan: &Scan) -> TrackedSweep {
        let sweep = Sweep::of(scan, self.params.range);
        self.swept += 1;
        let registration = match (self.last, self.first.take()) {
            (None, _) => self.begin(&sweep),
            (Some(last), Some(first)) => self.start(first, &sweep, last),
            (Some(last), None) => self.follow(&sweep, &last),
        };
        let mut tracked = self.describe(&sweep, &registration);
        if tracked.lost {
            return tracked;
        }
        let guess = self.guess(&sweep, &registration);
        let place = &tracked.world_from_sensor.translation;
        tracked.guess = self.wandering.next(place, &registration.information, guess);
        self.learn_shares(&registration);
        if self.last.is_none() {
            self.first = Some(sweep.clone());
        }
        self.last = Some(self.remember(&sweep, registration.motion));
        if self.swept.is_multiple_of(FORGET_EVERY) {
            let t = tracked.world_from_sensor.translation;
            self.map.keep_near([t.x as f32, t.y as f32, t.z as f32], self.params.radius);
        }
        tracked
    }

    /// The first sweep makes the map.
    fn begin(&mut self, sweep: &Sweep) -> Registration {
        let motion = SweepMotion::resting(Se3::identity());
        if self.params.voxel_of_range > 0.0 {
            self.params.surfaces.voxel = self.params.voxel_for(&sweep.points);
            self.map = SurfaceMap::new(self.params.surfaces);
        }
        self.insert(sweep, &motion);
        Registration {
            information: Matrix6::identity() * 1e6,
            inlier_share: 1.0,
            known_share: 1.0,
            support: 1.0,
            ..Registration::unknown(motion)
        }
    }

    /// The second sweep tells the motion, with which the first is undistorted; round by round both improve.
    fn start(&mut self, first: Sweep, sweep: &Sweep, rest: Last) -> Registration {
        let seconds = (sweep.middle() - rest.middle).max(1e-3);
        first_of_each_voxel(&sweep.points, STARTING_GRID * self.map.voxel(), &mut self.table, &mut self.kept);
        let params = &self.params.registration;
        let mut step = first_displacement(sweep, &self.kept, &self.map, seconds, params);
        let mut registration = None;
        for _ in 0..STARTING_ROUNDS {
            let twist = step.log() / seconds;
            let half = Se3::exp(&(twist * (0.5 * (first.instants.1 - first.instants.0))));
            let motion = SweepMotion { begin: half.inverse(), end: half };
            let last = Last { motion, twist, ..rest };
            self.map = SurfaceMap::new(self.params.surfaces);
            self.insert(&first, &motion);
            let found = self.locate(sweep, &last, STARTING_DOUBT);
            step = found.motion.middle();
            registration = Some(found);
        }
        let registration = registration.unwrap_or_else(|| unreachable!("there is a starting round"));
        self.insert(sweep, &registration.motion);
        registration
    }

    fn follow(&mut self, sweep: &Sweep, last: &Last) -> Registration {
        let mut registration = self.locate(sweep, last, (0.0, 0.0));
        if self.is_doubtful(&registration) {
            registration = self.search(sweep, last, registration);
        }
        if !self.is_lost(&registration) {
            self.insert(sweep, &registration.motion);
        }
        registration
    }

    /// Finds the motion of a sweep. `doubt` is what the last twist may err by, per second, besides accelerations.
    fn locate(&mut self, sweep: &Sweep, last: &Last, doubt: (f64, f64)) -> Registration {
        let prediction = self.predict(sweep, last, doubt);
        first_of_each_voxel(
            &sweep.points,
            self.params.registered * self.map.voxel(),
            &mut self.table,
            &mut self.kept,
        );
        self.register(sweep, last, &prediction)
    }

    /// The same from a prediction, of points that were chosen.
    fn register(&self, sweep: &Sweep, last: &Last, prediction: &Prediction) -> Registration {
        let params = &self.params.registration;
        let (used, map) = (&self.kept, &self.map);
        // Until what is guessed is said poses are those that all axes give: voxels' ends help where a sweep tells little of the height.
        let asked = self.guessing.asked();
        let mut found = register_by(sweep, used, map, prediction, params, asked);
        if translations(&found.information).0[0] > LOOKED_AT {
            found.information -= false_information(sweep, used, map, &found.motion, params, asked);
        }
        self.carried(sweep, last, found)
    }

    /// Seconds between two sweeps in which nothing was seen.
    fn gap(&self, sweep: &Sweep, last: &Last) -> f64 {
        match sweep.instants.0 - last.instants.1 {
            // The sensor spins on: one sweep begins where the other ends, and what differs is how stamps were rounded.
            gap if gap.abs() < CONTIGUOUS * (sweep.instants.1 - sweep.instants.0) => 0.0,
            gap if gap > LONGEST_GAP => 0.0,
            gap => gap,
        }
    }

    /// Stage one: the sensor keeps its motion.
    fn predict(&self, sweep: &Sweep, last: &Last, doubt: (f64, f64)) -> Prediction {
        let params = &self.params.registration;
        let duration = sweep.instants.1 - sweep.instants.0;
        let gap = self.gap(sweep, last);
        let begin = last.motion.end * Se3::exp(&(last.twist * gap));
        let motion = SweepMotion { begin, end: begin * Se3::exp(&(last.twist * duration)) };
        // Between the middles of two sweeps the speed changes by the acceleration times their distance in time.
        let apart = match sweep.middle() - last.middle {
            apart if apart > LONGEST_GAP => duration,
            apart => apart,
        };
        let change = |acceleration: f64, doubt: f64| doubt + acceleration * apart;
        let speed = (change(params.acceleration.0, doubt.0), change(params.acceleration.1, doubt.1));
        let over = |seconds: f64| (speed.0 * seconds, speed.1 * seconds);
        let across = over(gap.max(0.0));
        Prediction {
            motion,
            begin: (
                params.continuity.0.hypot(across.0).hypot(bend(params.acceleration.0, duration)),
                params.continuity.1.hypot(across.1).hypot(bend(params.acceleration.1, duration)),
            ),
            displacement: over(duration.max(1e-3)),
        }
    }

    /// Stage two: points enter the map freed from the motion that was found.
    fn insert(&mut self, sweep: &Sweep, motion: &SweepMotion) {
        first_of_each_voxel(
            &sweep.points,
            self.params.mapped * self.map.voxel(),
            &mut self.table,
            &mut self.kept,
        );
        let table = MotionTable::new(motion, &Se3::identity());
        let world =
            self.kept.iter().map(|&i| table.transform(sweep.points[i as usize], sweep.shares[i as usize]));
        self.map.insert(world);
    }

    fn remember(&self, sweep: &Sweep, motion: SweepMotion) -> Last {
        let duration = sweep.instants.1 - sweep.instants.0;
        let twist = match self.last {
            _ if duration > 0.0 => motion.displacement().log() / duration,
            Some(last) => {
                (last.motion.middle().inverse() * motion.middle()).log()
                    / (sweep.middle() - last.middle).max(1e-3)
            }
            None => Vector6::zeros(),
        };
        Last { motion, twist, instants: sweep.instants, middle: sweep.middle() }
    }

    fn describe(&self, sweep: &Sweep, registration: &Registration) -> TrackedSweep {
        TrackedSweep {
            instant: sweep.middle(),
            world_from_sensor: registration.motion.middle(),
            motion: registration.motion,
            information: registration.information,
            conditioning: conditioning(&registration.information),
            inlier_share: registration.inlier_share,
            rmse: registration.rmse,
            steps: registration.steps,
            guess: Guess::default(),
            lost: self.is_lost(registration),
        }
    }
}

/// How far two sweeps that follow each other may gape because each is taken to move evenly: under an acceleration a, the even motion that
/// fits a sweep of T seconds best ends a T²/12 beside where the sensor was, and the next one begins as far off.
fn bend(acceleration: f64, seconds: f64) -> f64 {
    std::f64::consts::SQRT_2 * acceleration * seconds * seconds / 12.0
}

/// Median distance of points from the sensor, metres; 0 of none.
fn median_range(points: &[[f32; 3]]) -> f32 {
    let mut ranges: Vec<f32> = points.iter().map(|p| p.iter().map(|v| v * v).sum::<f32>().sqrt()).collect();
    median(&mut ranges).unwrap_or(0.0)
}
