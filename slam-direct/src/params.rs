//! All parameters of the agent, gathered.

use crate::params_macro::params;

params! {
    /// Parameters of the direct SLAM agent.
    pub struct Params {}
}
