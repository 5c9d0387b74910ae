//! A sweep registered against the local map: both ends of its motion are found at once.
//!
//! A point seen at the share s of the sweep moves with `(1 − s) δ_begin + s δ_end`, so its row of the Jacobian is the
//! rigid one, weighted. Three sums of the rigid normal equations (weighted with 1, s and s²) hold all there is, and
//! the system of twelve unknowns costs little more than one of six (the two poses of CT-ICP, Dellenbach 2022, on
//! planes of voxels). Sweeps without times of points have one pose: then only the first of the sums is used.

use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::surfaces::{Surface, SurfaceMap};
use geometry::Se3;
use nalgebra::{Matrix6, SMatrix, SVector, Vector3, Vector6};
use serde::{Deserialize, Serialize};

type Matrix12 = SMatrix<f64, 12, 12>;
type Vector12 = SVector<f64, 12>;

/// How a sweep is registered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegistrationParams {
    /// Most Gauss–Newton steps, ≥ 1.
    pub most_steps: usize,
    /// Steps end when none moves the sweep by more than this, metres and (a tenth of it) radians.
    pub least_step: f64,
    /// Width of the robust kernel (Geman–McClure), standard deviations of a point's distance from its plane.
    pub kernel: f64,
    /// How far the begin of a sweep may lie from the end of the one before where nothing is accelerated, standard deviation in metres and
    /// radians.
    pub continuity: (f64, f64),
    /// Accelerations to expect, standard deviation in m/s² and rad/s²: half of gravity, and the 500°/s² of quick turns of a robot or a hand.
    pub acceleration: (f64, f64),
    /// Points of a scan err together (calibration, surfaces that are not flat), so many of them count as one.
    pub correlation: f64,
}

impl Default for RegistrationParams {
    fn default() -> Self {
        Self {
            most_steps: 20,
            least_step: 5e-4,
            kernel: 3.0,
            continuity: (0.01, 0.002),
            acceleration: (5.0, 9.0),
            correlation: 10.0,
        }
    }
}

/// What is known of a sweep's motion before its points are looked at.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// The motion that is expected.
    pub motion: SweepMotion,
    /// Standard deviations of its begin, metres and radians.
    pub begin: (f64, f64),
    /// Standard deviations of its displacement, metres and radians.
    pub displacement: (f64, f64),
}

/// A sweep's motion with its evidence.
#[derive(Clone, Copy, Debug)]
pub struct Registration {
    /// The motion found.
    pub motion: SweepMotion,
    /// Information of the points on the pose in the middle of the sweep, tangent (υ, ω) at the sensor in the axes of
    /// the world; without the prediction's.
    pub information: Matrix6<f64>,
    /// Share of the points that lie on a plane of the map within the kernel.
    pub inlier_share: f64,
    /// Share of the points that lie where the map has something to compare them with.
    pub known_share: f64,
    /// Share of the points that agree, each counted by its weight in the kernel.
    pub support: f64,
    /// Root mean square of the inliers' distances from their planes, metres.
    pub rmse: f64,
    /// Steps taken.
    pub steps: usize,
}

impl Registration {
    /// A motion of which nothing is known.
    pub(crate) fn unknown(motion: SweepMotion) -> Self {
        Self {
            motion,
            information: Matrix6::zeros(),
            inlier_share: 0.0,
            known_share: 0.0,
            support: 0.0,
            rmse: 0.0,
            steps: 0,
        }
    }

    /// Of the points that lie where something is mapped, the share that agrees: what is not mapped yet contradicts nothing.
    pub fn agreement(&self) -> f64 {
        self.inlier_share / self.known_share.max(f64::MIN_POSITIVE)
    }

    /// The same, each counted by its weight in the kernel.
    pub fn supported(&self) -> f64 {
        self.support / self.known_share.max(f64::MIN_POSITIVE)
    }
}

/// Sums of the rigid normal equations with weights 1, s and s².
#[derive(Clone, Copy)]
pub(crate) struct Normal {
    h: [[f64; 21]; 3],
    pub g: [[f64; 6]; 2],
    inliers: f64,
    squared: f64,
    support: f64,
    known: f64,
}

impl Normal {
    pub const ZERO: Self =
        Self { h: [[0.0; 21]; 3], g: [[0.0; 6]; 2], inliers: 0.0, squared: 0.0, support: 0.0, known: 0.0 };

    /// A residual, its rigid Jacobian row, its weight and its share of the sweep.
    #[inline]
    pub fn add(&mut self, residual: f64, row: [f64; 6], weight: f64, share: f64) {
        let weights = [weight, weight * share, weight * share * share];
        let mut k = 0;
        for i in 0..6 {
            for j in i..6 {
                let product = row[i] * row[j];
                self.h[0][k] += weights[0] * product;
                self.h[1][k] += weights[1] * product;
                self.h[2][k] += weights[2] * product;
                k += 1;
            }
            self.g[0][i] += weights[0] * row[i] * residual;
            self.g[1][i] += weights[1] * row[i] * residual;
        }
    }

