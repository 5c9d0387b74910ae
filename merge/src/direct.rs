//! Direct refinement of a keyframe pair: photometric and depth residuals together over Sim(3).
//!
//! The paper registers clouds only. Aligning the images themselves (Engel 2014, §3.5) uses all pixels with depth,
//! on edges too, where a cloud's registration slides; it is done both ways, and both must undo each other.

use crate::estimate::Estimate;
use crate::prepared::PreparedKeyframe;
use backend::sim3_align::{AlignRefusal, Sim3AlignParams, Sim3Alignment, align_from, reciprocal};
use geometry::Sim3;
use serde::{Deserialize, Serialize};

/// A directly refined pair with its evidence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DirectAlignment {
    /// target_from_source.
    pub estimate: Estimate,
    /// Root mean square photometric residual, the worse of both ways, grey levels.
    pub rmse: f32,
    /// Share of the pixels with depth that agree, the worse of both ways, 0–1.
    pub inlier_share: f32,
    /// Share of the pixels with depth that the other keyframe sees, the worse of both ways, 0–1.
    pub overlap: f32,
    /// How far the alignments both ways are apart, standard deviations.
    pub reciprocal_error: f64,
}

/// Why a pair could not be refined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum DirectRefusal {
    /// The alignment one way failed.
    #[error("{0}")]
    Alignment(#[from] AlignRefusal),
    /// The alignments both ways contradict each other.
    #[error("the alignments both ways are {mahalanobis:.1} standard deviations apart")]
    Inconsistent {
        /// Their distance.
        mahalanobis: f64,
    },
}

/// Refines the best of several starts, target_from_source, on the images and depths of two keyframes.
pub fn refine_directly(
    source: &PreparedKeyframe,
    target: &PreparedKeyframe,
    starts: &[Sim3],
    params: &Sim3AlignParams,
) -> Result<DirectAlignment, DirectRefusal> {
    let back: Vec<Sim3> = starts.iter().map(Sim3::inverse).collect();
    let forward = align_from(source.view(), target.view(), starts, params)?;
    let backward = align_from(target.view(), source.view(), &back, params)?;
    let verdict = reciprocal(&forward, &backward, params)
        .ok_or(DirectRefusal::Inconsistent { mahalanobis: f64::INFINITY })?;
    if !verdict.consistent {
        return Err(DirectRefusal::Inconsistent { mahalanobis: verdict.mahalanobis });
    }
    let worse = |of: fn(&Sim3Alignment) -> f32| of(&forward).min(of(&backward));
    Ok(DirectAlignment {
        estimate: Estimate { a_from_b: verdict.a_from_b, information: verdict.information },
        rmse: forward.rmse.max(backward.rmse),
        inlier_share: worse(|alignment| alignment.inlier_share),
        overlap: worse(|alignment| alignment.overlap),
        reciprocal_error: verdict.mahalanobis,
    })
}
