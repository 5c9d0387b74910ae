//! How the baselines are computed.

use crate::icp::{IcpParams, KeyframeCloudParams, ResidualKind};
use crate::optimal_scale::OptimalScaleParams;
use crate::pair::PairParams;
use backend::posegraph::{KernelShape, PoseGraphParams, RobustKernel};
use serde::{Deserialize, Serialize};

/// Least squares: a Huber kernel that no residual leaves.
const LEAST_SQUARES: RobustKernel = RobustKernel { shape: KernelShape::Huber, width: 1e9 };

/// How the baselines are computed: as the paper says, where it says it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BaselineParams {
    /// Matching, relative pose and scale of a pair.
    pub pair: PairParams,
    /// Algorithm 1.
    pub optimal_scale: OptimalScaleParams,
    /// The clouds that are registered.
    pub cloud: KeyframeCloudParams,
    /// Their registration. Default point-to-point, as the paper has it, and however little the
    /// clouds constrain a motion, as its ICP refuses nothing; the rest as in Loop-box.
    pub icp: IcpParams,
    /// The pose graph of the neighbourhood. Default without robust kernels.
    pub pose_graph: PoseGraphParams,
}

impl Default for BaselineParams {
    fn default() -> Self {
        Self {
            pair: PairParams::default(),
            optimal_scale: OptimalScaleParams::default(),
            cloud: KeyframeCloudParams::default(),
            icp: IcpParams { kind: ResidualKind::PointToPoint, min_constraint: 0.0, ..IcpParams::default() },
            pose_graph: PoseGraphParams {
                odometry: LEAST_SQUARES,
                covisibility: LEAST_SQUARES,
                loop_closure: LEAST_SQUARES,
                merge: LEAST_SQUARES,
                ..PoseGraphParams::default()
            },
        }
    }
}
