//! The paper's odometry (Eq. 1–4), `floam`, and A-LOAM's, `a-loam`, to compare with.
//!
//! FLOAM: features freed from the predicted motion (stage one) are matched with the map of edges and planes, the pose
//! is the minimum of Eq. 4, and the features enter the map freed from the motion that was found (stage two). The
//! public FLOAM has neither stage; both are built here from the text. A-LOAM: features are first matched with those of
//! the last sweep (`a_loam`), and then with the map.
//!
//! What the paper leaves open: the weights of Eq. 4 are exponentials of the smoothness with mean 1; a robust kernel
//! (Huber, 0.1 m) and the tests of lines and planes are those of the public code. The motion with which a recording
//! begins is that of the default's start: features reach a metre, and a car drives farther between two sweeps.

use crate::a_loam::LastFeatures;
use crate::degeneracy::conditioning;
use crate::feature_step::{Fit, ROUNDS, STEPS, Target, place, step};
use crate::features::{Feature, Features, features};
use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::odometry::{Guess, Odometry, OdometryParams, TrackedSweep};
use crate::point_grid::PointGrid;
use crate::registration::moved;
use crate::surfaces::sorted_eigen;
use geometry::Se3;
use nalgebra::{Matrix3, Vector3};
use scans::Scan;

/// Which of the two is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureMethod {
    /// Scan to map, distortion compensated outside of the solver.
    Floam,
    /// Scan to scan with the distortion inside, then scan to map.
    ALoam,
}

/// Spacing of edges and planes in the map, metres (the public code's leaf sizes).
const LEAVES: (f32, f32) = (0.2, 0.4);
/// Rounds of matching at the start, when the motion is not known yet.
const STARTING_ROUNDS: usize = 12;
/// Range of points used, metres.
const RANGE: (f32, f32) = (0.5, 100.0);

/// An odometry on features of scans.
#[derive(Clone, Debug)]
pub struct FeatureOdometry {
    method: FeatureMethod,
    edges: PointGrid,
    planes: PointGrid,
    last: Option<Last>,
    swept: usize,
    /// The first scan until there is a second, which tells the motion during it.
    first: Option<Scan>,
}

#[derive(Clone, Debug)]
struct Last {
    motion: SweepMotion,
    /// Of A-LOAM: what the next sweep is first matched with.
    features: Option<LastFeatures>,
}

impl FeatureOdometry {
    /// Tracking with an empty map.
    pub fn new(method: FeatureMethod) -> Self {
        let (edges, planes) = (PointGrid::new(LEAVES.0), PointGrid::new(LEAVES.1));
        Self { method, edges, planes, last: None, swept: 0, first: None }
    }

    /// Points in the map.
    pub fn map_points(&self) -> usize {
        self.edges.len() + self.planes.len()
    }

    /// Tracks the next scan, which must come after those before.
    ///
    /// # Errors
    /// A scan without rings has no such features.
    pub fn track(&mut self, scan: &Scan) -> Result<TrackedSweep, NoRings> {
        let sweep = Sweep::of(scan, RANGE);
        if sweep.rings.is_empty() {
            return Err(NoRings);
        }
        let found = features(&sweep);
        if let Some(first) = self.first.take() {
            self.start(&first, scan);
        }
        let (motion, fit) = match self.last.take() {
            None => (SweepMotion::resting(Se3::identity()), Fit::default()),
            Some(last) => self.locate(&sweep, &found, &last),
        };
        if self.swept == 0 {
            self.first = Some(scan.clone());
        }
        self.swept += 1;
        self.remember(&sweep, &found, motion);
        Ok(TrackedSweep {
            instant: sweep.middle(),
            world_from_sensor: motion.middle(),
            motion,
            information: fit.information,
            conditioning: conditioning(&fit.information),
            inlier_share: fit.matched as f64 / (found.edges.len() + found.planes.len()).max(1) as f64,
            rmse: fit.rmse,
            steps: fit.steps,
            guess: Guess::default(),
            lost: false,
        })
    }

