//! The similarity over all matches that agree.

use super::error::{both_directions, projected};
use super::{GeneralisedPoseParams, Pool, find_inliers};
use crate::estimate::Estimate;
use crate::point_alignment::left_jacobian;
use geometry::Sim3;
use nalgebra::{Matrix2, RowVector3, SMatrix, SVector};

/// Steps; it converges quadratically, and inliers settle in a few.
const STEPS: usize = 12;

/// Refines `start`, target_from_source, over the matches that agree with it, chosen anew at every step. `None` where
/// they leave a degree of freedom open.
pub(super) fn refine(
    pool: &Pool,
    start: Sim3,
    params: &GeneralisedPoseParams,
) -> Option<(Estimate, Vec<usize>)> {
    let mut motion = start;
    for _ in 0..STEPS {
        let system = System::build(pool, &motion, params);
        let step = system.hessian.cholesky()?.solve(&system.gradient);
        motion = Sim3::exp(&step) * motion;
        if !motion.is_valid() {
            return None;
        }
        if step.dot(&(system.hessian * step)) < 1e-8 {
            break;
        }
    }
    let system = System::build(pool, &motion, params);
    // Matches of one key point over several keyframes share its errors; residuals larger than expected widen all.
    let residual_scale = (system.error / (2 * system.count.max(1)) as f64).max(1.0);
    let information = (system.hessian + system.hessian.transpose()) * (0.5 / residual_scale);
    information.cholesky()?;
    Some((Estimate { a_from_b: motion, information }, system.inliers))
}

/// The normal equations at an estimate.
struct System {
    hessian: SMatrix<f64, 7, 7>,
    gradient: SVector<f64, 7>,
    inliers: Vec<usize>,
    /// Sum of the squared distances of what agrees, and how many these are.
    error: f64,
    count: usize,
}

impl System {
    fn build(pool: &Pool, motion: &Sim3, params: &GeneralisedPoseParams) -> Self {
        let motions = both_directions(motion);
        let mut system = Self {
            hessian: SMatrix::zeros(),
            gradient: SVector::zeros(),
            inliers: find_inliers(pool, motion, params),
            error: 0.0,
            count: 0,
        };
        for index in 0..system.inliers.len() {
            let m = &pool.matches[system.inliers[index]];
            for to in 0..2 {
                let (Some(point), Some(seen)) =
                    (m.sides[1 - to].point, projected(pool, m, to, &motions[to], params))
                else {
                    continue;
                };
                let view = &pool.views[to][m.sides[to].view].view_from_side;
                // exp(ε) moves points of the target's frame; points that go back to the source the other way.
                let by_tangent = match to {
                    1 => linear(view, &left_jacobian(&(motions[1] * point.position))),
                    _ => -linear(&(*view * motions[0]), &left_jacobian(&point.position)),
                };
                let rows = seen.rows.map(|row| RowVector3::new(row.x, row.y, row.z) * by_tangent);
                let jacobian = SMatrix::<f64, 2, 7>::from_rows(&rows);
                let covariance = Matrix2::identity() + seen.depth * seen.depth.transpose();
                let Some(information) = covariance.try_inverse() else { continue };
                let weighted = jacobian.transpose() * information;
                system.hessian += weighted * jacobian;
                system.gradient -= weighted * seen.error;
                system.error += seen.squared();
                system.count += 1;
            }
        }
        system
    }
}

/// The derivative of a point, moved on by a similarity.
fn linear(motion: &Sim3, jacobian: &SMatrix<f64, 3, 7>) -> SMatrix<f64, 3, 7> {
    motion.rotation.to_rotation_matrix().into_inner() * jacobian * motion.scale
}
