//! The methods that the paper compares Loop-box with (§V-B, Table I, Appendix A), and Loop-box as the paper has it.
//!
//! All start from the same accepted closure with its pairs z = −1, 0, 1, S_z of the source and T_z of the target, so
//! that methods are compared on the same meeting; the closure's acceptance guards them as it guards Loop-box. All
//! measure these pairs anew, from the matched key points on, so that the time of a method is its own. Each ends with
//! one transformation between two keyframes, by which the maps are joined rigidly.
//!
//! | method | what it does |
//! |---|---|
//! | `pcr-pro` | R of the eight-point algorithm and σ, t of the Kalman filter, of the centre pair alone |
//! | `pgo-straight` | PCR-Pro and ICP of each pair S_z–T_z; a pose graph over the six keyframes |
//! | `pgo-full` | the same with the cross pairs S₂–T₁, S₁–T₂, S₃–T₂, S₂–T₃ (1, 2, 3 for z = −1, 0, 1) |
//! | `pgo-top` | the one transformation of the pair of most matches for all poses; then a pose graph |
//! | `loop-box` | the paper: σ* by Algorithm 1, initial guess of the pair of most matches, ICP and its information |
//! | `direct` | the default: pairs refined on their images, their agreement, further closures, joint graph |
//!
//! What the paper leaves open, as we read it:
//! - *PCR-Pro* is "applied directly to the first match" (Fig. 7) and gives an initial guess (§IV-C1): no ICP.
//! - *What a pose graph optimises*: the poses of the three keyframes of either agent (Fig. 11). Its edges are those of
//!   the maps among these keyframes, with the maps' information, and those between the agents. The latter alone would
//!   leave the straight configuration nothing to weigh: every target pose would have one edge of its own.
//! - *What becomes of the maps*: "we use the middle poses of S2 and T2". How the centre keyframes stand to each other
//!   after the optimisation moves the whole map, as Table I measures a relative pose. We do so in all three
//!   configurations.
//! - *Edges between the agents*: R, t and σ_z of PCR-Pro, then ICP (the "3-D-closed-form solution" and
//!   libpointmatcher). Their information is Eq. 2–3 of the ICP in six degrees of freedom; in the seventh, for which
//!   the paper scales the poses beforehand, the variance of σ_z. Where ICP refuses, PCR-Pro's own estimate stands.
//! - *Cross pairs*: the paper lists {T2, S1″} twice; the four above are all that are one step apart.
//! - *Top matches*: with all edges computed from the one transformation there would be nothing left to optimise. So it
//!   places all poses, the clouds of each pair are registered from there, and these are the edges.
//! - *ICP* is point-to-point ("point-to-point matrix-based error", §IV-D2), and the pose graph plain least squares.
//! - *Loop-box of the paper*: σ* takes the place of the chosen pair's own σ, its R and t stay; ICP mends the rest.

mod graph;
mod measurement;
mod observed;
mod params;
mod refusal;
mod register;
mod solve;
#[cfg(test)]
mod tests;

pub use measurement::Measurement;
pub use observed::{Observed, ObservedPair, Side, observe};
pub use params::BaselineParams;
pub use refusal::MethodRefusal;
pub use solve::solve;

use crate::closure::Closure;
use crate::estimate::Estimate;
use crate::further::Joined;
use crate::prepared::PreparedMap;
use map::{Edge, EdgeKind, KeyframeId};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// How two maps are joined at a closure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The first match alone.
    PcrPro,
    /// Pose graph over the three direct pairs.
    PgoStraight,
    /// Pose graph over direct and cross pairs.
    PgoFull,
    /// Pose graph from the transformation of the pair of most matches.
    PgoTop,
    /// Loop-box as the paper has it.
    LoopBox,
    /// loopbox's own: all seven degrees of freedom from the images of all pairs that agree.
    #[default]
    Direct,
}

/// A method other than loopbox's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// [`Method::PcrPro`].
    PcrPro,
    /// The pose graphs.
    PoseGraph(Configuration),
    /// [`Method::LoopBox`].
    LoopBox,
}

/// Which edges a pose graph has between the agents (Appendix A).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Configuration {
    /// The direct pairs.
    Straight,
    /// Direct and cross pairs.
    Full,
    /// The direct pairs, all from the transformation of the one of most matches.
    Top,
}

/// How a baseline joins two maps: by one pair of keyframes, rigidly.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// Keyframe of the source.
    pub source: KeyframeId,
    /// Keyframe of the target.
    pub target: KeyframeId,
    /// How they stand to each other, in their camera frames and units.
    pub target_from_source: Estimate,
}

impl Method {
    /// All methods, in the order of the module's table.
    pub const ALL: [Self; 6] =
        [Self::PcrPro, Self::PgoStraight, Self::PgoFull, Self::PgoTop, Self::LoopBox, Self::Direct];

    /// What it is called.
    pub fn name(self) -> &'static str {
        match self {
            Self::PcrPro => "pcr-pro",
            Self::PgoStraight => "pgo-straight",
            Self::PgoFull => "pgo-full",
            Self::PgoTop => "pgo-top",
            Self::LoopBox => "loop-box",
            Self::Direct => "direct",
        }
    }

    /// The baseline that it is; nothing for loopbox's own method, which is [`closure`](crate::closure) and
    /// [`further`](crate::further). Maps joined by a baseline are to be moved as a whole, without a joint pose graph.
    pub fn baseline(self) -> Option<Baseline> {
        match self {
            Self::PcrPro => Some(Baseline::PcrPro),
            Self::PgoStraight => Some(Baseline::PoseGraph(Configuration::Straight)),
            Self::PgoFull => Some(Baseline::PoseGraph(Configuration::Full)),
            Self::PgoTop => Some(Baseline::PoseGraph(Configuration::Top)),
            Self::LoopBox => Some(Baseline::LoopBox),
            Self::Direct => None,
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Method {
    type Err = UnknownMethod;

    fn from_str(name: &str) -> Result<Self, UnknownMethod> {
        Self::ALL
            .into_iter()
            .find(|method| method.name() == name)
            .ok_or_else(|| UnknownMethod(name.to_owned()))
    }
}

/// A name that no method has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no method {0:?}; there are {names}", names = Method::ALL.map(Method::name).join(", "))]
pub struct UnknownMethod(String);

impl Baseline {
    /// Joins two maps by this method at a closure that was accepted.
    ///
    /// # Errors
    /// When its pairs cannot be measured or registered, or make no motion.
    pub fn place(
        self,
        source: &PreparedMap,
        target: &PreparedMap,
        closure: &Closure,
        params: &BaselineParams,
    ) -> Result<Placement, MethodRefusal> {
        solve(self, &observe(self, source, target, closure, params), params)
    }
}

impl Placement {
    /// As an edge between the maps, from the target's keyframe.
    pub fn edge(&self) -> Edge {
        Edge {
            from: self.target,
            to: self.source,
            from_from_to: self.target_from_source.a_from_b,
            information: self.target_from_source.information,
            kind: EdgeKind::Merge,
        }
    }
}

impl From<Placement> for Joined {
    /// The one edge, and nothing that was compared with it.
    fn from(placement: Placement) -> Self {
        Self { edges: vec![placement.edge()], ..Self::nothing() }
    }
}
