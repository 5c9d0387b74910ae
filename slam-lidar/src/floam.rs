//! The paper's odometry (Eq. 1–4), `floam`, and A-LOAM's, `a-loam`, to compare with.
//!
//! FLOAM: features freed from the predicted motion (stage one) are matched with the map of edges and planes, the pose
//! is the minimum of Eq. 4, and the features enter the map freed from the motion that was found (stage two). The
//! public FLOAM has neither stage; both are built here from the text. A-LOAM: features are first matched with those of
//! the last sweep, the distortion inside the iterations, and then with the map.
//!
//! What the paper leaves open: the weights of Eq. 4 are exponentials of the smoothness with mean 1; a robust kernel
//! (Huber, 0.1 m) and the tests of lines and planes are those of the public code.

use crate::degeneracy::conditioning;
use crate::features::{Feature, Features, features};
use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::odometry::TrackedSweep;
use crate::point_grid::PointGrid;
use crate::registration::{Normal, moved, plane_row};
use crate::surfaces::sorted_eigen;
use geometry::Se3;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
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
/// Rounds of matching; at the start, when the motion is not known yet, more.
const ROUNDS: usize = 2;
/// Rounds at the start.
const STARTING_ROUNDS: usize = 12;
/// Gauss–Newton steps of a round.
const STEPS: usize = 4;
/// Width of Huber's kernel, metres.
const HUBER: f64 = 0.1;
/// Range of points used, metres.
const RANGE: (f32, f32) = (0.5, 100.0);

/// What a feature is compared with: a point on it and the directions in which it may not leave it.
struct Target {
    feature: u32,
    point: [f32; 3],
    normals: [[f32; 3]; 2],
    count: usize,
    weight: f64,
}

/// An odometry on features of scans.
#[derive(Clone, Debug)]
pub struct FeatureOdometry {
    method: FeatureMethod,
    edges: PointGrid,
    planes: PointGrid,
    last: Option<Last>,
    swept: usize,
}

#[derive(Clone, Debug)]
struct Last {
    motion: SweepMotion,
    /// Features of the last sweep in its frame at the end.
    edges: PointGrid,
    planes: PointGrid,
}

impl FeatureOdometry {
    /// Tracking with an empty map.
    pub fn new(method: FeatureMethod) -> Self {
        let (edges, planes) = (PointGrid::new(LEAVES.0), PointGrid::new(LEAVES.1));
        Self { method, edges, planes, last: None, swept: 0 }
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
        let (motion, fit) = match self.last.take() {
            None => (SweepMotion::resting(Se3::identity()), Fit::default()),
            Some(last) => self.locate(&sweep, &found, &last),
        };
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
        })
    }

    fn locate(&self, sweep: &Sweep, found: &Features, last: &Last) -> (SweepMotion, Fit) {
        // Stage one (Eq. 2): the sensor keeps its motion.
        let begin = last.motion.end;
        let mut motion = SweepMotion { begin, end: begin * last.motion.displacement() };
        if self.method == FeatureMethod::ALoam {
            motion = scan_to_scan(sweep, found, last, motion);
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
        let (mut edges, mut planes) = (PointGrid::new(0.0), PointGrid::new(0.0));
        if self.method == FeatureMethod::ALoam {
            let at_end = MotionTable::new(&motion, &motion.end.inverse());
            let ring = |f: &Feature| sweep.rings[f.point as usize];
            found.edges.iter().for_each(|f| edges.insert(place(sweep, f, &at_end), ring(f)));
            found.planes.iter().for_each(|f| planes.insert(place(sweep, f, &at_end), ring(f)));
        }
        self.last = Some(Last { motion, edges, planes });
    }
}

/// A scan that does not say on which ring its points lie, and is not stored ring by ring.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the scan has no rings, on which features by smoothness are defined; use the default method")]
pub struct NoRings;

fn place(sweep: &Sweep, feature: &Feature, table: &MotionTable) -> [f32; 3] {
    table.transform(sweep.points[feature.point as usize], sweep.shares[feature.point as usize])
}

/// Weights of Eq. 4: `exp(± α)`, relative to their mean.
fn weights(features: &[Feature], sign: f64) -> impl Iterator<Item = f64> {
    let raw = move |f: &Feature| (sign * f64::from(f.smoothness)).exp();
    let mean = features.iter().map(raw).sum::<f64>() / features.len().max(1) as f64;
    features.iter().map(move |f| raw(f) / mean)
}

