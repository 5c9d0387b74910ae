//! Whether a closure may be believed: no merge that is wrong may pass.
//!
//! The paper takes every closure that place recognition proposes. A wrong one ruins both maps, so ours must pass
//! every line of this test; the verdict keeps all numbers. Each line rests on evidence the others do not see:
//!
//! | line | what it catches |
//! |---|---|
//! | matches γ over the agreeing pairs | images that share a thing or two |
//! | at least two keyframe pairs agree on the motion | one view that looks alike by chance |
//! | pixels that agree after direct alignment, both ways | places of the same shape with other texture, and the reverse |
//! | that share of all pixels, seen by both or not | things that repeat, shifted by one |
//! | standard deviations of rotation and scale (χ² of the information) | closures that are right and useless |

use crate::closure::{Closure, PairOutcome};
use crate::direct::DirectAlignment;
use nalgebra::{SMatrix, Vector3};
use serde::{Deserialize, Serialize};

/// What a closure must show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AcceptanceParams {
    /// Fewest matches γ over all agreeing pairs. Default 60; 16 or more.
    pub min_matches: usize,
    /// Fewest keyframe pairs that agree on the motion. Default 2; 1 to 3.
    pub min_pairs: usize,
    /// Least share of pixels with depth that agree in intensity and depth after direct alignment, the best of the
    /// agreeing pairs. Default 0.6; 0 to 1.
    pub min_inlier_share: f32,
    /// Least product of that share with the overlap, the share of pixels with depth that the other keyframe sees at
    /// all, of the same pair. Default 0.25; 0 to 1. Things that repeat (a fence, cars of one make) agree over a part
    /// of the view when shifted by one; the same place agrees over most of what both see.
    pub min_agreeing_share: f32,
    /// Largest standard deviation of the rotation, degrees. Default 0.35; above 0. A turn by that moves what is
    /// 10 m away by 6 cm.
    pub max_rotation_deviation: f64,
    /// Largest standard deviation of the scale, parts. Default 0.03; above 0.
    pub max_scale_deviation: f64,
}

impl Default for AcceptanceParams {
    fn default() -> Self {
        Self {
            min_matches: 60,
            min_pairs: 2,
            min_inlier_share: 0.6,
            min_agreeing_share: 0.25,
            max_rotation_deviation: 0.35,
            max_scale_deviation: 0.03,
        }
    }
}

/// The numbers a verdict rests on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// γ over the agreeing pairs.
    pub matches: usize,
    /// Keyframe pairs that agree on the motion.
    pub pairs: usize,
    /// Share of agreeing pixels after direct alignment, best pair, 0–1; 0 where no pair could be aligned.
    pub inlier_share: f32,
    /// Overlap of the same pair, 0–1.
    pub overlap: f32,
    /// Standard deviation of the rotation, degrees.
    pub rotation_deviation: f64,
    /// Standard deviation of the scale, parts.
    pub scale_deviation: f64,
}

/// Why a closure is not believed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Doubt {
    /// Too few matches.
    #[error("only {matches} key points match over the pairs that agree; {needed} are needed")]
    FewMatches {
        /// γ over the agreeing pairs.
        matches: usize,
        /// γ needed.
        needed: usize,
    },
    /// Nothing confirms the one pair.
    #[error("only {pairs} keyframe pair gives this motion of the maps; {needed} must agree")]
    Unconfirmed {
        /// Pairs that agree.
        pairs: usize,
        /// Pairs needed.
        needed: usize,
    },
    /// The images do not fit at the motion found.
    #[error("{share:.2} of the pixels with depth agree once the keyframes are aligned; {needed:.2} must")]
    Unlike {
        /// Share that agrees.
        share: f32,
        /// Share needed.
        needed: f32,
    },
    /// Too little of the images fits.
    #[error(
        "{share:.2} of all pixels with depth agree, the others do not or lie outside the other's view; {needed:.2} \
         are needed: things that repeat look like that"
    )]
    LittleAgrees {
        /// Share that agrees.
        share: f32,
        /// Share needed.
        needed: f32,
    },
    /// The motion is known too badly.
    #[error("the motion is known to {rotation:.2}° and {scale:.3} of the scale only")]
    Vague {
        /// Standard deviation of the rotation, degrees.
        rotation: f64,
        /// Standard deviation of the scale, parts.
        scale: f64,
    },
}

