//! One step of the odometries on features: what a feature is compared with, and the minimum of Eq. 4.

use crate::features::Feature;
use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::registration::{Normal, plane_row};
use geometry::Se3;
use nalgebra::{Matrix6, Vector6};

/// Rounds of matching.
pub(crate) const ROUNDS: usize = 2;
/// Gauss–Newton steps of a round.
pub(crate) const STEPS: usize = 4;
/// Width of Huber's kernel, metres.
const HUBER: f64 = 0.1;

/// What a feature is compared with: a point on it and the directions in which it may not leave it.
pub(crate) struct Target {
    /// The feature's point of the sweep, by index.
    pub feature: u32,
    /// A point on what it is compared with, in the world.
    pub point: [f32; 3],
    /// Unit directions, of which `count` are used.
    pub normals: [[f32; 3]; 2],
    /// 1 for a plane, 2 for a line.
    pub count: usize,
    /// Weight of Eq. 4.
    pub weight: f64,
}

/// Where a feature is in the world, by the motion of its sweep.
pub(crate) fn place(sweep: &Sweep, feature: &Feature, table: &MotionTable) -> [f32; 3] {
    table.transform(sweep.points[feature.point as usize], sweep.shares[feature.point as usize])
}

/// How features fit the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// Information of the pose, tangent (υ, ω).
    pub information: Matrix6<f64>,
    /// Root mean square distance, metres.
    pub rmse: f64,
    /// Features that are matched.
    pub matched: usize,
    /// Gauss–Newton steps.
    pub steps: usize,
}

impl Default for Fit {
    /// That of the first sweep, which makes the map.
    fn default() -> Self {
        Self { information: Matrix6::identity() * 1e6, rmse: 0.0, matched: 0, steps: 0 }
    }
}

/// What a distance errs by, metres: with it the normal equations become information.
const DEVIATION: f64 = 0.03;

/// One Gauss–Newton step of Eq. 4: the change of the pose of a rigid sweep, or of the sweep's end while its begin is held;
/// and how the features fit before the step.
pub(crate) fn step(
    sweep: &Sweep,
    targets: &[Target],
    motion: &SweepMotion,
    rigid: bool,
) -> Option<(Vector6<f64>, Fit)> {
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
