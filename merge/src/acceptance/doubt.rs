//! What keeps a closure from being believed, in words.

use serde::{Deserialize, Serialize};

/// Why a closure is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum Doubt {
    /// Nothing confirms the one pair.
    #[error("only {pairs} keyframe pair gives this motion of the maps; {needed} must agree")]
    Unconfirmed {
        /// Pairs that agree.
        pairs: usize,
        /// Pairs needed.
        needed: usize,
    },
    /// Too few matches.
    #[error("only {matches} key points match over the pairs that agree; {needed} are needed")]
    FewMatches {
        /// γ over the agreeing pairs.
        matches: usize,
        /// γ needed.
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
    #[error(
        "the motion is known to {rotation:.2}°, {translation:.3} of the scene's depth and {scale:.3} of the scale only"
    )]
    Vague {
        /// Standard deviation of the rotation, degrees.
        rotation: f64,
        /// Standard deviation of the translation, parts of the scene's depth.
        translation: f64,
        /// Standard deviation of the scale, parts.
        scale: f64,
    },
    /// The maps do not fit beyond the place.
    #[error(
        "only {confirmed} of {tested} other keyframe pairs that would see the same by this motion do; {needed:.0} % \
         must"
    )]
    Alone {
        /// Pairs that were aligned and agree.
        confirmed: usize,
        /// Pairs tried.
        #[serde(rename = "tried")]
        tested: usize,
        /// Percentage needed.
        needed: f64,
    },
    /// Keyframes see through what others see.
    #[error(
        "keyframes look through {share:.2} of the points that others see there by this motion; {limit:.2} at most may be"
    )]
    SeenThrough {
        /// Share looked through.
        share: f64,
        /// Largest share.
        limit: f64,
    },
    /// Keyframes lack what others see.
    #[error(
        "{share:.2} of what keyframes see is missing in others by this motion; {limit:.2} at most may be"
    )]
    Missing {
        /// Share that is missing.
        share: f64,
        /// Largest share.
        limit: f64,
    },
    /// What both saw of the surface is likelier of two places.
    #[error(
        "{percent:.0} % of the things that both see differ, and e^{against:.0} times likelier these are two places that share the rest \
         than one"
    )]
    Double {
        /// Share of the things that differ, percent.
        percent: f64,
        /// ln of how much likelier two places are.
        against: f64,
    },
    /// What both saw of the surface does not tell.
    #[error(
        "what both maps see does not tell one place from two that share things: {percent:.1} % of it differs, and one place is \
         e^{ln_ratio:.1} times as likely as two"
    )]
    CannotTell {
        /// Share of the things that differ, percent.
        percent: f64,
        /// ln of how much likelier one place is.
        ln_ratio: f64,
    },
    /// Things that one map has and the other has not.
    #[error(
        "{share:.4} of what keyframes see, in {views} views, is not there in the other map, which looks through it; \
         {limit:.4} at most may be: another place that looks alike, or something moved"
    )]
    Absent {
        /// Views with something that is not there.
        views: usize,
        /// Share of the points whose patches are looked through.
        share: f64,
        /// Largest share.
        limit: f64,
    },
    /// Surfaces that look otherwise.
    #[error(
        "{share:.3} of what keyframes see, in {views} views, looks otherwise in the other map where all else looks alike; \
         {limit:.3} at most may: another place that looks alike, or something changed"
    )]
    OtherLook {
        /// Views with something that looks otherwise.
        views: usize,
        /// Share of the points whose patches look otherwise.
        share: f64,
        /// Largest share.
        limit: f64,
    },
    /// Things that are not there and surfaces that look otherwise, both fewer than alone would tell.
    #[error(
        "{absent:.4} of what keyframes see is not there in the other map and {unlike:.3} looks otherwise: together {sum:.2} of \
         what may; another place that looks alike, or something changed"
    )]
    AbsentAndOtherLook {
        /// Share of the points whose patches are looked through.
        absent: f64,
        /// Share of the points whose patches look otherwise.
        unlike: f64,
        /// The sum of both, each over its limit.
        sum: f64,
    },
    /// Something differs in view after view.
    #[error(
        "of {views} views of one map's keyframes in the other's {absent} lack something and in {unlike} something looks otherwise, \
         a share of {share:.2}; {limit:.2} at most may: another place that looks alike, or something changed"
    )]
    InManyViews {
        /// Views compared.
        views: usize,
        /// Those with something that is not there.
        absent: usize,
        /// Those with something that looks otherwise.
        unlike: usize,
        /// Their share, the mean of both.
        share: f64,
        /// Largest share.
        limit: f64,
    },
    /// Another motion is nearly as good.
    #[error(
        "{closures} closures agree on this motion and {rival} on another: too few to tell which is right"
    )]
    Rival {
        /// Closures that agree on the motion.
        closures: usize,
        /// Closures that agree on another.
        rival: usize,
    },
    /// Another place matches nearly as well.
    #[error(
        "another place that would lay the maps otherwise has {share:.2} of the matches of this one; {limit:.2} at most may be: \
         things that repeat look like that"
    )]
    OtherPlace {
        /// Its share of the matches.
        share: f64,
        /// Largest share.
        limit: f64,
    },
}

impl Doubt {
    /// Whether places look alike that are not the same: by things that one has and the other has not, or as more than one
    /// matches.
    pub fn is_similar_place(&self) -> bool {
        match self {
            // Without anything that differs there was too little to see.
            Self::CannotTell { percent, .. } => *percent > 0.0,
            Self::Absent { .. }
            | Self::OtherLook { .. }
            | Self::AbsentAndOtherLook { .. }
            | Self::InManyViews { .. }
            | Self::OtherPlace { .. } => true,
            _ => false,
        }
    }
}