/// The numbers of a closure.
pub fn evidence(closure: &Closure) -> Evidence {
    let matches = |pair: &PairOutcome| pair.measured.as_ref().map_or(0, |p| p.views.match_count());
    let direct = |pair: &PairOutcome| -> Option<DirectAlignment> { pair.direct.clone()?.ok() };
    let best = closure.agreeing().filter_map(direct).max_by(|a, b| a.inlier_share.total_cmp(&b.inlier_share));
    // At the keyframes: seen from the worlds' origins a turn shifts everything.
    let covariance = closure.motion.information.try_inverse().unwrap_or(SMatrix::repeat(f64::INFINITY));
    let variances: Vector3<f64> = covariance.fixed_view::<3, 3>(3, 3).diagonal();
    Evidence {
        matches: closure.agreeing().map(matches).sum(),
        pairs: closure.agreeing().count(),
        inlier_share: best.as_ref().map_or(0.0, |best| best.inlier_share),
        overlap: best.as_ref().map_or(0.0, |best| best.overlap),
        rotation_deviation: variances.max().sqrt().to_degrees(),
        scale_deviation: covariance[(6, 6)].sqrt(),
    }
}

/// Whether the evidence suffices; else the first line it fails.
pub fn judge(evidence: &Evidence, params: &AcceptanceParams) -> Result<(), Doubt> {
    if evidence.pairs < params.min_pairs {
        return Err(Doubt::Unconfirmed { pairs: evidence.pairs, needed: params.min_pairs });
    }
    if evidence.matches < params.min_matches {
        return Err(Doubt::FewMatches { matches: evidence.matches, needed: params.min_matches });
    }
    // Written so that a NaN is refused.
    let alike = evidence.inlier_share >= params.min_inlier_share;
    if !alike {
        return Err(Doubt::Unlike { share: evidence.inlier_share, needed: params.min_inlier_share });
    }
    let share = evidence.inlier_share * evidence.overlap;
    let enough = share >= params.min_agreeing_share;
    if !enough {
        return Err(Doubt::LittleAgrees { share, needed: params.min_agreeing_share });
    }
    let known = evidence.rotation_deviation <= params.max_rotation_deviation
        && evidence.scale_deviation <= params.max_scale_deviation;
    if !known {
        return Err(Doubt::Vague { rotation: evidence.rotation_deviation, scale: evidence.scale_deviation });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evidence that passes every line, just.
    const ENOUGH: Evidence = Evidence {
        matches: 60,
        pairs: 2,
        inlier_share: 0.6,
        overlap: 0.42,
        rotation_deviation: 0.35,
        scale_deviation: 0.03,
    };

    fn verdict(evidence: Evidence) -> Result<(), Doubt> {
        judge(&evidence, &AcceptanceParams::default())
    }

    #[test]
    fn what_is_enough_passes() {
        assert_eq!(verdict(ENOUGH), Ok(()));
    }

    #[test]
    fn each_line_alone_refuses() {
        let refused = [
            (Evidence { pairs: 1, ..ENOUGH }, Doubt::Unconfirmed { pairs: 1, needed: 2 }),
            (Evidence { matches: 59, ..ENOUGH }, Doubt::FewMatches { matches: 59, needed: 60 }),
            (Evidence { inlier_share: 0.59, ..ENOUGH }, Doubt::Unlike { share: 0.59, needed: 0.6 }),
            (Evidence { overlap: 0.4, ..ENOUGH }, Doubt::LittleAgrees { share: 0.6 * 0.4, needed: 0.25 }),
            (Evidence { rotation_deviation: 0.36, ..ENOUGH }, Doubt::Vague { rotation: 0.36, scale: 0.03 }),
            (Evidence { scale_deviation: 0.031, ..ENOUGH }, Doubt::Vague { rotation: 0.35, scale: 0.031 }),
        ];
        for (evidence, doubt) in refused {
            assert_eq!(verdict(evidence), Err(doubt));
        }
    }

    /// What could not be computed is no evidence.
    #[test]
    fn what_is_no_number_refuses() {
        for evidence in [
            Evidence { inlier_share: f32::NAN, ..ENOUGH },
            Evidence { overlap: f32::NAN, ..ENOUGH },
            Evidence { rotation_deviation: f64::NAN, ..ENOUGH },
            Evidence { scale_deviation: f64::NAN, ..ENOUGH },
            Evidence { rotation_deviation: f64::INFINITY, ..ENOUGH },
        ] {
            assert!(verdict(evidence).is_err(), "{evidence:?}");
        }
    }

    #[test]
    fn a_doubt_says_what_is_missing() {
        let doubt = verdict(Evidence { matches: 31, ..ENOUGH }).unwrap_err();
        assert_eq!(doubt.to_string(), "only 31 key points match over the pairs that agree; 60 are needed");
    }
}
