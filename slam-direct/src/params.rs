//! All parameters of the agent, gathered.

use crate::align::AlignParams;
use crate::atlas::AtlasParams;
use crate::bootstrap::BootstrapParams;
use crate::closing::ClosingParams;
use crate::depth::DepthParams;
use crate::keyframes::KeyframeParams;
use crate::mapping::MappingParams;
use crate::relocalise::RelocaliseParams;
use crate::track::TrackParams;
use crate::triangulate::TriangulateParams;
use backend::params;

params! {
    /// Parameters of the direct SLAM agent.
    pub struct Params {
        /// Making the first map.
        pub bootstrap: BootstrapParams = BootstrapParams::default(),
        /// Direct alignment of a frame.
        pub align: AlignParams = AlignParams::default(),
        /// Map-to-frame tracking.
        pub track: TrackParams = TrackParams::default(),
        /// When a frame becomes a keyframe, when tracking is lost.
        pub keyframes: KeyframeParams = KeyframeParams::default(),
        /// Points and window optimisation.
        pub mapping: MappingParams = MappingParams::default(),
        /// Finding a lost frame again.
        pub relocalise: RelocaliseParams = RelocaliseParams::default(),
        /// Going on after a loss.
        pub atlas: AtlasParams = AtlasParams::default(),
        /// Closing loops.
        pub closing: ClosingParams = ClosingParams::default(),
        /// Semi-dense depth.
        pub depth: DepthParams = DepthParams::default(),
        /// Depth of new points.
        pub triangulate: TriangulateParams = TriangulateParams::default(),
    }
}
