//! How well matches fit a pose, whatever the depths: the epipolar error and its refinement.
//!
//! The error of a match is Sampson's, on the sphere: `f_tᵀ E f_s` over its standard deviation for rays with unit
//! noise in both directions across them. To first order it is the angle by which the two rays must turn together to
//! meet, in radians.

use super::least_squares::{Problem, Sink};
use super::linear::Pose;
use super::rays::{BLOCK, Rays, tangent_basis};
use geometry::median;
use nalgebra::{Matrix3, Matrix3x2, Rotation3, SMatrix, SVector, Vector1, Vector2, Vector3};

/// Keeps the error of a ray through the epipole finite, squared radians.
const EPIPOLE: f64 = 1e-14;

/// Squared error of one pair of rays, squared radians.
pub(super) fn squared_error(essential: &Matrix3<f64>, source: &Vector3<f64>, target: &Vector3<f64>) -> f64 {
    let line = essential * source;
    let error = target.dot(&line);
    error * error / (line.norm_squared() + essential.tr_mul(target).norm_squared() + EPIPOLE)
}

/// Squared errors of a block of matches, and their sum where none counts more than `limit`.
fn block_cost(rays: &Rays, e: &Matrix3<f64>, block: usize, limit: f64) -> f64 {
    let range = block..block + BLOCK;
    let (s, t) = (&rays.source_lanes, &rays.target_lanes);
    let (sx, sy, sz) = (&s.x[range.clone()], &s.y[range.clone()], &s.z[range.clone()]);
    let (tx, ty, tz) = (&t.x[range.clone()], &t.y[range.clone()], &t.z[range]);
    let mut costs = [0.0; BLOCK];
    for i in 0..BLOCK {
        let lx = e.m11 * sx[i] + e.m12 * sy[i] + e.m13 * sz[i];
        let ly = e.m21 * sx[i] + e.m22 * sy[i] + e.m23 * sz[i];
        let lz = e.m31 * sx[i] + e.m32 * sy[i] + e.m33 * sz[i];
        let kx = e.m11 * tx[i] + e.m21 * ty[i] + e.m31 * tz[i];
        let ky = e.m12 * tx[i] + e.m22 * ty[i] + e.m32 * tz[i];
        let kz = e.m13 * tx[i] + e.m23 * ty[i] + e.m33 * tz[i];
        let error = tx[i] * lx + ty[i] * ly + tz[i] * lz;
        let noise = lx * lx + ly * ly + lz * lz + kx * kx + ky * ky + kz * kz + EPIPOLE;
        costs[i] = (error * error / noise).min(limit);
    }
    costs.iter().sum()
}

/// The cost of a hypothesis: the sum of squared errors, none counted more than `limit` (Torr & Zisserman's MSAC).
/// Nothing once it exceeds `best`.
pub(super) fn cost(rays: &Rays, essential: &Matrix3<f64>, limit: f64, best: f64) -> Option<f64> {
    let mut sum = 0.0;
    for block in (0..rays.source_lanes.x.len()).step_by(BLOCK) {
        sum += block_cost(rays, essential, block, limit);
        // Also stops at a NaN.
        let can_win = sum < best;
        if !can_win {
            return None;
        }
    }
    Some(sum)
}

/// The matches whose squared error is below `limit`.
pub(super) fn inliers(rays: &Rays, pose: &Pose, limit: f64) -> Vec<usize> {
    let essential = pose.essential();
    let fits = |&i: &usize| squared_error(&essential, &rays.source[i], &rays.target[i]) < limit;
    (0..rays.len()).filter(fits).collect()
}

/// Whether the two rays of a match can meet in front of both cameras; `slack` is the angle, radians, that the rays
/// may be wrong by. A point too far away for its sign to be seen passes.
pub(super) fn in_front(rays: &Rays, pose: &Pose, index: usize, slack: f64) -> bool {
    let source = pose.rotation * rays.source[index];
    let target = rays.target[index];
    let (along_source, along_target) = (source.dot(&pose.direction), target.dot(&pose.direction));
    let cosine = source.dot(&target);
    // The depths of the nearest points of both rays, times the squared sine of their angle.
    let (depth_source, depth_target) =
        (cosine * along_target - along_source, along_target - cosine * along_source);
    depth_source > -slack && depth_target > -slack
}

