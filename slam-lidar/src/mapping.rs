//! An agent's map: odometry, keyframes, loops, and the trajectory smoothed over both.

use crate::closure::{Alignment, align};
use crate::degeneracy::conditioning;
use crate::floam::NoRings;
use crate::keyframe::{Keyframe, Submap};
use crate::loop_verdict::{Doubt, Drift, LoopLine, Tie, Tracked, refusal};
use crate::merging::robot_map::RobotMap;
use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::odometry::{Guess, OdometryParams, TrackedSweep};
use crate::smoothing::{Constraint, isotropic, smooth};
use crate::tracking::{Method, Tracker};
use crate::voxels::{VoxelTable, first_of_each_voxel};
use geometry::Se3;
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};
use scans::Scan;
use serde::{Deserialize, Serialize};

/// When keyframes are taken and loops looked for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MappingParams {
    /// Which odometry.
    pub method: Method,
    /// The default odometry's parameters; the ranges of points for all.
    pub odometry: OdometryParams,
    /// A keyframe is taken after so many metres.
    pub distance: f64,
    /// Or after turning by so many radians.
    pub angle: f64,
    /// Grid of a keyframe's points, metres.
    pub grid: f32,
    /// Metres on either side of a keyframe that its submap holds.
    pub reach: f64,
    /// A place is found again only after so many metres of path.
    pub apart: f64,
    /// Earlier keyframes with the nearest ring keys: C of Eq. 10, of which the one nearest by Scan Context is registered.
    pub candidates: usize,
    /// Standard deviations of the odometry from keyframe to keyframe, metres and radians.
    pub odometry_deviation: (f64, f64),
    /// What a registered loop errs by at least, metres and radians.
    pub loop_deviation: (f64, f64),
}

impl Default for MappingParams {
    fn default() -> Self {
        Self {
            method: Method::default(),
            odometry: OdometryParams::default(),
            distance: 1.0,
            angle: 0.35,
            grid: 0.15,
            reach: 3.0,
            apart: 15.0,
            candidates: 10,
            odometry_deviation: (0.005, 0.0005),
            loop_deviation: (0.01, 0.001),
        }
    }
}

/// Loops that the way is smoothed by: where a robot drives the same way for hours it closes one every other keyframe. Of more, every
/// other one of the older half is left out, which others beside it stand for.
const MOST_TIES: usize = 64;

/// A place that was found again.
#[derive(Clone, Copy, Debug)]
pub struct Loop {
    /// The earlier keyframe, by index.
    pub from: usize,
    /// The later one.
    pub to: usize,
    /// How they were brought together.
    pub alignment: Alignment,
}

impl Loop {
    fn tie(&self) -> Tie {
        Tie { from: self.from, to: self.to, from_from_to: self.alignment.target_from_source }
    }
}

/// A place that was registered and is not believed to be the same.
#[derive(Clone, Copy, Debug)]
pub struct RefusedLoop {
    /// The place.
    pub candidate: Loop,
    /// The test that it fails.
    pub line: LoopLine,
}

/// A sweep that was tracked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackedFrame {
    /// The instant of its pose, seconds on the recording's clock.
    pub instant: f64,
    /// Its keyframe, by index: itself or the last one before it.
    pub keyframe: usize,
    /// Its pose in that.
    pub keyframe_from_sensor: Se3,
}

/// An agent that maps.
#[derive(Clone, Debug)]
pub struct Agent {
    params: MappingParams,
    tracker: Tracker,
    /// Keyframes with smoothed poses.
    keyframes: Vec<Keyframe>,
    /// Poses of the keyframes as the odometry gave them, and the path up to them, metres.
    tracked: Vec<(Se3, f64)>,
    sweeps: Vec<TrackedFrame>,
    loops: Vec<Loop>,
    /// Those that the way is smoothed by, at most [`MOST_TIES`].
    ties: Vec<Loop>,
    /// Each keyframe in the frame of the one before, as the odometry gave it.
    steps: Vec<Se3>,
    /// Covariances of what was guessed of these translations, m², in the axes of the world.
    guessed: Vec<Matrix3<f64>>,
    /// The doubt since the last keyframe.
    doubt: Doubt,
    /// Whether keyframes tell where they are: in a smooth tunnel every place fits every other one.
    determined: Vec<bool>,
    /// What they may err by.
    drift: Drift,
    /// Candidates that were registered and refused.
    refused: Vec<RefusedLoop>,
    looked: usize,
}

impl Agent {
    /// An agent with an empty map.
    pub fn new(params: MappingParams) -> Self {
        Self {
            params,
            tracker: Tracker::new(params.method, params.odometry),
            keyframes: Vec::new(),
            tracked: Vec::new(),
            sweeps: Vec::new(),
            loops: Vec::new(),
            ties: Vec::new(),
            steps: Vec::new(),
            guessed: Vec::new(),
            doubt: Doubt::default(),
            determined: Vec::new(),
            drift: Drift::default(),
            refused: Vec::new(),
            looked: 0,
        }
    }

