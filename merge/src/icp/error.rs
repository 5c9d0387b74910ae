//! Why clouds are not registered.

use super::covariance::Tangent;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::fmt;

/// One of the two clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The cloud that moves.
    Source,
    /// The cloud that stays.
    Target,
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Side::Source => "source",
            Side::Target => "target",
        })
    }
}

/// A direction of motion that the points do not constrain.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpenDirection {
    /// The motion as a unit tangent (υ, ω, λ) about the target's centre: υ in extents, ω in radians, axes of the
    /// target frame.
    pub tangent: Tangent,
    /// How much it is constrained, as in `Registration::least_constrained`.
    #[serde(rename = "hold")]
    pub constraint: f64,
}

impl OpenDirection {
    /// The part that is translation, in extents.
    pub fn translation(&self) -> Vector3<f64> {
        self.tangent.fixed_rows::<3>(0).into_owned()
    }

    /// The part that is rotation, radians.
    pub fn rotation(&self) -> Vector3<f64> {
        self.tangent.fixed_rows::<3>(3).into_owned()
    }
}

impl fmt::Display for OpenDirection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (t, r, scale) = (self.translation(), self.rotation(), self.tangent[6].abs());
        if scale > t.norm().max(r.norm()) {
            return write!(f, "scale");
        }
        let (what, v) = if t.norm() >= r.norm() { ("translation along", t) } else { ("rotation about", r) };
        write!(f, "{what} ({:.2}, {:.2}, {:.2})", v.x, v.y, v.z)
    }
}

/// Why two clouds are not registered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum IcpRefusal {
    /// A cloud has too few points.
    #[error("the {side} cloud has {given} points, at least {needed} are needed: admit less certain depths")]
    TooFew {
        /// Which cloud.
        side: Side,
        /// Points given.
        given: usize,
        /// Points needed.
        needed: usize,
    },
    /// A coordinate or covariance of a point is not usable.
    #[error("point {index} of the {side} cloud is not finite, or its covariance not positive semi-definite")]
    InvalidPoint {
        /// Which cloud.
        side: Side,
        /// Index of the point.
        index: usize,
    },
    /// A cloud does not have one covariance for each point.
    #[error("the {side} cloud has {points} points and {covariances} covariances: give one for each, or none")]
    CovarianceCount {
        /// Which cloud.
        side: Side,
        /// Points given.
        points: usize,
        /// Covariances given.
        covariances: usize,
    },
    /// The initial guess is not a similarity.
    #[error("the initial guess is not finite, or its scale not positive")]
    InvalidInitial,
    /// More than half of the points of the target are one point.
    #[error("the target cloud has no extent: most of its points lie in one place")]
    NoExtent,
    /// Too few source points have a counterpart.
    #[error(
        "only {overlap:.2} of the source points have a counterpart, {needed:.2} are needed: the clouds may show \
         different places, or the initial guess is too far off"
    )]
    LittleOverlap {
        /// Share that has one.
        overlap: f64,
        /// Share needed.
        needed: f64,
    },
    /// Too few of the counterparts can be measured by the residual asked for.
    #[error(
        "only {given} correspondences can be used, at least {needed} are needed: the target may have no surfaces \
         for point-to-plane"
    )]
    FewCorrespondences {
        /// Correspondences that can be used.
        given: usize,
        /// Correspondences needed.
        needed: usize,
    },
    /// The points leave a direction of motion open.
    #[error("the clouds leave a motion open: {0} (held by {hold:.4})", hold = .0.constraint)]
    Degenerate(OpenDirection),
    /// The estimated scale left the initial guess too far behind.
    #[error("the scale ran away from the initial guess by a factor of {factor:.3}: keep it fixed")]
    ScaleRanAway {
        /// Scale found over the initial guess's.
        factor: f64,
    },
}