    /// The sum with the weight `s^power`.
    pub fn block(&self, power: usize) -> Matrix6<f64> {
        let mut matrix = Matrix6::zeros();
        let mut k = 0;
        for i in 0..6 {
            for j in i..6 {
                matrix[(i, j)] = self.h[power][k];
                matrix[(j, i)] = self.h[power][k];
                k += 1;
            }
        }
        matrix
    }
}

/// Row of the Jacobian of `normal · x` for a rigid left increment `(υ, ω)` about `centre`: `(n, (x − c) × n)`.
#[inline]
pub(crate) fn plane_row(point: [f64; 3], centre: [f64; 3], normal: [f64; 3]) -> [f64; 6] {
    let [x, y, z] = [point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]];
    let [a, b, c] = normal;
    [a, b, c, y * c - z * b, z * a - x * c, x * b - y * a]
}

/// An increment `(υ, ω)` about `centre`, applied from the left.
pub(crate) fn moved(pose: &Se3, centre: &Vector3<f64>, increment: &Vector6<f64>) -> Se3 {
    let local = Se3::new(pose.rotation, pose.translation - centre);
    let moved = Se3::exp(increment) * local;
    Se3::new(moved.rotation, moved.translation + centre).renormalized()
}

/// The increment about `centre` that takes `from` to `to`.
fn difference(to: &Se3, from: &Se3, centre: &Vector3<f64>) -> Vector6<f64> {
    let local = |pose: &Se3| Se3::new(pose.rotation, pose.translation - centre);
    (local(to) * local(from).inverse()).log()
}

/// Points that are used, by index into the sweep.
pub(crate) fn register(
    sweep: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    prediction: &Prediction,
    params: &RegistrationParams,
) -> Registration {
    register_by(sweep, used, map, prediction, params, Asked::All)
}

/// Of which axes of lines and scatters it is asked where along them a point lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Asked {
    /// All that have a variance.
    All,
    /// Those along which the voxel does not cut the points off.
    Uncut,
}

/// As [`register`], by the axes that are asked.
pub(crate) fn register_by(
    sweep: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    prediction: &Prediction,
    params: &RegistrationParams,
    asked: Asked,
) -> Registration {
    let mut motion = prediction.motion;
    let count = used.len().max(1) as f64;
    let mut result = Registration::unknown(motion);
    // The kernel begins as wide as the prediction may err, and narrows step by step.
    let mut widening = 8.0;
    for step in 1..=params.most_steps {
        let centre = motion.middle().translation;
        let normal = linearise(sweep, used, map, &motion, &centre, (params.kernel * widening, asked));
        let last_kernel = widening == 1.0;
        let delta = solve(&normal, &motion, prediction, &centre, sweep.is_timed(), params);
        let (begin, end) = (delta.fixed_rows::<6>(0).into_owned(), delta.fixed_rows::<6>(6).into_owned());
        motion = SweepMotion {
            begin: moved(&motion.begin, &centre, &begin),
            end: moved(&motion.end, &centre, &end),
        };
        result = Registration {
            motion,
            information: normal.block(0) / params.correlation,
            inlier_share: normal.inliers / count,
            known_share: normal.known / count,
            support: normal.support / count,
            rmse: (normal.squared / normal.inliers.max(1.0)).sqrt(),
            steps: step,
        };
        let size = [begin, end].map(|d| d.fixed_rows::<3>(0).norm().max(10.0 * d.fixed_rows::<3>(3).norm()));
        if last_kernel && size[0].max(size[1]) < params.least_step {
            break;
        }
        widening = (widening * 0.5).max(1.0);
    }
    result
}

/// Share of the points that agree with the map under a motion, each counted by its weight in the kernel.
pub(crate) fn agreement(
    sweep: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    motion: &SweepMotion,
    kernel: f64,
) -> f64 {
    linearise(sweep, used, map, motion, &Vector3::zeros(), (kernel, Asked::All)).support
        / used.len().max(1) as f64
}

/// How far a point lies from what its voxel knows, in variances.
#[inline]
fn squared_distance(surface: &Surface, point: [f32; 3]) -> f64 {
    let offset = [0, 1, 2].map(|k| point[k] - surface.mean[k]);
    let mut squared = 0.0;
    for k in 0..3 {
        if surface.variances[k] > 0.0 {
            let n = surface.axes[k];
            let along = f64::from(n[0] * offset[0] + n[1] * offset[1] + n[2] * offset[2]);
            squared += along.powi(2) / f64::from(surface.variances[k]);
        }
    }
    squared
}

/// Geman and McClure's weight of a squared distance in variances.
#[inline]
fn robust_weight(squared: f64, kernel: f64) -> f64 {
    let bound = kernel * kernel;
    (bound / (bound + squared)).powi(2)
}