    /// Tracks the next scan; returns its pose and the loop that it closed. A scan that is
    /// [`lost`](TrackedSweep::lost) changes nothing.
    ///
    /// Every other keyframe looks for a loop by Eq. 10: of the [`candidates`](MappingParams::candidates) earlier keyframes
    /// with the nearest ring keys, c* has the least Scan Context distance D. Two things differ from the paper. Ring keys are
    /// compared one by one and not by a k-d tree: a key has 20 numbers, and there is one key for every metre of path. D has
    /// no threshold t: c* is registered, and [`refusal`] decides by the geometry, because two places that look alike from
    /// above have a small D as well.
    ///
    /// # Errors
    /// A scan that the odometry refuses changes nothing.
    pub fn take(&mut self, scan: &Scan) -> Result<(TrackedSweep, Option<Loop>), NoRings> {
        let sweep = self.tracker.track(scan)?;
        if sweep.lost {
            return Ok((sweep, None));
        }
        let closed = if self.add(scan, &sweep) { self.look_for_loop() } else { None };
        Ok((sweep, closed))
    }

    /// Takes the next scan at a motion that is known; no loops are looked for. Either all scans are taken so or none.
    pub fn place(&mut self, scan: &Scan, motion: SweepMotion) -> TrackedSweep {
        let instant = Sweep::of(scan, self.params.odometry.range).middle();
        let information = Matrix6::identity() * 1e6;
        let sweep = TrackedSweep {
            instant,
            world_from_sensor: motion.middle(),
            motion,
            information,
            conditioning: conditioning(&information),
            inlier_share: 1.0,
            rmse: 0.0,
            steps: 0,
            guess: Guess::default(),
            lost: false,
        };
        self.add(scan, &sweep);
        sweep
    }

    /// No more scans come: gives up what only these would be tracked with.
    pub fn end_tracking(&mut self) {
        self.tracker = Tracker::new(self.params.method, self.params.odometry);
    }

    /// Adds a sweep, and says whether it became a keyframe.
    fn add(&mut self, scan: &Scan, sweep: &TrackedSweep) -> bool {
        let pose = sweep.world_from_sensor;
        self.doubt.add(&sweep.guess);
        let is_keyframe = self.is_keyframe(&pose);
        if is_keyframe {
            self.add_keyframe(scan, sweep);
        }
        let keyframe = self.keyframes.len() - 1;
        self.sweeps.push(TrackedFrame {
            instant: sweep.instant,
            keyframe,
            keyframe_from_sensor: self.tracked[keyframe].0.inverse() * pose,
        });
        is_keyframe
    }

    /// Every sweep, in order of time.
    pub fn sweeps(&self) -> &[TrackedFrame] {
        &self.sweeps
    }

    /// Keyframe `k + 1` in the frame of keyframe `k`, as the odometry gave it.
    pub fn steps(&self) -> &[Se3] {
        &self.steps
    }

    /// What [`steps`](Self::steps)`[k]` errs by: covariance of a right increment (υ, ω), m² and rad².
    pub fn step_covariance(&self, k: usize) -> Matrix6<f64> {
        let mut covariance = isotropic(self.params.odometry_deviation);
        let rotation = self.tracked[k + 1].0.rotation_matrix();
        let mut translation = covariance.fixed_view_mut::<3, 3>(0, 0);
        translation += rotation.transpose() * self.guessed[k] * rotation;
        covariance
    }

    /// Keyframes with their smoothed poses.
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// The loops closed so far.
    pub fn loops(&self) -> &[Loop] {
        &self.loops
    }

    /// Candidates that were registered and refused.
    pub fn refused(&self) -> &[RefusedLoop] {
        &self.refused
    }

    /// Every sweep's instant and smoothed `world_from_sensor`.
    pub fn trajectory(&self) -> Vec<(f64, Se3)> {
        let pose = |s: &TrackedFrame| {
            (s.instant, self.keyframes[s.keyframe].world_from_sensor * s.keyframe_from_sensor)
        };
        self.sweeps.iter().map(pose).collect()
    }

    /// Every sweep's instant and `world_from_sensor` as the odometry alone gave it.
    pub fn odometry(&self) -> Vec<(f64, Se3)> {
        let pose = |s: &TrackedFrame| (s.instant, self.tracked[s.keyframe].0 * s.keyframe_from_sensor);
        self.sweeps.iter().map(pose).collect()
    }

    fn is_keyframe(&self, pose: &Se3) -> bool {
        self.tracked.last().is_none_or(|(last, _)| {
            let step = last.inverse() * *pose;
            step.translation.norm() > self.params.distance || step.rotation.angle() > self.params.angle
        })
    }

    fn add_keyframe(&mut self, scan: &Scan, tracked: &TrackedSweep) {
        let pose = tracked.world_from_sensor;
        let points = undistorted(scan, tracked, &self.params);
        let doubt = std::mem::take(&mut self.doubt);
        let (smoothed, path) = match (self.tracked.last(), self.keyframes.last()) {
            (Some((last, path)), Some(keyframe)) => {
                let step = last.inverse() * pose;
                self.steps.push(step);
                self.guessed.push(doubt.guessed);
                (keyframe.world_from_sensor * step, path + step.translation.norm())
            }
            _ => (pose, 0.0),
        };
        self.keyframes.push(Keyframe::new(tracked.instant, smoothed, points));
        self.tracked.push((pose, path));
        self.determined.push(tracked.guess.open == 0);
        self.drift.push(&pose, &doubt);
    }