/// How many matches outside `inliers` would look like inliers by chance, per match: the share of wrong pairs, made
/// by shifting the target's rays against the source's, that the pose accepts.
pub(super) fn chance_share(rays: &Rays, pose: &Pose, limit: f64) -> f64 {
    const SHIFTS: usize = 16;
    let essential = pose.essential();
    let count = rays.len();
    let (mut accepted, mut tested) = (0, 0);
    for shift in 1..=SHIFTS.min(count.saturating_sub(1)) {
        let shift = shift * count / (SHIFTS + 1).min(count);
        for i in 0..count {
            let other = (i + shift) % count;
            accepted += usize::from(squared_error(&essential, &rays.source[i], &rays.target[other]) < limit);
            tested += 1;
        }
    }
    // Never nothing: what was not seen in n tries may be as likely as 1/n.
    (accepted + 1) as f64 / (tested + 1) as f64
}

/// The pose that fits some matches best.
pub(super) struct EpipolarFit<'a> {
    pub(super) rays: &'a Rays,
    pub(super) matches: &'a [usize],
}

/// The error of a match, radians, with its derivatives by a turn of the source's rays (on the left of R) and by
/// t̂ (three entries, of which only those across t̂ mean anything).
pub(super) fn linearise(
    rays: &Rays,
    index: usize,
    rotation: &Matrix3<f64>,
    direction: &Vector3<f64>,
) -> (f64, Vector3<f64>, Vector3<f64>) {
    let source = rotation * rays.source[index];
    let target = rays.target[index];
    let normal = source.cross(&target);
    let (along_source, along_target) = (direction.dot(&source), direction.dot(&target));
    let noise = (2.0 - along_source.powi(2) - along_target.powi(2)).max(EPIPOLE).sqrt();
    let residual = direction.dot(&normal) / noise;
    let by_noise = residual / (noise * noise);
    let by_rotation =
        source.cross(&target.cross(direction)) / noise + source.cross(direction) * (by_noise * along_source);
    let by_direction = normal / noise + (source * along_source + target * along_target) * by_noise;
    (residual, by_rotation, by_direction)
}

impl Problem<5> for EpipolarFit<'_> {
    type State = Pose;

    fn residuals(&self, state: &Pose, sink: &mut impl Sink<5>) {
        let basis = tangent_basis(&state.direction);
        for &index in self.matches {
            let (residual, by_rotation, by_direction) =
                linearise(self.rays, index, &state.rotation, &state.direction);
            let across = basis.tr_mul(&by_direction);
            let jacobian =
                SMatrix::<f64, 1, 5>::new(by_rotation.x, by_rotation.y, by_rotation.z, across.x, across.y);
            sink.add(Vector1::new(residual), jacobian);
        }
    }

    fn step(&self, state: &Pose, by: &SVector<f64, 5>) -> Pose {
        Pose {
            rotation: turned(&state.rotation, &by.fixed_rows::<3>(0).into_owned()),
            direction: moved(&state.direction, &by.fixed_rows::<2>(3).into_owned()),
        }
    }
}

/// `exp(rotation_step) R`.
pub(super) fn turned(rotation: &Matrix3<f64>, rotation_step: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::new(*rotation_step).into_inner() * rotation
}

/// A unit vector after a step in its [`tangent_basis`].
pub(super) fn moved(direction: &Vector3<f64>, by: &Vector2<f64>) -> Vector3<f64> {
    let basis: Matrix3x2<f64> = tangent_basis(direction);
    (direction + basis * by).normalize()
}

/// Standard deviation of the errors of some matches, radians, by their median: sound with up to half of them wrong.
pub(super) fn deviation(rays: &Rays, pose: &Pose, matches: &[usize]) -> f64 {
    let error = |&i: &usize| linearise(rays, i, &pose.rotation, &pose.direction).0.abs();
    let mut errors: Vec<f64> = matches.iter().map(error).collect();
    let Some(median) = median(&mut errors) else { return 0.0 };
    // The fit has taken five unknowns out of the errors.
    let freedom = matches.len() as f64 / matches.len().saturating_sub(5).max(1) as f64;
    1.4826 * median * freedom.sqrt()
}
