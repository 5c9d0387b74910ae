//! Parameters of a merge of LiDARs' maps.

use backend::verdict::Prior;
use serde::Serialize;
use slam_lidar::merging::MergeMethod;

/// How maps of LiDARs are merged.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LidarMergeParams {
    /// How poses are found.
    pub method: MergeMethod,
    /// What may have changed between two maps.
    pub prior: Prior,
}
