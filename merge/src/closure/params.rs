//! How a closure is followed.

use super::neighbourhood::NeighbourhoodParams;
use crate::icp::{IcpParams, KeyframeCloudParams};
use crate::optimal_scale::OptimalScaleParams;
use crate::pair::PairParams;
use crate::pairing::PairingParams;
use backend::sim3_align::Sim3AlignParams;
use serde::{Deserialize, Serialize};

/// How a closure is followed through the steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClosureParams {
    /// Matching, relative pose and scale of a pair.
    pub pair: PairParams,
    /// The keyframes around a place together.
    pub neighbourhood: NeighbourhoodParams,
    /// Direction of travel.
    pub pairing: PairingParams,
    /// The scale of three pairs.
    pub optimal_scale: OptimalScaleParams,
    /// The clouds that are registered.
    pub cloud: KeyframeCloudParams,
    /// Their registration.
    pub icp: IcpParams,
    /// Refinement on the images.
    pub direct: Sim3AlignParams,
    /// How far two pairs' poses may honestly differ beyond their stated uncertainty, because the maps drift between
    /// neighbouring keyframes: translation in parts of the translation's own reach (the keyframes' median depth),
    /// rotation in radians, scale in parts. Default 0.01, 0.005 and 0.01; above 0.
    pub drift: [f64; 3],
    /// Largest standard deviations of a pair that may agree with others: translation in parts of the keyframes' median
    /// depth, rotation in radians, scale in parts. Default 0.1, 0.02 (1.1°) and 0.1; above 0. A pair known worse agrees
    /// with nearly anything.
    pub max_deviation: [f64; 3],
    /// Largest χ² of two pairs that agree, 7 degrees of freedom. Default 24.3, the 99.9 % quantile; 14 to 50.
    pub max_chi2: f64,
}

impl Default for ClosureParams {
    fn default() -> Self {
        Self {
            pair: PairParams::default(),
            neighbourhood: NeighbourhoodParams::default(),
            pairing: PairingParams::default(),
            optimal_scale: OptimalScaleParams::default(),
            cloud: KeyframeCloudParams::default(),
            icp: IcpParams::default(),
            // The starts are good to a few pixels: no coarse levels. The alignments' deviations are those of
            // keyframes of one run; between two recordings of hand-held cameras right ones are up to 6.8 of them apart,
            // and wrong ones no farther. So this gate is wide, and the acceptance test tells right from wrong.
            direct: Sim3AlignParams {
                coarsest_level: 2,
                max_reciprocal_error: 12.0,
                max_points: 3000,
                ..Sim3AlignParams::default()
            },
            drift: [0.01, 0.005, 0.01],
            max_deviation: [0.1, 0.02, 0.1],
            max_chi2: 24.3,
        }
    }
}
