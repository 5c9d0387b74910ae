//! Parameters of a merge.

use merge::common_map::FusionParams;
use merge::further::FurtherParams;
use merge::key_points::KeyPointParams;
use merge::method::{BaselineParams, Method};
use merge::verification::VerificationParams;
use place_recog::{ProposeParams, RankParams};
use serde::{Deserialize, Serialize};

/// How maps are merged: all parameters of all steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergingParams {
    /// Places that two maps may share.
    pub places: ProposeParams,
    /// Which of the proposed are looked at first.
    pub rank: RankParams,
    /// Depth at key points.
    pub key_points: KeyPointParams,
    /// From places to a closure.
    #[serde(rename = "meeting")]
    pub verification: VerificationParams,
    /// How maps are joined at an accepted closure: directly, or by a method to compare that with.
    pub method: Method,
    /// The methods to compare with.
    pub baseline: BaselineParams,
    /// Closures after the first.
    pub further: FurtherParams,
    /// The common map.
    pub fusion: FusionParams,
    /// Whether all that the agents of a common map observe, of each other's points too, is optimised jointly in the end. Of maps that
    /// are joined by another method than the direct one nothing is.
    pub joint: bool,
    /// Most keyframes of a common map that is optimised jointly: its time grows with them, a hundred take seconds.
    pub joint_keyframes: usize,
}

impl Default for MergingParams {
    fn default() -> Self {
        let (places, rank, key_points, verification) = Default::default();
        let (method, baseline, further, fusion) = Default::default();
        Self {
            places,
            rank,
            key_points,
            verification,
            method,
            baseline,
            further,
            fusion,
            joint: true,
            joint_keyframes: 1000,
        }
    }
}
