//! Why a baseline joins nothing.

use crate::icp::IcpRefusal;
use crate::optimal_scale::OptimalScaleRefusal;
use crate::pair::PairRefusal;
use backend::posegraph::PoseGraphError;

/// Why a baseline does not join two maps at a closure.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MethodRefusal {
    /// The pair that the method rests on could not be measured.
    #[error("the keyframe pair that the method rests on could not be measured: {0}")]
    NotMeasured(PairRefusal),
    /// Algorithm 1 has no scale.
    #[error(transparent)]
    Scale(#[from] OptimalScaleRefusal),
    /// The clouds could not be registered.
    #[error("the clouds of the keyframe pair could not be registered: {0}")]
    Registration(IcpRefusal),
    /// The pose graph failed.
    #[error(transparent)]
    PoseGraph(#[from] PoseGraphError),
    /// Numbers that make no motion, or a keyframe that is not there.
    #[error("the poses of the matched keyframes make no motion of the maps")]
    NoMotion,
}
