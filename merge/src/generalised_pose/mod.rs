//! The similarity between two maps from matches of several keyframes of both, where depth on one side suffices.
//!
//! The keyframes around a place are one camera with many centres, whose poses are known up to the map's unit. Three
//! matched points that one map knows, seen by one keyframe of the other, give that keyframe's pose (P3P); what is left
//! is the ratio of the two units, which one more match tells: by its depth on both sides, or by the baseline between
//! two keyframes (the generalised pose-and-scale problem; Sweeney, Fragoso, Höllerer, Turk, "gDLS: A Scalable Solution
//! to the Generalized Pose and Scale Problem", ECCV 2014). Samples are drawn both ways, scored by reprojection both
//! ways (MSAC, Torr & Zisserman 2000), and the best refined over all seven degrees of freedom.
//!
//! A depth's own uncertainty moves its point along the ray it was measured on: the error across that line counts in
//! pixels, along it in pixels and depth together.

mod error;
mod refine;
mod search;
#[cfg(test)]
mod tests;

pub use error::{Located, Sighting, View};

use crate::estimate::Estimate;
use crate::two_view::ln_false_alarms;
use geometry::{Sampler, Sim3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How the pose is found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GeneralisedPoseParams {
    /// Standard deviation of a key point's position, pixels. Default 1; above 0.
    pub pixel_deviation: f64,
    /// Floor of the relative standard deviation of a depth. Default 0.02; above 0. Depths of neighbouring keyframes
    /// differ by more than each one's variance says.
    pub min_depth_deviation: f64,
    /// Largest squared Mahalanobis distance of a sighting that agrees. Default 9.21, the 99 % quantile of χ² with 2
    /// degrees of freedom; 6 to 14.
    pub gate: f64,
    /// Fewest matches that agree, each key point of either map counted once. Default 12; at least 8.
    pub min_inliers: usize,
    /// How many sets of matches as good may be expected among as many wrong ones, as in
    /// [`TwoViewParams::max_false_alarms`](crate::two_view::TwoViewParams::max_false_alarms). Default 1e-6; above 0.
    pub max_false_alarms: f64,
    /// Samples drawn each way at most. Default 600; at least 1. With a fifth of the
    /// matches right, half of that suffices.
    pub max_samples: usize,
}

impl Default for GeneralisedPoseParams {
    fn default() -> Self {
        Self {
            pixel_deviation: 1.0,
            min_depth_deviation: 0.02,
            gate: 9.21,
            min_inliers: 12,
            max_false_alarms: 1e-6,
            max_samples: 600,
        }
    }
}

/// A key point of the source matched with one of the target: `[source, target]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// What each side knows of the point.
    pub sides: [Sighting; 2],
}

/// The matches of the keyframes around a place. On each side, poses and points are in one frame of that side's, in one
/// unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pool {
    /// The keyframes of source and target.
    pub views: [Vec<View>; 2],
    /// The matches; those without depth on either side are of no use.
    pub matches: Vec<Match>,
}

/// A similarity with its evidence.
#[derive(Clone, Debug, PartialEq)]
pub struct GeneralisedPose {
    /// target_from_source between the frames of both sides.
    pub estimate: Estimate,
    /// Indices of the matches that agree, rising.
    pub inliers: Vec<usize>,
    /// How many they are, each key point of either map counted once.
    pub distinct: usize,
    /// ln of how many sets of as many matches would agree with some pose as well if all were wrong.
    pub ln_false_alarms: f64,
}

/// Why there is no pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum GeneralisedPoseRefusal {
    /// Too few matches agree with the best pose.
    #[error(
        "only {inliers} of {given} matches of neighbouring keyframes agree with one pose: at least {needed} are needed"
    )]
    FewInliers {
        /// Key points that agree.
        inliers: usize,
        /// Key points matched.
        given: usize,
        /// Key points needed.
        needed: usize,
    },
    /// As many wrong matches would often agree with a pose as well.
    #[error(
        "{inliers} of {given} matches of neighbouring keyframes agree with one pose, which as many wrong matches may do by chance"
    )]
    Chance {
        /// Key points that agree.
        inliers: usize,
        /// Key points matched.
        given: usize,
    },
    /// The matches leave the similarity open.
    #[error("the matches of neighbouring keyframes leave pose or scale open")]
    Degenerate,
}

/// Matches that settle a similarity: any four are on some.
const FREE_MATCHES: usize = 4;

/// Finds the similarity that most matches of a pool agree with. The same pool gives the same one.
///
/// # Errors
/// When too few agree, or no more than wrong ones would, or they leave a degree of freedom open.
pub fn generalised_pose(
    pool: &Pool,
    params: &GeneralisedPoseParams,
) -> Result<GeneralisedPose, GeneralisedPoseRefusal> {
    let given = distinct(pool, 0..pool.matches.len());
    let needed = params.min_inliers.max(FREE_MATCHES + 1);
    let few = |inliers| GeneralisedPoseRefusal::FewInliers { inliers, given, needed };
    if given < needed {
        return Err(few(given));
    }
    let start = search::search(pool, &mut Sampler::new(1), params).ok_or(few(0))?;
    let (estimate, inliers) =
        refine::refine(pool, start, params).ok_or(GeneralisedPoseRefusal::Degenerate)?;
    let count = distinct(pool, inliers.iter().copied());
    if count < needed {
        return Err(few(count));
    }
    let chance = error::chance(pool, &estimate.a_from_b, params);
    // Written so that a NaN is refused.
    let ln_false_alarms = ln_false_alarms(given, count, FREE_MATCHES, chance);
    let above_chance = ln_false_alarms < params.max_false_alarms.ln();
    if !above_chance {
        return Err(GeneralisedPoseRefusal::Chance { inliers: count, given });
    }
    Ok(GeneralisedPose { estimate, inliers, distinct: count, ln_false_alarms })
}

/// Indices of the matches that agree with a similarity target_from_source, rising.
pub fn find_inliers(pool: &Pool, target_from_source: &Sim3, params: &GeneralisedPoseParams) -> Vec<usize> {
    let motions = error::both_directions(target_from_source);
    let agrees = |index: &usize| error::squared(pool, &pool.matches[*index], &motions, params) <= params.gate;
    (0..pool.matches.len()).filter(agrees).collect()
}

/// How many of the matches `indices` there are when each key point of either map counts once, the earlier match first.
fn distinct(pool: &Pool, indices: impl Iterator<Item = usize>) -> usize {
    let mut seen = [BTreeSet::new(), BTreeSet::new()];
    let fresh = |&index: &usize| {
        let keys = pool.matches[index].sides.map(|side| (side.view, side.feature));
        let fresh = (0..2).all(|side| !seen[side].contains(&keys[side]));
        if fresh {
            for (seen, key) in seen.iter_mut().zip(keys) {
                seen.insert(key);
            }
        }
        fresh
    };
    indices.filter(fresh).count()
}
