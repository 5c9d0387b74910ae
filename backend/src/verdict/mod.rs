//! Whether two maps show one place or two that share things: a likelihood ratio over pieces of surface.
//!
//! A front end measures pieces of surface that both maps see at one relative pose, and says of each how much likelier what
//! both saw of it is if it is one surface than if it is another ([`Piece::ln_agreement`]). What that says of the *place*
//! is the same for every sensor and is weighed here. Of one place a few things have changed between the maps; a double
//! shares some things, those that are made in numbers, and has others of its own. So both hypotheses are one model, a share
//! `a` of the pieces that are the same in both maps, under other priors:
//!
//! * one place: of shapes and looks `a ~ Beta(1/m − 1, 1)`, where `m` is the share that is expected to have changed ([`Prior::changed`]), or with
//!   probability [`Prior::rearranged`] anything, `Beta(1, 1)`. Once more of the things is expected to have changed than of the wear
//!   ([`Prior::changed_wear`], for walls stay where things move), wear has a share of its own, in a double of one print too;
//! * a double: `a` is anything from nothing to all, `Beta(1, 1)`, or of looks, which are made in numbers, with probability
//!   [`Prior::copied`] nearly all; but of wear (grain, stains, how things lie), which is
//!   nowhere else, it shares [`Prior::shared_wear`] only, unless with probability [`Prior::printed`] what looks like wear is made
//!   in numbers too, and is shared as in one place or to any share, whichever explains it better.
//!
//! The likelihood of the pieces given `a` is the product of `(a·e^l + 1 − a)^w`: no piece says more than a change or a thing that is
//! shared explains. So shapes that agree say at most `ln 1/m`, looks at most `−ln copied`, wear that agrees at most `−ln printed` more, looks that differ at most
//! `−ln rearranged` against, however many they are. The ratio of both, integrated over `a`, falls with every piece that differs more.
//! Outlier mixtures of this form: Jaynes, *Probability Theory* (2003), §21.

mod weigh;

pub use weigh::{Weighed, explained, ln_ratio, weigh};

use crate::params;
use serde::{Deserialize, Serialize};

/// What is said of two maps. Only the first two join them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Answer {
    /// Both show one place.
    Same,
    /// Both show one place, and something in it has changed.
    SameChanged,
    /// One place or two that share things: what both saw does not tell.
    CannotTell,
    /// They show two places.
    Different,
}

impl Answer {
    /// Whether maps are joined by it.
    pub fn joins(self) -> bool {
        matches!(self, Self::Same | Self::SameChanged)
    }

    /// What is said of maps that are joined, where this is what their pieces of surface say and `changed` of the things in them, 0–1,
    /// differ. Where the pieces do not tell, other tests did.
    pub fn of_joined(self, changed: f64) -> Self {
        match self {
            Self::Same | Self::SameChanged => self,
            Self::CannotTell | Self::Different if changed > 0.0 => Self::SameChanged,
            Self::CannotTell | Self::Different => Self::Same,
        }
    }
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            Self::Same => "the same",
            Self::SameChanged => "the same, changed",
            Self::CannotTell => "cannot be told",
            Self::Different => "different",
        })
    }
}

/// What was measured of a piece of surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PieceKind {
    /// Its shape.
    Shape,
    /// How it looks: edges, print, what any thing of one make has.
    Look,
    /// Its wear: grain, stains, how small things lie, what no other has.
    Wear,
}

/// A connected piece of surface that both maps see, with what both saw of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Piece {
    /// What was measured.
    pub kind: PieceKind,
    /// Its share of all surface that both maps see, 0–1.
    pub share: f64,
    /// How many things it holds, 0 or more: its size over that of one thing, and 1 at least for a piece that differs by itself and for wear.
    /// A thousand pixels of one poster are one thing.
    pub things: f64,
    /// How often the like of it occurs in the two maps, itself included, 1 or more. What occurs in numbers is made in
    /// numbers, and all of its kind agree together.
    pub occurrences: f64,
    /// `ln p(what both saw | one surface) − ln p(the same | unrelated surfaces of these maps)`.
    pub ln_agreement: f64,
}

