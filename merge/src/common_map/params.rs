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
    /// Largest difference between two ways over which two agents stand to each other, standard deviations of the drift
    /// of a whole map by `consistency`. Default 4.9: the square is the 99.9 % quantile of χ² with 7 degrees of freedom.
    pub max_cycle_error: f64,
    /// Largest set of closures between two agents that contradicts the largest and agrees in itself, as a share of it.
    /// Default 0.5; 0 to 1. Beyond, nothing says which of both is right, and neither is believed.
    pub max_rival_share: f64,
    /// The joint pose graph.
    pub pose_graph: PoseGraphParams,
}

impl Default for FusionParams {
    fn default() -> Self {
        Self {
            optimise: true,
            consistency: ConsistencyParams::default(),
            max_cycle_error: 4.9,
            max_rival_share: 0.5,
            pose_graph: PoseGraphParams::default(),
        }
    }
}
