//! All parameters of the agent, gathered.

use serde::{Deserialize, Serialize};

/// Parameters of the direct SLAM agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}
