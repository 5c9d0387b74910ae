//! Why a closure came to nothing.

use crate::generalised_pose::GeneralisedPoseRefusal;
use crate::optimal_scale::OptimalScaleRefusal;
use crate::pair::PairRefusal;
use serde::{Deserialize, Serialize};

/// Why a closure came to nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum ClosureRefusal {
    /// None of the pairs could be measured.
    #[error("no keyframe pair gives a scale: {0}")]
    NoPair(PairRefusal),
    /// The keyframes around the place agree on no pose.
    #[error("{0}")]
    Neighbourhood(#[from] GeneralisedPoseRefusal),
    /// The pairs' scales contradict each other.
    #[error("{0}")]
    Scale(#[from] OptimalScaleRefusal),
    /// A keyframe is not in its map or its numbers make no motion.
    #[error("the poses of the matched keyframes make no motion of the maps")]
    NoMotion,
    /// No two pairs agree on the motion, and there is more than one.
    #[error(
        "the keyframe pairs disagree on how the maps lie to each other: χ² {chi2:.1} for 7 degrees of freedom"
    )]
    Disagreement {
        /// The smallest χ² between two of them.
        chi2: f64,
    },
}