    /// The first sweep once more, now that the second tells how the sensor moved during it.
    fn start(&mut self, first: &Scan, second: &Scan) {
        let mut default = Odometry::new(OdometryParams::default());
        let before = default.track(first).instant;
        let next = default.track(second);
        let sweep = Sweep::of(first, RANGE);
        let share = (sweep.instants.1 - sweep.instants.0) / (next.instant - before).max(1e-3);
        let half = Se3::exp(&(next.world_from_sensor.log() * (0.5 * share)));
        (self.edges, self.planes) = (PointGrid::new(LEAVES.0), PointGrid::new(LEAVES.1));
        let found = features(&sweep);
        self.remember(&sweep, &found, SweepMotion { begin: half.inverse(), end: half });
    }

    fn locate(&self, sweep: &Sweep, found: &Features, last: &Last) -> (SweepMotion, Fit) {
        // Stage one (Eq. 2): the sensor keeps its motion.
        let begin = last.motion.end;
        let mut motion = SweepMotion { begin, end: begin * last.motion.displacement() };
        if let Some(features) = &last.features {
            motion = features.follow(sweep, found);
        }
        let rounds = if self.swept < 3 { STARTING_ROUNDS } else { ROUNDS };
        // From here the sweep is rigid: what was undistorted with the predicted motion moves as one.
        let displacement = motion.displacement();
        let mut fit = Fit::default();
        for _ in 0..rounds {
            let table = MotionTable::new(&motion, &Se3::identity());
            let targets = self.targets(sweep, found, &table);
            let mut world = motion.end;
            for _ in 0..STEPS {
                let moved = SweepMotion { begin: world * displacement.inverse(), end: world };
                let Some((delta, found)) = step(sweep, &targets, &moved, true) else { break };
                fit = Fit { matched: targets.len(), steps: fit.steps + 1, ..found };
                world = self::moved(&world, &moved.middle().translation, &delta);
            }
            motion = SweepMotion { begin: world * displacement.inverse(), end: world };
        }
        // A-LOAM found the motion within the sweep before it came to the map.
        if self.method == FeatureMethod::ALoam {
            return (motion, fit);
        }
        // Stage two: the motion that was found, from the end of the sweep before.
        (SweepMotion { begin, end: motion.end }, fit)
    }

    fn targets(&self, sweep: &Sweep, found: &Features, table: &MotionTable) -> Vec<Target> {
        let edges = weights(&found.edges, 1.0).zip(&found.edges).filter_map(|(weight, f)| {
            let near = self.edges.nearest::<5>(place(sweep, f, table))?;
            line(&near).map(|(point, normals)| Target { feature: f.point, point, normals, count: 2, weight })
        });
        let planes = weights(&found.planes, -1.0).zip(&found.planes).filter_map(|(weight, f)| {
            let near = self.planes.nearest::<5>(place(sweep, f, table))?;
            plane(&near).map(|(point, n)| Target {
                feature: f.point,
                point,
                normals: [n, n],
                count: 1,
                weight,
            })
        });
        edges.chain(planes).collect()
    }

    fn remember(&mut self, sweep: &Sweep, found: &Features, motion: SweepMotion) {
        let table = MotionTable::new(&motion, &Se3::identity());
        found.edges.iter().for_each(|f| self.edges.insert(place(sweep, f, &table), 0));
        found.planes.iter().for_each(|f| self.planes.insert(place(sweep, f, &table), 0));
        let features = (self.method == FeatureMethod::ALoam).then(|| LastFeatures::of(sweep, found, &motion));
        self.last = Some(Last { motion, features });
    }
}

/// A scan that does not say on which ring its points lie, and is not stored ring by ring.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the scan has no rings, on which features by smoothness are defined; use the default method")]
pub struct NoRings;

/// Weights of Eq. 4: `exp(± α)`, relative to their mean.
fn weights(features: &[Feature], sign: f64) -> impl Iterator<Item = f64> {
    let raw = move |f: &Feature| (sign * f64::from(f.smoothness)).exp();
    let mean = features.iter().map(raw).sum::<f64>() / features.len().max(1) as f64;
    features.iter().map(move |f| raw(f) / mean)
}

