//! Fine registration of two clouds by iterated closest points, and its information matrix (Loop-box, §IV-D2 and
//! Eqs. 2–3).
//!
//! One iteration: each source point meets the nearest target point (`neighbours`), the pair gets a residual and
//! a metric (`problem`), a robust weight or none (`weights`), and one Gauss–Newton step moves the source
//! (`solve`). Distances and kernel widths shrink from iteration to iteration, so that the first iterations
//! find the way and the last ones are exact. [`covariance`] then says how good the result is.
//!
//! The clouds of direct SLAM are edges more than surfaces, and an edge's normal means little. Point-to-plane, the
//! paper's residual and the default, therefore weighs each pair by how planar the target is around it and leaves
//! edges out. The residuals that keep the edges can stop short of the solution, likely because an edge's nearest
//! neighbour among parallel edges is the wrong one, and their covariance does not show it; where the edges are
//! sparse, generalised ICP is the more exact.
//!
//! Points are searched side by side, and all sums taken in a fixed order: equal clouds give equal results on any
//! machine.

mod cloud;
pub mod covariance;
mod error;
mod neighbours;
mod params;
mod problem;
mod shape;
mod solve;
#[cfg(test)]
mod tests;
mod weights;

pub use cloud::{Cloud, KeyframeCloudParams, keyframe_cloud};
pub use error::{IcpRefusal, OpenDirection, Side};
pub use params::{IcpParams, ResidualKind};
pub use weights::RobustKernel;

use covariance::{TangentMatrix, estimated_inverse, noise_factor};
use geometry::Sim3;
use nalgebra::Vector3;
use problem::{Matches, Problem};
use serde::{Deserialize, Serialize};

/// Fewest points that are worth a thread of their own.
const POINTS_AT_A_TIME: usize = 256;

/// A registration with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    /// Maps source points onto the target. Rigid registration keeps the scale of the initial guess.
    pub target_from_source: Sim3,
    /// Covariance (Eq. 3) of the left perturbation ε, `true = exp(ε) ∘ target_from_source`, tangent order
    /// (υ, ω, λ), target units. Row and column of λ are zero if the scale was not estimated.
    ///
    /// It takes the noise of different points as independent. Depths of neighbouring pixels are not, so for
    /// clouds of keyframes it is too small by about the number of pixels that err together. Without given noise
    /// its deviations come out about a quarter too small, because trimming leaves the largest residuals out.
    pub covariance: TangentMatrix,
    /// Inverse of `covariance`, zero where that is zero.
    pub information: TangentMatrix,
    /// Share of the correspondences that count at least half, 0 to 1.
    pub inlier_share: f64,
    /// Share of the source points that have a target point within the last distance, 0 to 1.
    pub overlap: f64,
    /// Root mean square distance of the inliers' points, target units.
    pub rmse: f64,
    /// The motion constrained least, and how much: the mean over the correspondences, by weight, of how much of it the
    /// target's shape resists (0: all points slide, 1: none does).
    #[serde(rename = "hold")]
    pub least_constrained: OpenDirection,
    /// Factor the given noise was raised by in `covariance` because the residuals are larger than it explains
    /// (at least 1); without given noise, the variance of a point's coordinate, target units squared.
    pub noise_factor: f64,
    /// Iterations made.
    pub iterations: usize,
    /// Whether the last step was small enough. If not, the result still moved.
    pub converged: bool,
}

/// Registers `source` to `target` from the guess `initial`, target_from_source.
///
/// Errors say why there is no registration; a result that is merely poor shows in its evidence.
pub fn register(
    source: &Cloud,
    target: &Cloud,
    initial: &Sim3,
    params: &IcpParams,
) -> Result<Registration, IcpRefusal> {
    let needed = params.min_points.max(10);
    check(Side::Source, source, needed)?;
    check(Side::Target, target, needed)?;
    if !initial.is_valid() {
        return Err(IcpRefusal::InvalidInitial);
    }
    let normalised_from_target = normalization(&target.points).ok_or(IcpRefusal::NoExtent)?;
    let target = target.moved(&normalised_from_target);
    let problem = Problem::new(source, &target, params);

    let start = normalised_from_target * *initial;
    let track = iterate(&problem, &start, params)?;
    let last = problem.matches(&track.normalised_from_source, problem.last_max_distance);
    let matches = last.weighted(params, 1.0)?;
    if matches.overlap < params.min_overlap {
        return Err(IcpRefusal::LittleOverlap { overlap: matches.overlap, needed: params.min_overlap });
    }
    let solution = Solution { problem: &problem, matches: &matches, track: &track };
    let factor = track.normalised_from_source.scale / start.scale;
    if params.estimate_scale && factor.ln().abs() > params.max_log_scale_change {
        return Err(IcpRefusal::ScaleRanAway { factor });
    }
    solution.registration(&normalised_from_target, params)
}

