//! What a closure must show.

use serde::{Deserialize, Serialize};

/// What a closure must show. Every limit is a share, an angle or a count: none depends on the camera or on a map's
/// unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AcceptanceParams {
    /// Fewest matches γ over all agreeing pairs. Default 60; 16 or more.
    pub min_matches: usize,
    /// Fewest keyframe pairs that agree on the motion. Default 2; 1 to 3.
    pub min_pairs: usize,
    /// Least share of pixels with depth that agree in intensity and depth after direct alignment, mean of the
    /// agreeing pairs. Default 0.6; 0 to 1.
    pub min_inlier_share: f32,
    /// The same for a closure of keyframes matched together, which no pair of them alone speaks for, and of which more are
    /// tried. Default 0.7; 0 to 1. Other houses over the same pavement reach 0.61.
    pub min_pooled_inlier_share: f32,
    /// Least product of that share with the overlap, the share of pixels with depth that the other keyframe sees at
    /// all, mean of the agreeing pairs. Default 0.25; 0 to 1. Things that repeat (a fence, cars of one make) agree
    /// over a part of the view when shifted by one; the same place agrees over most of what both see.
    #[serde(rename = "min_agreeing_share")]
    pub min_total_inlier_share: f32,
    /// Least share of the further keyframe pairs that should overlap by the motion whose images can be aligned from
    /// there. Default 0.75; 0 to 1. Of right closures on our maps 7 or 8 of 8 can; of the wrong one that came closest,
    /// past other houses over the same pavement, 5.
    pub min_aligned_share: f64,
    /// Least share of them that are aligned and agree with the closures that are believed. Default 0.5; 0 to 1. Maps
    /// that drift lose some: of right ones of a hand-held camera 5 of 8 agree.
    pub min_confirmed_share: f64,
    /// Largest share of points with known depths that the other keyframe looks through. Default 0.05; 0 to 1.
    pub max_through_share: f64,
    /// Largest share of points seen whose contrast is missing in the other keyframe. Default 0.1; 0 to 1.
    pub max_missing_share: f64,
    /// Largest share of points around which the other keyframe looks through all and shows something else. Default 0.0014; 0 to 1. Of
    /// right closures, held by hand or rendered, 0.0009 at most; past equal houses with other things before them up to 0.012.
    pub max_absent_share: f64,
    /// Largest share of points around which the other keyframe looks otherwise as nowhere else. Default 0.01; 0 to 1.
    /// Of right closures 0.005 at most; past the same houses 0.002 to 0.02, in corridors of equal doors with other notices more.
    pub max_unlike_share: f64,
    /// Largest share of the views, of one keyframe in another, with something of either sort, the mean of both sorts. Default
    /// 0.375; 0 to 1. Of 123 right closures of recordings 0.19 at most, but for one of three keyframe pairs with 0.33, of
    /// rendered ones 0.11; in corridors of equal doors with other notices, where little differs and always the same, 0.52 and
    /// more.
    pub max_differing_share: f64,
    /// Fewest views, of one keyframe in another, in which either must be. Default 3; 1 or more. A thing that is not there is
    /// missing in every view of it; in one or two, depths may be wrong.
    pub min_views: usize,
    /// Largest set of closures that agree with each other on another motion, as a share of the set that is believed.
    /// Default 0.5; 0 to 1. At 1 two motions are as likely.
    pub max_rival_share: f64,
    /// Most matches of a place that speaks for another motion, over those of the one that speaks most for this. Default 0.75; 0
    /// to 1. Past equal houses 24 wrong closures that all other lines let pass have 0.76 and more, the 20 right ones 0.46 to
    /// 0.72; right ones elsewhere 0.73 at most, but for one car park.
    pub max_rival_place: f64,
    /// Least share of the things both maps see that differ, from which on surface that does not tell one place from two leaves the
    /// closure open, whatever all other lines say. Default 0.1; 0 to 1, 0 for always. Below, patches that look otherwise stand
    /// out of all others, which the lines for them see; where more differs they do not. Of 12 right pairs of recordings 0.084 at most,
    /// of façades whose every window differs 0.287.
    #[serde(rename = "min_untold_change")]
    pub min_undecided_change: f64,
    /// Probability of one place, by the surface alone, below which surface that does not tell leaves the closure open, whatever all other
    /// lines say. Default 0.33; 0 to 1, 0 for never: two places are then twice as likely. Doubles pass the other lines as one place does.
    /// Of rendered places whose surface does not tell and differs little, it keeps out 7 of 13 doubles and 2 of 15 right pairs; of right
    /// pairs of recordings none.
    pub min_undecided_probability: f64,
    /// Least share of the things both maps see whose wear agrees, from which on surface that tells one place by a grain of its own outweighs
    /// what differs. Default 0.1; 0 to 1. Below, as in a shop's aisle, what little wear there is may be the faint print of goods, which two
    /// places share; print is on a tenth of what is bare, and grain all over it.
    pub min_inlier_wear: f64,
    /// Largest standard deviation of the rotation, degrees. Default 0.35; above 0. A turn by that moves what is
    /// 10 m away by 6 cm.
    pub max_rotation_deviation: f64,
    /// Largest standard deviation of the translation where the keyframes are, parts of the scene's median depth.
    /// Default 0.03; above 0.
    pub max_translation_deviation: f64,
    /// Largest standard deviation of the scale, parts. Default 0.03; above 0.
    pub max_scale_deviation: f64,
}

impl Default for AcceptanceParams {
    fn default() -> Self {
        Self {
            min_matches: 60,
            min_pairs: 2,
            min_inlier_share: 0.6,
            min_pooled_inlier_share: 0.7,
            min_total_inlier_share: 0.25,
            min_aligned_share: 0.75,
            min_confirmed_share: 0.5,
            max_through_share: 0.05,
            max_missing_share: 0.1,
            max_absent_share: 0.0014,
            max_unlike_share: 0.01,
            max_differing_share: 0.375,
            min_views: 3,
            max_rival_share: 0.5,
            max_rival_place: 0.75,
            min_undecided_change: 0.1,
            min_undecided_probability: 0.33,
            min_inlier_wear: 0.1,
            max_rotation_deviation: 0.35,
            max_translation_deviation: 0.03,
            max_scale_deviation: 0.03,
        }
    }
}