/// Probability that anything may have changed in a place of which nobody knows more.
const RARELY: f64 = 0.02;

params! {
    /// What is believed of changes and doubles before anything is seen.
    pub struct Prior {
        /// Days between the two maps. Range 0–100000.
        pub days_apart: f64 = 0.0,
        /// Expected share of things that have changed between two maps of one day. Range 1e-4–0.5. Same-day recordings of
        /// rooms in use differ in a cup or a chair among a thousand things.
        pub changed_at_once: f64 = 0.001,
        /// Expected share that has changed after very many days. Range 1e-4–0.5. A third of the things in rooms scanned
        /// again after weeks or months (Wald et al. 2019, 3RScan).
        pub changed_at_last: f64 = 0.33,
        /// Expected share of wear that has changed after days. Range 1e-4–0.5. Things are moved and walls stay; grain beside what
        /// looks otherwise does not count. Of rendered places of which 5 to 50 % was moved a hundredth of the wear differs.
        pub changed_wear: f64 = 0.02,
        /// Days after which all but 1/e of that has changed. Range 0.1–10000.
        pub days_of_change: f64 = 3.0,
        /// Probability that anything may have changed, however near in time. Range 1e-6–0.5: a room was cleared, goods were put
        /// in anew.
        pub rearranged: f64 = RARELY,
        /// Share of the things up to which `rearranged` holds where it is more than its default: where more differs, the place must be told even
        /// though hardly anything is expected to have changed. Range 0–1.
        pub rearranged_up_to: f64 = 1.0,
        /// Probability that what looks like wear is made in numbers: wallpaper, laminate, tiles of one print. Range 1e-6–0.5.
        pub printed: f64 = 0.01,
        /// Share of its wear that a double has in common with a place. Range 1e-6–0.5: the grain of prints of one picture. Of rendered doubles
        /// (façades, rooms with the same posters) some 0.15.
        pub shared_wear: f64 = 0.15,
        /// Probability that a double has all looks in common with a place, but for as few as change in one: halls, aisles and storeys of one make
        /// and stock. Range 0–0.5; looks that agree never say more than `−ln` of it.
        pub copied: f64 = 0.2,
        /// ln of how many pairs that fit in all else are one place, for each that is a double. Range 0–10.
        pub ln_odds: f64 = 2.2,
        /// Probability from which on an answer is given. Range 0.5–1.
        pub certainty: f64 = 0.99,
    }
}

impl Prior {
    /// What is believed where so much differs that nobody expects that the place was rearranged.
    fn of_much(&self) -> Self {
        Self { rearranged: self.rearranged.min(RARELY), ..self.clone() }
    }

    /// The share of things that is expected to have changed.
    pub fn changed(&self) -> f64 {
        let rest = (-self.days_apart / self.days_of_change).exp();
        (self.changed_at_last + (self.changed_at_once - self.changed_at_last) * rest).clamp(1e-4, 0.5)
    }

    /// What a log likelihood ratio says, where so large a share of the things has changed.
    pub fn answer(&self, ln_ratio: f64, changed: f64) -> Answer {
        let limit = self.ln_certainty();
        let ln_odds = ln_ratio + self.ln_odds;
        if ln_odds >= limit {
            if changed > 0.0 { Answer::SameChanged } else { Answer::Same }
        } else if ln_odds <= -limit {
            Answer::Different
        } else {
            // What is no number tells nothing.
            Answer::CannotTell
        }
    }

    /// ln of the odds from which on an answer is given.
    pub fn ln_certainty(&self) -> f64 {
        (self.certainty / (1.0 - self.certainty)).ln()
    }

    /// Probability that a pair with this log likelihood ratio shows one place.
    pub fn probability(&self, ln_ratio: f64) -> f64 {
        1.0 / (1.0 + (-ln_ratio - self.ln_odds).exp())
    }
}
