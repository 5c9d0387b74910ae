//! Relative pose of a keyframe pair from matched rays (PCR-Pro; Loop-box, §IV-C1).
//!
//! The paper takes the eight-point algorithm on bearing vectors inside RANSAC, in OpenGV's manner. Rays instead of
//! pixels make any calibrated camera good. Here hypotheses come from two sources: the normalised eight-point
//! algorithm, which fails where all matches lie on one plane, and homographies of four matches, each of which stands
//! for two poses and fails nowhere but explains planes alone. All are scored alike, by Sampson's epipolar error on
//! the sphere. The best is refined on its inliers by nonlinear least squares over SO(3) × S² with Huber's
//! cost, and inliers are chosen anew until they stay.
//!
//! Then three models compete for the inliers by GRIC (Torr, "Geometric Motion Segmentation and Model Selection",
//! 1998): a scene with depth, one plane, and a turn without visible translation. See [`Scene`].

mod epipolar;
mod least_squares;
mod linear;
mod model;
mod rays;
mod search;
#[cfg(test)]
mod tests;
mod transfer;

use geometry::Sampler;
use linear::Pose;
pub(crate) use model::ln_false_alarms;
use model::{Chooser, Settled};
use nalgebra::{Matrix3, Matrix3x2, Matrix5, Unit, UnitQuaternion, Vector3};
use rays::Rays;
use serde::{Deserialize, Serialize};

/// Where two cameras see the same point: rays from the camera's centre in its own frame.
///
/// They need not be of unit length, but neither zero nor infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BearingMatch {
    /// The ray in the source camera's frame.
    pub source: Vector3<f64>,
    /// The ray in the target camera's frame.
    pub target: Vector3<f64>,
}

/// How the relative pose is found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TwoViewParams {
    /// Largest epipolar error of an inlier, pixels. Default 2.0; 0.5 to 5. Key points are found to about half a
    /// pixel. Higher keeps more right matches and more wrong ones.
    pub max_error: f64,
    /// Fewest inliers. Default 16; at least 8. Lower takes pairs that see little in common.
    pub min_inliers: usize,
    /// How many sets of matches as good as the found inliers may be expected among as many wrong matches. Default
    /// 1e-6; above 0. Lower refuses more unrelated views, and more pairs with many wrong matches (Moisan & Stival
    /// 2004).
    pub max_false_alarms: f64,
    /// Largest standard deviation of the translation's direction that counts as known, radians. Default 0.35
    /// (20°); above 0.
    pub max_direction_deviation: f64,
    /// Probability that RANSAC draws a sample without wrong matches. Default 0.999; 0 to 1, exclusive.
    pub confidence: f64,
    /// Most samples drawn, each of eight-point and of homographies. Default 3000; at least 1. Bounds the time on
    /// unrelated views; with two thirds of the matches right, about 520 are drawn.
    pub max_samples: usize,
    /// Seed of the samples. Default 1. The same seed gives the same result.
    pub seed: u64,
}

impl Default for TwoViewParams {
    fn default() -> Self {
        Self {
            max_error: 2.0,
            min_inliers: 16,
            max_false_alarms: 1e-6,
            max_direction_deviation: 0.35,
            confidence: 0.999,
            max_samples: 3000,
            seed: 1,
        }
    }
}

/// What the inliers show, and which of the pose's parts rest on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Scene {
    /// Points at many depths.
    Depth,
    /// One plane explains nearly all inliers. The pose is that of the plane's homography, refined with plane and
    /// pose together.
    Plane {
        /// Unit normal in the source camera's frame, pointing away from the camera.
        normal: Unit<Vector3<f64>>,
        /// A plane allows two poses. The other one, where the matches off the plane do not tell them apart: then
        /// the returned pose is as likely wrong as right.
        alternative: Option<(UnitQuaternion<f64>, Unit<Vector3<f64>>)>,
    },
    /// A rotation explains nearly all inliers: no parallax is seen, so the translation is unknown, down to whether
    /// there is one.
    NoParallax,
}

/// The direction of the translation, with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Direction {
    /// t̂ of `p_t = R p_s + |t| t̂`: where the source camera is, in the target camera's frame.
    pub vector: Unit<Vector3<f64>>,
    /// Two unit vectors across `vector`, in which its error is counted: `t̂_true ≈ t̂ + basis · d`.
    pub basis: Matrix3x2<f64>,
    /// Covariance of `(ω, d)`: three entries of the rotation's error as in [`RelativePose::rotation_covariance`],
    /// two of the direction's; rad².
    pub covariance: Matrix5<f64>,
}

/// The relative pose of two views with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RelativePose {
    /// R: turns directions of the source camera's frame into the target camera's.
    pub target_from_source: UnitQuaternion<f64>,
    /// Covariance of ω in `R_true = exp(ω) R`, rad².
    ///
    /// From the inliers' residuals, so it does not know of wrong matches that pass for inliers by chance. In
    /// simulation (200 right matches, 400 runs) the normalised squared error averages to 3.3 for its 3 degrees of
    /// freedom, that of rotation and direction together to 5.4 for 5. With 60 wrong matches more it is 3.6 and 6.1
    /// (noise 0.3 pixel), 3.7 and 6.4 (0.5), 4.7 and 8.8 (0.7): deviations are then stated too small, by 10 to 35 %.
    pub rotation_covariance: Matrix3<f64>,
    /// The translation's direction; nothing where it is unknown.
    pub direction: Option<Direction>,
    /// What kind of scene the inliers show.
    pub scene: Scene,
    /// Indices of the inliers among the matches, rising. Their number is the paper's γ.
    pub inliers: Vec<usize>,
    /// ln of how many sets of as many matches would agree with some pose as well if all were wrong.
    pub ln_false_alarms: f64,
    /// Median angle over the inliers between the two rays to a point, radians.
    pub parallax: f64,
    /// Root mean square of the inliers' errors, pixels.
    pub rmse: f64,
}

