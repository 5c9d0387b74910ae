//! The graph of merges: who was merged with whom, and so where everybody's world lies (Loop-box, §V-D).
//!
//! Agents are the nodes, accepted merges the edges. The maximum spanning tree by confidence gives every agent's
//! place: each agent is reached over the merges that are trusted most, and two that never met over those who met
//! both. Agents that no merge joins stay apart, each [`Component`] in a frame of its own. Nothing is kept but
//! agents and merges, so that a merge taken back leaves no trace.

pub mod rigid;
#[cfg(test)]
mod tests;
mod tree;

use crate::estimate::Estimate;
use geometry::Sim3;
use map::AgentId;
use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use thiserror::Error;

/// Names a merge within its graph; never used again for another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MergeId(pub u32);

/// An accepted merge of two agents' maps.
#[derive(Clone, Debug, PartialEq)]
pub struct Merge {
    /// The one agent.
    pub from: AgentId,
    /// The other agent.
    pub to: AgentId,
    /// Maps points of `to`'s world, in its unit, into `from`'s; with a positive definite information.
    pub from_from_to: Estimate,
    /// How far it is trusted against other merges, > 0; [`confidence`] makes one of the information.
    pub confidence: f64,
}

/// Agents and the merges that join them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergeGraph {
    agents: BTreeSet<AgentId>,
    merges: BTreeMap<MergeId, Accepted>,
    next: u32,
}

/// A merge that was checked.
#[derive(Clone, Debug, PartialEq)]
struct Accepted {
    merge: Merge,
    /// The inverse of its information.
    covariance: SMatrix<f64, 7, 7>,
}

/// Agents that merges join, in the frame of one of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Component {
    /// The agent whose world is the common frame: the one of smallest id.
    pub root: AgentId,
    /// Every agent of the component and where it is, the root included.
    pub agents: BTreeMap<AgentId, Placement>,
    /// The merges of the spanning tree, ascending.
    pub tree: Vec<MergeId>,
    /// The other merges within the component, ascending: they say again what the tree says already.
    pub spare: Vec<MergeId>,
}

/// Where an agent's world lies in the frame of its component.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// Maps points of the agent's world, in its unit, into the root's.
    pub root_from_agent: Sim3,
    /// Covariance of the left perturbation `true = exp(ε) ∘ root_from_agent`, tangent order (υ, ω, λ): the sum
    /// of those of the merges on the way, each carried into the root's frame, as if they were independent.
    /// Zero for the root.
    pub covariance: SMatrix<f64, 7, 7>,
    /// The merges on the way from the root; as many as there are hops.
    pub path: Vec<MergeId>,
    /// The smallest confidence on the way; infinite for the root.
    pub confidence: f64,
}

/// Why a merge cannot stand in the graph.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum MergeGraphError {
    /// An agent is not in the graph.
    #[error("agent {} is not in the graph of merges; add it before its merges", .0.0)]
    UnknownAgent(AgentId),
    /// Both ends are one agent.
    #[error("the merge joins agent {} with itself; a loop within one map is no merge", .0.0)]
    SameAgent(AgentId),
    /// The similarity is not finite or its scale not positive.
    #[error("the merge of agents {} and {} has no finite similarity; leave it out", .from.0, .to.0)]
    InvalidSimilarity {
        /// The one agent.
        from: AgentId,
        /// The other agent.
        to: AgentId,
    },
    /// The information is not finite, not symmetric or not positive definite.
    #[error(
        "the information of the merge of agents {} and {} is no inverse of a covariance; a merge must fix all \
         seven degrees of freedom", .from.0, .to.0
    )]
    InvalidInformation {
        /// The one agent.
        from: AgentId,
        /// The other agent.
        to: AgentId,
    },
    /// The confidence is not a positive finite number.
    #[error("the confidence of the merge of agents {} and {} is {confidence}, not a positive number", .from.0, .to.0)]
    InvalidConfidence {
        /// The one agent.
        from: AgentId,
        /// The other agent.
        to: AgentId,
        /// What was given.
        confidence: f64,
    },
}

