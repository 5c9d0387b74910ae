//! The tests of a merge, as figures beside their bounds.

use super::bounds::MOST;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A test of a merge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Test {
    /// Poses that pieces found, and pieces that come back to one.
    Pieces,
    /// Surfaces that both maps saw.
    Overlap,
    /// Pieces of surface that are there in both maps.
    #[serde(rename = "Agreeing")]
    InlierRatio,
    /// What agrees and what differs, weighed.
    Likelihood,
    /// Things that stand in one map and not in the other, where the likelihood does not tell.
    Absent,
    /// Small things that are shifted.
    Shifts,
    /// Surface that both maps saw, where the likelihood does not tell and it is not most of what they saw.
    Shared,
    /// Weak directions of the pose.
    Conditioning,
    /// Other poses that fit as well.
    Rivals,
}

/// A test's figure beside its bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// The test.
    pub test: Test,
    /// What was measured.
    pub value: f64,
    /// What it is held against.
    pub bound: f64,
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, bound) = (self.value, self.bound);
        match self.test {
            Test::Pieces => write!(f, "{value} independent pieces agree, {bound} are needed"),
            Test::Overlap => write!(f, "the maps overlap by {value:.2}, {bound} is needed"),
            Test::InlierRatio => {
                write!(f, "{value:.2} of the surface that both saw agrees, {bound} is needed")
            }
            Test::Likelihood => write!(
                f,
                "what both saw is e^{value:.1} times as likely if this is one place as if it is another that shares things with \
                 it; e^{bound:.1} is needed"
            ),
            Test::Absent => write!(
                f,
                "{value:.2} m² of surface in one piece are not there in the other map, which looks through them; {bound:.2} at \
                 most may be where too little is alike: another place that looks alike, or something moved"
            ),
            Test::Shifts => write!(
                f,
                "small things stand otherwise in so many places that e^{value:.1} speaks against one place seen twice; e^{bound:.1} at \
                 most may: another place built alike, or things moved"
            ),
            Test::Shared => write!(
                f,
                "both maps saw {value:.0} m² of surface, {bound} are needed where this is less than {} of what each saw and too \
                 little is alike: places that repeat are not told apart by it",
                MOST
            ),
            Test::Conditioning => write!(f, "{value} directions are weak, {bound} are allowed"),
            Test::Rivals => write!(f, "{value} other poses fit as well, {bound} are allowed"),
        }
    }
}
