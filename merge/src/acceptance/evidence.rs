//! The numbers that a verdict rests on.

use crate::closure::{Closure, PairOutcome};
use crate::direct::DirectAlignment;
use crate::further::Joined;
use backend::verdict::{self, Answer, Piece, PieceKind, Prior, Weighed};
use nalgebra::{SMatrix, Vector3};
use serde::{Deserialize, Serialize};

/// The numbers a verdict rests on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// γ over the agreeing pairs; of keyframes matched together, the key points of either map that agree, each once. Where
    /// these are too few to decide, with those of the further pairs that agree.
    pub matches: usize,
    /// Keyframe pairs that agree on the motion.
    pub pairs: usize,
    /// Whether it is of keyframes matched together, as no pair of them sufficed alone.
    pub pooled: bool,
    /// Share of agreeing pixels after direct alignment, mean of the agreeing pairs, 0–1; a pair that could not be
    /// aligned counts with 0.
    pub inlier_share: f32,
    /// Share of all pixels with depth that agree, mean of the same pairs, 0–1.
    #[serde(rename = "agreeing_share")]
    pub total_inlier_share: f32,
    /// Standard deviation of the rotation, degrees: by the closure and the further pairs that agree with it, as are the next two.
    pub rotation_deviation: f64,
    /// Standard deviation of the translation, the largest of three axes, parts of the scene's median depth.
    pub translation_deviation: f64,
    /// Standard deviation of the scale, parts.
    pub scale_deviation: f64,
    /// Share of the source's points that lie near a target point once the clouds are registered, 0–1; nothing where
    /// they could not be.
    pub icp_overlap: Option<f64>,
    /// ln of how often wrong matches would agree as well as the best of the pairs, or as all keyframes of the place together.
    pub ln_false_alarms: f64,
    /// What both maps saw of the surface there; nothing where the closure itself was not worth asking.
    pub place: Option<PlaceEvidence>,
    /// What the rest of both maps says; nothing where the closure itself was not worth asking.
    pub beyond: Option<Beyond>,
    /// Matches of the place that speaks most for another motion, over those of the one that speaks most for this
    /// ([`rival_share`](crate::rivals::rival_share)); nothing where it was not asked, as other lines decided.
    pub rival_place: Option<f64>,
}

/// What the rest of both maps says of a closure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beyond {
    /// Further keyframe pairs that should overlap and were tried.
    #[serde(rename = "tried")]
    pub tested: usize,
    /// Of these, those that were aligned and agree with the closure.
    pub confirmed: usize,
    /// Of these, those that could not be aligned.
    pub failed: usize,
    /// Closures in the set that is believed.
    pub closures: usize,
    /// Closures in the largest set that contradicts it and agrees in itself.
    pub rival: usize,
    /// Share of points with known depths that the other keyframe looks through, 0–1.
    pub through_share: f64,
    /// Share of points seen whose contrast is missing in the other keyframe, 0–1.
    pub missing_share: f64,
    /// Views, of the one keyframe of a pair in the other, that were compared patch by patch.
    pub views: usize,
    /// Of these, those with patches that are looked through as a whole and look otherwise.
    pub absent_views: usize,
    /// Share of all points that are the middle of such a patch, 0–1.
    pub absent_share: f64,
    /// Of the same, those with patches that look otherwise as no others of the view do.
    pub unlike_views: usize,
    /// Share of all points with contrast around them that are the middle of such a patch, 0–1.
    pub unlike_share: f64,
}

/// What both maps saw of the surface at a place ([`place_verdict`](crate::place_verdict)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaceEvidence {
    /// What follows.
    pub answer: Answer,
    /// `ln p(what both saw | one place) − ln p(the same | two places that share things)`.
    pub ln_ratio: f64,
    /// Probability that it is one place.
    pub probability: f64,
    /// Probability from which on that is believed.
    pub needed: f64,
    /// Share of the things, 0–1, that differ.
    pub changed: f64,
    /// How many things were compared.
    pub things: f64,
    /// Share of them, 0–1, that are wear which agrees.
    pub inlier_wear: f64,
    /// Share, 0–1, that is expected to differ in one place after the days between the maps.
    pub expected_change: f64,
    /// What of `ln_ratio` would be missing without wear, the surface that is nowhere else: above 0 it speaks for one place.
    pub own: f64,
    /// Probability that bare surface there has a grain of its own all over, which two places do not share.
    pub grain: f64,
}