fn scatter(points: &[[f32; 3]; 5]) -> (Vector3<f64>, [f64; 3], Matrix3<f64>) {
    let vectors = points.map(|p| Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])));
    let mean = vectors.iter().sum::<Vector3<f64>>() / 5.0;
    let covariance = vectors.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<Matrix3<f64>>() / 5.0;
    let (values, axes) = sorted_eigen(covariance);
    (mean, values, axes)
}

/// A line through five points, when their scatter along it is three times any other.
fn line(points: &[[f32; 3]; 5]) -> Option<([f32; 3], [[f32; 3]; 2])> {
    let (mean, values, axes) = scatter(points);
    let axis = |k: usize| [0, 1, 2].map(|i| axes[(i, k)] as f32);
    (values[2] > 3.0 * values[1]).then(|| ([0, 1, 2].map(|i| mean[i] as f32), [axis(0), axis(1)]))
}

/// A plane through five points, when all lie within 0.2 m of it.
fn plane(points: &[[f32; 3]; 5]) -> Option<([f32; 3], [f32; 3])> {
    let (mean, _, axes) = scatter(points);
    let normal = axes.column(0);
    let off = |p: &[f32; 3]| (0..3).map(|i| normal[i] * (f64::from(p[i]) - mean[i])).sum::<f64>().abs();
    let fits = points.iter().all(|p| off(p) < 0.2);
    fits.then(|| ([0, 1, 2].map(|i| mean[i] as f32), [0, 1, 2].map(|i| normal[i] as f32)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbox_tests::lidar::{HALL, PERIOD, sweep, walk};

    /// A hall of which `count` sweeps are seen, ranges noisy: where the sensor is in the frame of its first pose, and where it was
    /// found to be.
    fn tracked(
        method: FeatureMethod,
        pose: impl Fn(f64) -> Se3,
        count: usize,
    ) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let mut odometry = FeatureOdometry::new(method);
        let mut first = None;
        let mut track = |index: usize| {
            let stamp = index as f64 * PERIOD;
            let returns = sweep(&HALL, &pose, stamp);
            let scan = Scan {
                stamp,
                points: returns.iter().map(|r| r.point).collect(),
                times: returns.iter().map(|r| r.time).collect(),
                rings: returns.iter().map(|r| u16::from(r.ring)).collect(),
                ..Scan::default()
            };
            let found = odometry.track(&scan).expect("the scan has rings");
            let truth = pose(found.instant);
            let origin = *first.get_or_insert(truth);
            ((origin.inverse() * truth).translation, found.world_from_sensor.translation)
        };
        (0..count).map(&mut track).collect()
    }

    /// Where a sweep's begin is held at the end of the one before, A-LOAM errs by 6 cm here, all of it in height.
    #[test]
    fn both_methods_keep_to_the_ground_and_to_the_path() {
        let (pose, _) = walk(&[[-11.0, 4.5], [2.0, 4.5], [4.0, 6.5]]);
        for method in [FeatureMethod::Floam, FeatureMethod::ALoam] {
            for (index, (truth, found)) in tracked(method, &pose, 45).into_iter().enumerate() {
                let error = found - truth;
                assert!(error.norm() < 0.04, "{method:?} {index}: {:.3?}", error.as_slice());
            }
        }
    }

    /// 13 m/s, farther between two sweeps than features reach: A-LOAM fell behind by a metre a sweep.
    #[test]
    fn a_recording_may_begin_in_a_car_at_full_speed() {
        let pose = |time: f64| Se3::new(Default::default(), Vector3::new(13.0 * time - 15.0, 4.5, 0.0));
        for method in [FeatureMethod::Floam, FeatureMethod::ALoam] {
            for (index, (truth, found)) in tracked(method, pose, 16).into_iter().enumerate() {
                let error = found - truth;
                assert!(error.norm() < 0.1, "{method:?} {index}: {:.3?}", error.as_slice());
            }
        }
    }
}
