//! The motion of a sensor during a sweep, and scans freed from it (Eq. 2–3).

use geometry::Se3;
use scans::Scan;

/// A sweep's motion: the poses at its first and last instant; between them the sensor moves with a constant twist,
/// `T(s) = T_begin · exp(s · ξ)`, s the share of the sweep (Eq. 2 with ξ per sweep).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepMotion {
    /// `world_from_sensor` at the first instant.
    pub begin: Se3,
    /// `world_from_sensor` at the last instant.
    pub end: Se3,
}

impl SweepMotion {
    /// No motion.
    pub fn resting(world_from_sensor: Se3) -> Self {
        Self { begin: world_from_sensor, end: world_from_sensor }
    }

    /// `world_from_sensor` at a share of the sweep.
    pub fn at(&self, share: f64) -> Se3 {
        self.begin * Se3::exp(&((self.begin.inverse() * self.end).log() * share))
    }

    /// `world_from_sensor` in the middle: what the sweep determines best.
    pub fn middle(&self) -> Se3 {
        self.at(0.5)
    }

    /// Displacement during the sweep, `begin_from_end`.
    pub fn displacement(&self) -> Se3 {
        self.begin.inverse() * self.end
    }
}

/// Poses that are kept of a sweep's motion. Between them matrices are blended, which is wrong by an eighth of the
/// square of the angle between two: 2e-6 of the range at 500°/s.
const KNOTS: usize = 32;

/// A sweep's motion as matrices, ready for many points.
#[derive(Clone, Debug)]
pub struct MotionTable {
    /// Rows of `to_from_sensor` at each knot.
    knots: Vec<[f32; 12]>,
    rigid: bool,
}

impl MotionTable {
    /// The motion seen from `to`: points come out in the frame `to_from_world` maps to.
    pub fn new(motion: &SweepMotion, to_from_world: &Se3) -> Self {
        let (begin, twist) = (*to_from_world * motion.begin, motion.displacement().log());
        let rigid = twist.norm() == 0.0;
        let knot = |k: usize| {
            let pose = begin * Se3::exp(&(twist * (k as f64 / KNOTS as f64)));
            let (r, t) = (pose.rotation_matrix(), pose.translation);
            let mut rows = [0.0f32; 12];
            for row in 0..3 {
                for column in 0..3 {
                    rows[4 * row + column] = r[(row, column)] as f32;
                }
                rows[4 * row + 3] = t[row] as f32;
            }
            rows
        };
        Self { knots: (0..=if rigid { 1 } else { KNOTS }).map(knot).collect(), rigid }
    }

    /// A point seen at a share of the sweep, in the frame of the table.
    #[inline]
    pub fn transform(&self, point: [f32; 3], share: f32) -> [f32; 3] {
        let [x, y, z] = point;
        let apply = |m: &[f32; 12]| {
            [
                m[0] * x + m[1] * y + m[2] * z + m[3],
                m[4] * x + m[5] * y + m[6] * z + m[7],
                m[8] * x + m[9] * y + m[10] * z + m[11],
            ]
        };
        if self.rigid {
            return apply(&self.knots[0]);
        }
        let position = share.clamp(0.0, 1.0) * KNOTS as f32;
        let knot = (position as usize).min(KNOTS - 1);
        let fraction = position - knot as f32;
        let (a, b) = (apply(&self.knots[knot]), apply(&self.knots[knot + 1]));
        [a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1]), a[2] + fraction * (b[2] - a[2])]
    }
}

/// A scan whose points know at which share of the sweep they were seen.
#[derive(Clone, Debug, Default)]
pub struct Sweep {
    /// Points in the sensor's frame, each at its own instant.
    pub points: Vec<[f32; 3]>,
    /// Share of the sweep, 0–1, of each point; all ½ where times are not known.
    pub shares: Vec<f32>,
    /// Ring of each point; empty where rings are not known.
    pub rings: Vec<u16>,
    /// The instants of the first and the last point, seconds on the recording's clock.
    pub instants: (f64, f64),
}

impl Sweep {
    /// The points of a scan with `range` metres between the nearest and the farthest.
    pub fn of(scan: &Scan, range: (f32, f32)) -> Self {
        let (first, last) = scan.span();
        let duration = (last - first).max(f32::MIN_POSITIVE);
        let wanted = |p: &[f32; 3]| {
            let squared = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
            squared >= range.0 * range.0 && squared <= range.1 * range.1
        };
        let mut sweep = Self {
            points: Vec::with_capacity(scan.points.len()),
            shares: Vec::with_capacity(scan.points.len()),
            rings: Vec::with_capacity(scan.rings.len()),
            instants: (scan.stamp + f64::from(first), scan.stamp + f64::from(last)),
        };
        for (i, p) in scan.points.iter().enumerate().filter(|(_, p)| wanted(p)) {
            sweep.points.push(*p);
            sweep.shares.push(scan.times.get(i).map_or(0.5, |t| (t - first) / duration));
            sweep.rings.extend(scan.rings.get(i));
        }
        sweep
    }

    /// The instant in the middle of the sweep, to which poses belong, seconds on the recording's clock.
    pub fn middle(&self) -> f64 {
        0.5 * (self.instants.0 + self.instants.1)
    }

    /// Whether the points have times of their own.
    pub fn is_timed(&self) -> bool {
        self.instants.1 > self.instants.0
    }

    /// The points freed from the sensor's motion, in the frame of the table.
    pub fn undistorted(&self, table: &MotionTable) -> Vec<[f32; 3]> {
        self.points.iter().zip(&self.shares).map(|(&p, &s)| table.transform(p, s)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector3, Vector6};
    use proptest::prelude::*;

    proptest! {
        /// Points of a still world, seen from a moving sensor, fall back on each other.
        #[test]
        fn deskewed_points_lie_where_they_were(
            twist in prop::array::uniform6(-0.4f64..0.4), start in prop::array::uniform6(-2.0f64..2.0),
            point in prop::array::uniform3(-30.0f64..30.0), share in 0.0f64..1.0,
        ) {
            let begin = Se3::exp(&Vector6::from(start));
            let motion = SweepMotion { begin, end: begin * Se3::exp(&Vector6::from(twist)) };
            let world = Vector3::from(point);
            let seen = motion.at(share).inverse() * world;
            let table = MotionTable::new(&motion, &Se3::identity());
            let found = table.transform([seen.x as f32, seen.y as f32, seen.z as f32], share as f32);
            let error = (Vector3::new(found[0] as f64, found[1] as f64, found[2] as f64) - world).norm();
            prop_assert!(error < 1e-2 * twist.iter().map(|v| v * v).sum::<f64>() + 1e-4, "{}", error);
        }
    }
}