impl MergeGraph {
    /// A graph without agents.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an agent that nothing joins yet; false when it was there.
    pub fn add_agent(&mut self, agent: AgentId) -> bool {
        self.agents.insert(agent)
    }

    /// Adds a merge of two agents of the graph. The same two may have several.
    pub fn add_merge(&mut self, merge: Merge) -> Result<MergeId, MergeGraphError> {
        let covariance = self.check(&merge)?;
        let id = MergeId(self.next);
        self.next += 1;
        self.merges.insert(id, Accepted { merge, covariance });
        Ok(id)
    }

    /// The agents, ascending.
    pub fn agents(&self) -> impl Iterator<Item = AgentId> + '_ {
        self.agents.iter().copied()
    }

    /// The merges by name, in the order in which they were added.
    pub fn merges(&self) -> impl Iterator<Item = (MergeId, &Merge)> {
        self.merges.iter().map(|(id, accepted)| (*id, &accepted.merge))
    }

    /// The agents that hang together and where each of them is, by ascending root.
    ///
    /// Of merges equally trusted the one between the agents of smaller ids counts as trusted more, and between
    /// the same agents the one added first.
    pub fn components(&self) -> Vec<Component> {
        tree::components(&self.agents, &self.merges)
    }

    /// The covariance of a merge that may stand in the graph.
    fn check(&self, merge: &Merge) -> Result<SMatrix<f64, 7, 7>, MergeGraphError> {
        let Merge { from, to, from_from_to, confidence } = *merge;
        if let Some(missing) = [from, to].into_iter().find(|agent| !self.agents.contains(agent)) {
            return Err(MergeGraphError::UnknownAgent(missing));
        }
        if from == to {
            return Err(MergeGraphError::SameAgent(from));
        }
        if !from_from_to.a_from_b.is_valid() {
            return Err(MergeGraphError::InvalidSimilarity { from, to });
        }
        if !(confidence.is_finite() && confidence > 0.0) {
            return Err(MergeGraphError::InvalidConfidence { from, to, confidence });
        }
        covariance(&from_from_to.information).ok_or(MergeGraphError::InvalidInformation { from, to })
    }
}

/// How far a merge is trusted by its information: one over the share of `extent` by which points `extent` away from
/// `centre` are misplaced, root mean square over all directions. Both are of `from`'s world: the middle and the
/// radius of what the two maps share, say.
///
/// It has no unit, so that merges between maps of any units compare. `None` where the information is that of
/// no merge.
pub fn confidence(from_from_to: &Estimate, centre: &Vector3<f64>, extent: f64) -> Option<f64> {
    let to_centre = Sim3::new(UnitQuaternion::identity(), -centre, 1.0);
    let carried = from_from_to.carried(&to_centre, &Sim3::identity())?;
    let variance = covariance(&carried.information)?.diagonal();
    // A point p moves by υ + ω × p + λ p; over all directions of p the parts do not mix.
    let shift = variance.fixed_rows::<3>(0).sum() / (extent * extent);
    let rotation = variance.fixed_rows::<3>(3).sum() * 2.0 / 3.0;
    let confidence = 1.0 / (shift + rotation + variance[6]).sqrt();
    (confidence.is_finite() && confidence > 0.0).then_some(confidence)
}

/// The covariance of an information; `None` unless it is finite, symmetric and positive definite.
fn covariance(information: &SMatrix<f64, 7, 7>) -> Option<SMatrix<f64, 7, 7>> {
    let finite = information.iter().all(|value| value.is_finite());
    let symmetric = (information - information.transpose()).amax() <= 1e-6 * information.amax();
    let inverse = if finite && symmetric { information.cholesky()?.inverse() } else { return None };
    inverse.iter().all(|value| value.is_finite()).then_some(inverse)
}