/// A-LOAM's first step: against the last sweep, the motion within the sweep in question all the time.
fn scan_to_scan(sweep: &Sweep, found: &Features, last: &Last, predicted: SweepMotion) -> SweepMotion {
    let mut motion = predicted;
    let to_last = last.motion.end.inverse();
    for _ in 0..ROUNDS {
        let table = MotionTable::new(&motion, &to_last);
        let back = MotionTable::new(&SweepMotion::resting(last.motion.end), &Se3::identity());
        let world = |p: [f32; 3]| back.transform(p, 0.0);
        let turn = |n: [f32; 3]| [0, 1, 2].map(|i| world(n)[i] - world([0.0; 3])[i]);
        let target = |f: &Feature, local: Option<([f32; 3], [[f32; 3]; 2], usize)>| {
            local.map(|(point, normals, count)| Target {
                feature: f.point,
                point: world(point),
                normals: normals.map(turn),
                count,
                weight: 1.0,
            })
        };
        let edges = found
            .edges
            .iter()
            .filter_map(|f| target(f, across_rings(&last.edges, place(sweep, f, &table), false)));
        let planes = found
            .planes
            .iter()
            .filter_map(|f| target(f, across_rings(&last.planes, place(sweep, f, &table), true)));
        let targets: Vec<Target> = edges.chain(planes).collect();
        for _ in 0..STEPS {
            let Some((delta, _)) = step(sweep, &targets, &motion, false) else { break };
            motion.end = moved(&motion.end, &motion.middle().translation, &delta);
        }
    }
    motion
}

type Local = ([f32; 3], [[f32; 3]; 2], usize);

/// The line through the two nearest points of different rings, or the plane through a third of the first's ring.
fn across_rings(grid: &PointGrid, query: [f32; 3], plane: bool) -> Option<Local> {
    let mut nearest: Option<([f32; 3], u16, f32)> = None;
    grid.around(query, |p, ring, d| {
        if d < 1.0 && nearest.is_none_or(|(_, _, least)| d < least) {
            nearest = Some((p, ring, d));
        }
    });
    let (a, ring, _) = nearest?;
    let (mut other, mut same) = (None::<([f32; 3], f32)>, None::<([f32; 3], f32)>);
    grid.around(query, |p, r, d| {
        let slot = if r == ring { &mut same } else { &mut other };
        if p != a && d < 4.0 && r.abs_diff(ring) <= 2 && slot.is_none_or(|(_, least)| d < least) {
            *slot = Some((p, d));
        }
    });
    let v = |p: [f32; 3]| Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]));
    let f = |n: Vector3<f64>| [n.x as f32, n.y as f32, n.z as f32];
    let along = (v(other?.0) - v(a)).try_normalize(1e-3)?;
    if plane {
        let normal = along.cross(&(v(same?.0) - v(a))).try_normalize(1e-3)?;
        return Some((a, [f(normal); 2], 1));
    }
    let first = along
        .cross(&(v(query) - v(a)))
        .try_normalize(1e-9)
        .or_else(|| along.cross(&Vector3::x()).try_normalize(1e-3))?;
    Some((a, [f(first), f(along.cross(&first))], 2))
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

/// How features fit the map.
#[derive(Clone, Copy, Debug)]
struct Fit {
    information: Matrix6<f64>,
    /// Root mean square distance, metres.
    rmse: f64,
    matched: usize,
    steps: usize,
}

impl Default for Fit {
    /// That of the first sweep, which makes the map.
    fn default() -> Self {
        Self { information: Matrix6::identity() * 1e6, rmse: 0.0, matched: 0, steps: 0 }
    }
}

/// What a distance errs by, metres: with it the normal equations become information.
const DEVIATION: f64 = 0.03;

/// One Gauss–Newton step of Eq. 4 for a rigid sweep, or for its end with the begin held, and how features fit before
/// it.
fn step(sweep: &Sweep, targets: &[Target], motion: &SweepMotion, rigid: bool) -> Option<(Vector6<f64>, Fit)> {
    let table = MotionTable::new(motion, &Se3::identity());
    let centre = motion.middle().translation;
    let centre = [centre.x, centre.y, centre.z];
    let mut normal = Normal::ZERO;
    let mut squared = 0.0;
    for target in targets {
        let (point, share) = (sweep.points[target.feature as usize], sweep.shares[target.feature as usize]);
        let world = table.transform(point, share);
        let residual =
            |n: [f32; 3]| (0..3).map(|i| f64::from(n[i] * (world[i] - target.point[i]))).sum::<f64>();
        let normals = &target.normals[..target.count];
        let distance = normals.iter().map(|&n| residual(n).powi(2)).sum::<f64>().sqrt();
        squared += distance * distance;
        let weight = target.weight * if distance > HUBER { HUBER / distance } else { 1.0 };
        for &n in normals {
            normal.add(
                residual(n),
                plane_row(world.map(f64::from), centre, n.map(f64::from)),
                weight,
                f64::from(share),
            );
        }
    }
    let (h, g) = if rigid { (normal.block(0), normal.g[0]) } else { (normal.block(2), normal.g[1]) };
    let damped = h + Matrix6::identity() * 1e-6;
    let rmse = (squared / targets.len().max(1) as f64).sqrt();
    let fit = Fit { information: h / (DEVIATION * DEVIATION), rmse, matched: targets.len(), steps: 1 };
    Some((-damped.cholesky()?.solve(&Vector6::from(g)), fit))
}
