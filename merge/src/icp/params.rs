//! How clouds are registered.

use super::RobustKernel;
use serde::{Deserialize, Serialize};

/// What a correspondence is measured by: Ω of [`covariance`](super::covariance).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ResidualKind {
    /// The distance of the points, Eq. 2 to the letter.
    PointToPoint,
    /// The distance along the target's normal, weighted by how planar the target is there: edges do not count.
    PointToPlane,
    /// Generalised ICP (Segal et al., RSS 2009): the distance by the covariances of both points, made of their
    /// noise and of the shape around them. Points may slide along surfaces and along edges.
    Generalized,
}

/// How clouds are registered. Lengths are in parts of the target's extent, the median distance of its points
/// from their median, so that one setting serves clouds of any unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IcpParams {
    /// What a correspondence is measured by. Default `point_to_plane`.
    pub kind: ResidualKind,
    /// Whether the scale is estimated too. Default false: a rigid motion, and the scale of the initial guess is
    /// kept. True needs clouds that overlap well: points without a counterpart pull the scale down.
    pub estimate_scale: bool,
    /// Nearest points that tell the shape around a point, itself among them. Default 12; 5 to 30. More are
    /// steadier against noise and round off corners.
    pub shape_neighbours: usize,
    /// How far apart corresponding points may be in the first iteration, in extents. Default 0.4; 0.02 to 1.
    /// It is how wrong the initial guess may be.
    pub first_max_distance: f64,
    /// The same in the last iterations. Default 0.05; above 0, at most `first_max_distance`. Lower keeps parts
    /// that do not overlap from pulling. In sparse clouds it is raised to twice the radius of the neighbourhoods.
    pub last_max_distance: f64,
    /// Factor from one iteration's distance and kernel width to the next, until their last values. Default 0.8;
    /// 0 to 1. Higher converges from farther away, and more slowly.
    pub annealing: f64,
    /// Share of the correspondences kept, those with the smallest residuals. Default 0.9; 0.1 to 1.
    pub keep_share: f64,
    /// How a residual loses weight as it grows. Default `cauchy`.
    pub kernel: RobustKernel,
    /// Last width of the kernel in robust standard deviations of the residuals. Default 2.4, with which Cauchy
    /// is 95 % efficient; 1 to 5.
    pub kernel_width: f64,
    /// Fewest points in either cloud and fewest correspondences. Default 50; at least 10.
    pub min_points: usize,
    /// Smallest share of the source's points with a counterpart. Default 0.3; 0 to 1.
    pub min_overlap: f64,
    /// Smallest constraint on any direction of motion, see `Registration::least_constrained`. Default 0.01; 0 to 1. A third of the
    /// points on each of three walls constrain every translation by about 0.33.
    #[serde(rename = "min_hold")]
    pub min_constraint: f64,
    /// Largest |ln| of the factor by which the estimated scale leaves the initial guess's. Default ln 1.5; above
    /// 0. Without effect on a rigid registration.
    pub max_log_scale_change: f64,
    /// Most iterations. Default 40; at least 1. Ten to twenty are usual.
    pub max_iterations: usize,
    /// Length of the step (extents, radians, ln scale) below which the registration has converged. Default 10⁻⁴,
    /// well below what noise leaves; above 0.
    pub converged_step: f64,
}

impl Default for IcpParams {
    fn default() -> Self {
        Self {
            kind: ResidualKind::PointToPlane,
            estimate_scale: false,
            shape_neighbours: 12,
            first_max_distance: 0.4,
            last_max_distance: 0.05,
            annealing: 0.8,
            keep_share: 0.9,
            kernel: RobustKernel::Cauchy,
            kernel_width: 2.4,
            min_points: 50,
            min_overlap: 0.3,
            min_constraint: 0.01,
            max_log_scale_change: 1.5f64.ln(),
            max_iterations: 40,
            converged_step: 1e-4,
        }
    }
}
