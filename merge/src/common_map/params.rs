//! How the common map is made.

use backend::posegraph::{ConsistencyParams, PoseGraphParams};
use serde::{Deserialize, Serialize};

/// How the common map is made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FusionParams {
    /// Whether the joint pose graph is optimised after the agents were placed. Default true; without it every agent's
    /// map is moved as a whole.
    pub optimise: bool,
    /// Which closures between two agents agree; the others are left out and named.
    pub consistency: ConsistencyParams,
    /// The joint pose graph.
    pub pose_graph: PoseGraphParams,
}

impl Default for FusionParams {
    fn default() -> Self {
        Self {
            optimise: true,
            consistency: ConsistencyParams::default(),
            pose_graph: PoseGraphParams::default(),
        }
    }
}