impl PlaceEvidence {
    /// Of pieces weighed by a prior, on surface that has a grain of its own with a probability of `grain`.
    pub fn new(weighed: &Weighed, prior: &Prior, grain: f64) -> Self {
        let Weighed { answer, ln_ratio, changed, .. } = *weighed;
        let pieces = weighed.pieces.iter().map(|(piece, _)| *piece);
        let things_of = |of: &dyn Fn(&Piece) -> bool| -> f64 {
            pieces.clone().filter(of).map(|piece| piece.things).sum()
        };
        let things = things_of(&|_| true);
        let inlier_wear = things_of(&|piece| piece.kind == PieceKind::Wear && piece.ln_agreement > 0.0);
        let inlier_wear = if things > 0.0 { inlier_wear / things } else { 0.0 };
        let others = pieces.filter(|piece| piece.kind != PieceKind::Wear).collect::<Vec<_>>();
        let own = ln_ratio - verdict::ln_ratio(&others, prior);
        let (probability, needed) = (prior.probability(ln_ratio), prior.certainty);
        let expected_change = prior.changed();
        Self {
            answer,
            ln_ratio,
            probability,
            needed,
            changed,
            things,
            inlier_wear,
            expected_change,
            own,
            grain,
        }
    }
}

impl Evidence {
    /// The numbers of a closure, and of what it joined.
    pub fn new(closure: &Closure, joined: Option<&Joined>) -> Self {
        let pooled = closure.pooled;
        let matches = |pair: &PairOutcome| pair.measured.as_ref().map_or(0, |p| p.views.match_count());
        let direct = |pair: &PairOutcome| -> Option<DirectAlignment> { pair.direct.clone()?.ok() };
        let shares: Vec<[f32; 2]> = closure
            .consistent_pairs()
            .map(|pair| direct(pair).map_or([0.0; 2], |d| [d.inlier_share, d.inlier_share * d.overlap]))
            .collect();
        let mean = |of: usize| shares.iter().map(|share| share[of]).sum::<f32>() / shares.len().max(1) as f32;
        // At the keyframes: seen from the worlds' origins a turn shifts everything.
        let information = joined.map_or_else(SMatrix::zeros, |joined| joined.information);
        let covariance = (closure.at_keyframes.information + information).try_inverse();
        let covariance = covariance.unwrap_or(SMatrix::repeat(f64::INFINITY));
        let deviation = |first: usize| -> f64 {
            let variances: Vector3<f64> = covariance.fixed_view::<3, 3>(first, first).diagonal();
            variances.max().sqrt()
        };
        let by_chance = closure
            .consistent_pairs()
            .filter_map(|pair| Some(pair.measured.as_ref().ok()?.views.relative_pose.ln_false_alarms));
        Self {
            matches: pooled
                .map_or_else(|| closure.consistent_pairs().map(matches).sum(), |pooled| pooled.matches),
            pairs: closure.consistent_pairs().count(),
            pooled: closure.pooled.is_some(),
            inlier_share: mean(0),
            total_inlier_share: mean(1),
            rotation_deviation: deviation(3).to_degrees(),
            translation_deviation: deviation(0) / closure.reach,
            scale_deviation: covariance[(6, 6)].sqrt(),
            icp_overlap: closure.registration.as_ref().ok().map(|found| found.overlap),
            ln_false_alarms: pooled
                .map_or_else(|| by_chance.fold(0.0, f64::min), |pooled| pooled.ln_false_alarms),
            place: joined.and_then(|joined| joined.place.as_ref()).map(|place| place.evidence),
            beyond: joined.map(Beyond::new),
            rival_place: None,
        }
    }
}

impl Beyond {
    fn new(joined: &Joined) -> Self {
        Self {
            tested: joined.tested,
            confirmed: joined.confirmed,
            failed: joined.failed,
            closures: joined.edges.len(),
            rival: joined.rival,
            through_share: joined.seen.through_share(),
            missing_share: joined.seen.missing_share(),
            views: joined.patches.views,
            absent_views: joined.patches.absent_views,
            absent_share: joined.patches.absent_share(),
            unlike_views: joined.patches.unlike_views,
            unlike_share: joined.patches.unlike_share(),
        }
    }

    /// Share of the pairs tried that could be aligned; 1 where none should overlap.
    pub fn aligned_share(&self) -> f64 {
        if self.tested == 0 { 1.0 } else { 1.0 - self.failed as f64 / self.tested as f64 }
    }

    /// Share of the pairs tried that confirm the closure; 1 where none should overlap.
    pub fn confirmed_share(&self) -> f64 {
        if self.tested == 0 { 1.0 } else { self.confirmed as f64 / self.tested as f64 }
    }

    /// Share of the views with patches that are not there and of those with patches that look otherwise, the mean of both; 0
    /// without views.
    pub fn differing_share(&self) -> f64 {
        (self.absent_views + self.unlike_views) as f64 / (2 * self.views).max(1) as f64
    }

    /// The rival's size as a share of the set that is believed.
    pub fn rival_share(&self) -> f64 {
        self.rival as f64 / self.closures.max(1) as f64
    }
}