    /// Keyframes around one along the path.
    fn around(&self, index: usize) -> impl Iterator<Item = &Keyframe> {
        let (path, reach) = (self.tracked[index].1, self.params.reach);
        let near =
            self.keyframes.iter().zip(&self.tracked).filter(move |(_, (_, p))| (p - path).abs() <= reach);
        near.map(|(keyframe, _)| keyframe)
    }

    /// The same as a submap in its frame.
    fn submap(&self, index: usize) -> Submap {
        Submap::new(self.around(index), &self.keyframes[index].world_from_sensor)
    }

    /// The same as a map in its frame.
    fn map_around(&self, index: usize) -> RobotMap {
        let from_world = self.keyframes[index].world_from_sensor.inverse();
        let moved =
            |k: &Keyframe| Keyframe { world_from_sensor: from_world * k.world_from_sensor, ..k.clone() };
        RobotMap::new(&self.around(index).map(moved).collect::<Vec<_>>())
    }

    /// The earlier keyframe most like one of those that may be near by the odometry, and the yaw of the one in it, radians.
    fn candidate(&self, to: usize) -> Option<(usize, f64, Tracked)> {
        let (context, path) = (&self.keyframes[to].context, self.tracked[to].1);
        let old = (0..to).filter(|&i| self.determined[i] && path - self.tracked[i].1 > self.params.apart);
        let mut near: Vec<(f32, usize)> =
            old.map(|i| (context.key_distance(&self.keyframes[i].context), i)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let ties: Vec<Tie> = self.ties.iter().map(Loop::tie).collect();
        let known =
            near.into_iter().map(|(_, i)| (i, self.drift.between(i, to, &ties, self.params.loop_deviation)));
        let admitted = known.filter(|(_, tracked)| tracked.may_be_near()).take(self.params.candidates);
        let similarity = admitted.filter_map(|(i, tracked)| {
            let may_be = |yaw| tracked.may_be_turned(f64::from(yaw));
            Some((i, self.keyframes[i].context.similarity_within(context, may_be)?, tracked))
        });
        let (from, like, tracked) = similarity.min_by(|a, b| a.1.distance.total_cmp(&b.1.distance))?;
        Some((from, f64::from(like.yaw), tracked))
    }

    /// Looks for the last keyframe's place among the earlier ones (Eq. 10, see [`take`](Self::take)).
    fn look_for_loop(&mut self) -> Option<Loop> {
        let to = self.keyframes.len() - 1;
        // A submap needs keyframes on both sides; half of them every other keyframe are enough.
        self.looked += 1;
        if !self.looked.is_multiple_of(2) || !self.determined[to] {
            return None;
        }
        let (from, yaw, tracked) = self.candidate(to)?;
        let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
        let (target, source) = (self.submap(from), self.submap(to));
        let alignment = align(&target, &source, &Se3::new(turned, Vector3::zeros()), true);
        let closed = Loop { from, to, alignment };
        let maps = || [from, to].map(|index| self.map_around(index));
        if let Some(line) = refusal(&target, &source, &alignment, &tracked, maps) {
            self.refused.push(RefusedLoop { candidate: closed, line });
            return None;
        }
        self.loops.push(closed);
        self.ties.push(closed);
        if self.ties.len() > MOST_TIES {
            let mut index = 0;
            self.ties.retain(|_| {
                index += 1;
                index > MOST_TIES / 2 || index % 2 == 1
            });
        }
        self.smooth();
        Some(closed)
    }

    /// Spreads what the loops say over the keyframes.
    fn smooth(&mut self) {
        let deviation = self.params.loop_deviation;
        let constraint = |l: &Loop| Constraint {
            from: l.from,
            to: l.to,
            from_from_to: l.alignment.target_from_source,
            deviation,
        };
        let constraints: Vec<Constraint> = self.ties.iter().map(constraint).collect();
        let covariances: Vec<Matrix6<f64>> = (0..self.steps.len()).map(|k| self.step_covariance(k)).collect();
        let (steps, _) = smooth(&self.steps, &covariances, &constraints);
        for (k, step) in steps.iter().enumerate() {
            self.keyframes[k + 1].world_from_sensor =
                (self.keyframes[k].world_from_sensor * *step).renormalized();
        }
    }
}

/// Stage two's points of a scan, thinned, in the sensor's frame in the middle of the sweep.
pub fn undistorted(scan: &Scan, tracked: &TrackedSweep, params: &MappingParams) -> Vec<[f32; 3]> {
    let sweep = Sweep::of(scan, params.odometry.range);
    let table = MotionTable::new(&tracked.motion, &tracked.world_from_sensor.inverse());
    let points = sweep.undistorted(&table);
    let mut kept = Vec::new();
    first_of_each_voxel(&points, params.grid, &mut VoxelTable::default(), &mut kept);
    kept.iter().map(|&i| points[i as usize]).collect()
}