/// What normals that lean by chance claim of the pose in the middle of a sweep: on average the information of points on planes is larger by
/// it than that of the true normals, since E[n nᵀ] is the true normal's plus the covariance of its error (errors in variables; Fuller,
/// "Measurement Error Models", 1987, 1.2).
pub(crate) fn false_information(
    sweep: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    motion: &SweepMotion,
    params: &RegistrationParams,
    asked: Asked,
) -> Matrix6<f64> {
    let table = MotionTable::new(motion, &Se3::identity());
    let centre = motion.middle().translation;
    let centre = [centre.x, centre.y, centre.z];
    let mut sum = Normal::ZERO;
    for &i in used {
        let world = table.transform(sweep.points[i as usize], sweep.shares[i as usize]);
        let Some(surface) = map.surface_at(world) else { continue };
        let robust = robust_weight(squared_distance(surface, world), params.kernel);
        let mut add = |axis: usize, variance: f32| {
            let row = plane_row(world.map(f64::from), centre, surface.axes[axis].map(f64::from));
            sum.add(0.0, row, robust / f64::from(variance), 0.0);
        };
        for k in (0..2).filter(|&k| surface.slopes[k] > 0.0) {
            add(k + 1, surface.variances[0] / surface.slopes[k]);
        }
        if asked == Asked::All {
            (0..3)
                .filter(|&k| surface.cut[k] && surface.variances[k] > 0.0)
                .for_each(|k| add(k, surface.variances[k]));
        }
    }
    sum.block(0) / params.correlation
}

fn linearise(
    sweep: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    motion: &SweepMotion,
    centre: &Vector3<f64>,
    (kernel, asked): (f64, Asked),
) -> Normal {
    let table = MotionTable::new(motion, &Se3::identity());
    let centre = [centre.x, centre.y, centre.z];
    let mut normal = Normal::ZERO;
    for &i in used {
        let (point, share) = (sweep.points[i as usize], sweep.shares[i as usize]);
        let world = table.transform(point, share);
        let Some(surface) = map.surface_at(world) else { continue };
        normal.known += 1.0;
        let offset = [0, 1, 2].map(|k| world[k] - surface.mean[k]);
        let along = |n: [f32; 3]| f64::from(n[0] * offset[0] + n[1] * offset[1] + n[2] * offset[2]);
        let squared = squared_distance(surface, world);
        let bound = kernel * kernel;
        if squared < bound {
            normal.inliers += 1.0;
            normal.squared += along(surface.axes[0]).powi(2);
        }
        let robust = robust_weight(squared, kernel);
        normal.support += robust;
        for k in 0..3 {
            if surface.variances[k] > 0.0 && (asked == Asked::All || !surface.cut[k]) {
                let n = surface.axes[k];
                let row = plane_row(world.map(f64::from), centre, n.map(f64::from));
                normal.add(along(n), row, robust / f64::from(surface.variances[k]), f64::from(share));
            }
        }
    }
    normal
}

/// Points and prediction in one system.
fn solve(
    normal: &Normal,
    motion: &SweepMotion,
    prediction: &Prediction,
    centre: &Vector3<f64>,
    timed: bool,
    params: &RegistrationParams,
) -> Vector12 {
    let (h0, h1, h2) = (normal.block(0), normal.block(1), normal.block(2));
    let (g0, g1) = (Vector6::from(normal.g[0]), Vector6::from(normal.g[1]));
    let mut h = Matrix12::zeros();
    let mut g = Vector12::zeros();
    h.fixed_view_mut::<6, 6>(0, 0).copy_from(&(h0 - h1 * 2.0 + h2));
    h.fixed_view_mut::<6, 6>(0, 6).copy_from(&(h1 - h2));
    h.fixed_view_mut::<6, 6>(6, 0).copy_from(&(h1 - h2));
    h.fixed_view_mut::<6, 6>(6, 6).copy_from(&h2);
    g.fixed_rows_mut::<6>(0).copy_from(&(g0 - g1));
    g.fixed_rows_mut::<6>(6).copy_from(&g1);
    h /= params.correlation;
    g /= params.correlation;

    let precision = |(translation, rotation): (f64, f64)| {
        let (t, r) = (translation.powi(-2), rotation.powi(-2));
        Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r))
    };
    let begin = precision(prediction.begin);
    let begin_error = difference(&motion.begin, &prediction.motion.begin, centre);
    // Untimed sweeps have one pose: their ends are tied together.
    let displacement = if timed { precision(prediction.displacement) } else { precision((1e-6, 1e-6)) };
    let expected_end = if timed { motion.begin * prediction.motion.displacement() } else { motion.begin };
    let end_error = difference(&motion.end, &expected_end, centre);
    let mut add = |row: usize, column: usize, block: Matrix6<f64>| {
        let mut view = h.fixed_view_mut::<6, 6>(row, column);
        view += block;
    };
    add(0, 0, begin + displacement);
    add(0, 6, -displacement);
    add(6, 0, -displacement);
    add(6, 6, displacement);
    let mut first = g.fixed_rows_mut::<6>(0);
    first += begin * begin_error - displacement * end_error;
    let mut last = g.fixed_rows_mut::<6>(6);
    last += displacement * end_error;
    // With a prediction the system is positive definite; should rounding say otherwise, the prediction stands.
    h.cholesky().map_or_else(Vector12::zeros, |factor| -factor.solve(&g))
}

#[cfg(test)]
mod tests;