impl RelativePose {
    /// γ: how many matches agree with the pose.
    pub fn match_count(&self) -> usize {
        self.inliers.len()
    }
}

/// Why a pair has no relative pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum TwoViewRefusal {
    /// Too few matches are given to begin with.
    #[error("{given} matches are too few: at least {needed} are needed")]
    TooFewMatches {
        /// Matches given.
        given: usize,
        /// Matches needed.
        needed: usize,
    },
    /// A ray is not finite or has no length.
    #[error("match {index} cannot be used: its rays must be finite and not zero")]
    InvalidMatch {
        /// Index of the match.
        index: usize,
    },
    /// The angle of a pixel is not a positive number.
    #[error("the angle of a pixel must be a positive number of radians, not {pixel_angle}")]
    InvalidPixelAngle {
        /// The angle given.
        pixel_angle: f64,
    },
    /// No sample of the matches gave a pose.
    #[error("the matches allow no pose at all: they may all be one point, or lie on one line")]
    NoPose,
    /// Too few matches agree with the best pose.
    #[error("only {inliers} of {given} matches agree with one pose: at least {needed} are needed")]
    TooFewInliers {
        /// Matches that agree.
        inliers: usize,
        /// Matches given.
        given: usize,
        /// Matches needed.
        needed: usize,
    },
    /// As many wrong matches would often agree with a pose as well.
    #[error(
        "{inliers} of {given} matches agree with one pose, which as many wrong matches may do by chance: the views \
         may show different places"
    )]
    Chance {
        /// Matches that agree.
        inliers: usize,
        /// Matches given.
        given: usize,
    },
    /// The inliers leave the rotation open.
    #[error("the {inliers} matches that agree lie too close together to tell the rotation")]
    Degenerate {
        /// Matches that agree.
        inliers: usize,
    },
}

impl TwoViewRefusal {
    /// How many matches were given, where that is told.
    pub fn given(&self) -> usize {
        match *self {
            Self::TooFewMatches { given, .. }
            | Self::TooFewInliers { given, .. }
            | Self::Chance { given, .. } => given,
            Self::Degenerate { inliers } => inliers,
            Self::InvalidMatch { .. } | Self::InvalidPixelAngle { .. } | Self::NoPose => 0,
        }
    }
}

/// Estimates R and t̂ of `p_t = R p_s + t` from matched rays (see the module).
///
/// `pixel_angle` is the angle that one pixel covers, radians: for a pinhole about 1 / focal length. It is the unit of
/// the thresholds.
///
/// # Errors
/// When the matches are too few, not numbers, or do not agree with one pose better than chance.
pub fn relative_pose(
    matches: &[BearingMatch],
    pixel_angle: f64,
    params: &TwoViewParams,
) -> Result<RelativePose, TwoViewRefusal> {
    let given = matches.len();
    let needed = params.min_inliers.max(8);
    if !(pixel_angle.is_normal() && pixel_angle > 0.0) {
        return Err(TwoViewRefusal::InvalidPixelAngle { pixel_angle });
    }
    if given < needed {
        return Err(TwoViewRefusal::TooFewMatches { given, needed });
    }
    let rays = Rays::new(matches)?;
    let limit = (params.max_error * pixel_angle).powi(2);

    let mut sampler = Sampler::new(params.seed);
    let homography = search::homography(&rays, limit, &mut sampler, params);
    let planes = homography.map(|h| search::plane_poses(&rays, &h, limit)).unwrap_or_default();
    let seeds: Vec<Pose> = planes.iter().filter_map(|plane| plane.pose()).collect();
    let start = search::pose(&rays, limit, &seeds, &mut sampler, params).ok_or(TwoViewRefusal::NoPose)?;

    let settled = Settled::new(&rays, start, limit, pixel_angle);
    let inliers = settled.inliers.len();
    if inliers < needed {
        return Err(TwoViewRefusal::TooFewInliers { inliers, given, needed });
    }
    // Written so that a NaN is refused.
    let above_chance = settled.ln_false_alarms(&rays, limit) < params.max_false_alarms.ln();
    if !above_chance {
        return Err(TwoViewRefusal::Chance { inliers, given });
    }
    let chooser = Chooser { rays: &rays, settled: &settled, limit, pixel_angle, params };
    chooser.choose(homography.as_ref(), planes).ok_or(TwoViewRefusal::Degenerate { inliers })
}

/// The squared error up to which a match lies on a plane, for that up to which it is an inlier: the error has two
/// rows instead of one, and the ratio of the 95 % quantiles of χ² makes both keep as many right matches.
fn plane_limit(limit: f64) -> f64 {
    5.991 / 3.841 * limit
}