/// Refuses a cloud that cannot be used.
fn check(side: Side, cloud: &Cloud, needed: usize) -> Result<(), IcpRefusal> {
    let given = cloud.points.len();
    if given < needed {
        return Err(IcpRefusal::TooFew { side, given, needed });
    }
    if let Some(index) = cloud.points.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        return Err(IcpRefusal::InvalidPoint { side, index });
    }
    let Some(covariances) = &cloud.covariances else { return Ok(()) };
    if covariances.len() != given {
        return Err(IcpRefusal::CovarianceCount { side, points: given, covariances: covariances.len() });
    }
    let valid = |c: &nalgebra::Matrix3<f64>| {
        let trace = c.trace();
        // A covariance of rank one or two is fine; rounding may leave it a little negative.
        let lifted = c + nalgebra::Matrix3::identity() * (trace * 1e-9 + f64::MIN_POSITIVE);
        c.iter().all(|v| v.is_finite()) && trace >= 0.0 && (trace == 0.0 || lifted.cholesky().is_some())
    };
    match covariances.iter().position(|c| !valid(c)) {
        Some(index) => Err(IcpRefusal::InvalidPoint { side, index }),
        None => Ok(()),
    }
}

/// The similarity that puts the median of `points` to the origin and their median distance from it to 1.
fn normalization(points: &[Vector3<f64>]) -> Option<Sim3> {
    let median = |values: Vec<f64>| weights::quantile(&values, 0.5);
    let centre = Vector3::from_fn(|k, _| median(points.iter().map(|p| p[k]).collect()));
    let extent = median(points.iter().map(|p| (p - centre).norm()).collect());
    let scale = extent.recip();
    (extent > 0.0 && scale.is_finite())
        .then(|| Sim3::new(nalgebra::UnitQuaternion::identity(), -centre * scale, scale))
}

/// Where the iterations ended.
struct Track {
    normalised_from_source: Sim3,
    iterations: usize,
    converged: bool,
}

/// The iterations, from `start`, normalised_from_source.
fn iterate(problem: &Problem, start: &Sim3, params: &IcpParams) -> Result<Track, IcpRefusal> {
    let last = problem.last_max_distance;
    let mut distance = params.first_max_distance.max(last);
    let mut normalised_from_source = *start;
    for iteration in 1..=params.max_iterations.max(1) {
        let matches = problem.matches(&normalised_from_source, distance).weighted(params, distance / last)?;
        let step = solve::step(&matches.correspondences, params.estimate_scale);
        normalised_from_source = Sim3::exp(&step) * normalised_from_source;
        if distance <= last && step.norm() < params.converged_step {
            return Ok(Track { normalised_from_source, iterations: iteration, converged: true });
        }
        distance = (distance * params.annealing).max(last);
    }
    Ok(Track { normalised_from_source, iterations: params.max_iterations.max(1), converged: false })
}

/// The end of a registration, in the normalised frame.
struct Solution<'a> {
    problem: &'a Problem<'a>,
    matches: &'a Matches,
    track: &'a Track,
}

impl Solution<'_> {
    /// The evidence, and all back in the target's frame and unit.
    fn registration(
        &self,
        normalised_from_target: &Sim3,
        params: &IcpParams,
    ) -> Result<Registration, IcpRefusal> {
        let normalised_from_source = &self.track.normalised_from_source;
        let least_constrained = self.problem.least_constrained(self.matches, params.estimate_scale);
        // Written so that a NaN is refused.
        let is_constrained = least_constrained.constraint >= params.min_constraint;
        if !is_constrained {
            return Err(IcpRefusal::Degenerate(least_constrained));
        }
        let target_from_normalised = normalised_from_target.inverse();
        let correspondences = &self.matches.correspondences;
        let noise = self.problem.noise(self.matches, normalised_from_source);
        let freedom = if params.estimate_scale { 7 } else { 6 };
        let factor = noise_factor(correspondences, &noise, freedom);
        // Noise that is given is a floor: small residuals of close points prove nothing.
        let factor = if self.problem.knows_noise() { factor.max(1.0) } else { factor };
        let covariance = covariance::covariance(correspondences, &noise, params.estimate_scale)
            .ok_or(IcpRefusal::Degenerate(least_constrained))?
            * factor;
        let adjoint = target_from_normalised.adjoint();
        let covariance = adjoint * covariance * adjoint.transpose();
        let covariance = (covariance + covariance.transpose()) * 0.5;
        let information = estimated_inverse(&covariance, params.estimate_scale)
            .ok_or(IcpRefusal::Degenerate(least_constrained))?;
        let squared_extent = target_from_normalised.scale * target_from_normalised.scale;
        Ok(Registration {
            target_from_source: target_from_normalised * *normalised_from_source,
            covariance,
            information,
            inlier_share: self.matches.inlier_share,
            overlap: self.matches.overlap,
            rmse: self.matches.rmse * target_from_normalised.scale,
            least_constrained,
            noise_factor: if self.problem.knows_noise() { factor } else { factor * squared_extent },
            iterations: self.track.iterations,
            converged: self.track.converged,
        })
    }
}
