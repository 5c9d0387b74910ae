//! All parameters of the agent, gathered.

use crate::align::AlignParams;
use crate::bootstrap::BootstrapParams;
use crate::keyframes::KeyframeParams;
use crate::mapping::MappingParams;
use crate::track::TrackParams;
use crate::triangulate::TriangulateParams;
use serde::{Deserialize, Serialize};

/// Parameters of the direct SLAM agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Making the first map.
    pub bootstrap: BootstrapParams,
    /// Direct alignment of a frame.
    pub align: AlignParams,
    /// Map-to-frame tracking.
    pub track: TrackParams,
    /// When a frame becomes a keyframe, when tracking is lost.
    pub keyframes: KeyframeParams,
    /// Points and window optimisation.
    pub mapping: MappingParams,
    /// Depth of new points.
    pub triangulate: TriangulateParams,
}
