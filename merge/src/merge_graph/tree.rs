//! The maximum spanning tree and the agents' places along it.

use super::{Accepted, Component, Merge, MergeId, Placement};
use geometry::Sim3;
use map::AgentId;
use nalgebra::SMatrix;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

type Matrix7 = SMatrix<f64, 7, 7>;
type Merges = BTreeMap<MergeId, Accepted>;

/// The components by ascending root; the merges were checked when they were added.
pub(super) fn components(agents: &BTreeSet<AgentId>, merges: &Merges) -> Vec<Component> {
    let tree = spanning(agents, merges);
    let mut touching: BTreeMap<AgentId, Vec<MergeId>> = BTreeMap::new();
    for id in &tree {
        let Merge { from, to, .. } = merges[id].merge;
        touching.entry(from).or_default().push(*id);
        touching.entry(to).or_default().push(*id);
    }
    let mut components: Vec<Component> = Vec::new();
    for &root in agents {
        if components.iter().any(|component| component.agents.contains_key(&root)) {
            continue;
        }
        let agents = places(root, &touching, merges);
        let within = merges.iter().filter(|(_, accepted)| agents.contains_key(&accepted.merge.from));
        let (tree, spare) = within.map(|(id, _)| *id).partition(|id| tree.contains(id));
        components.push(Component { root, agents, tree, spare });
    }
    components
}

/// The merges of the maximum spanning forest (Kruskal): the most trusted first, those that join what hangs
/// together already left out.
fn spanning(agents: &BTreeSet<AgentId>, merges: &Merges) -> BTreeSet<MergeId> {
    let mut order: Vec<(&MergeId, &Merge)> =
        merges.iter().map(|(id, accepted)| (id, &accepted.merge)).collect();
    let pair = |merge: &Merge| (merge.from.min(merge.to), merge.from.max(merge.to));
    order.sort_by(|(a_id, a), (b_id, b)| {
        b.confidence.total_cmp(&a.confidence).then(pair(a).cmp(&pair(b))).then(a_id.cmp(b_id))
    });
    // Every agent's group is named by one of it. Agents are few: renaming a group is as good as a forest of sets.
    let mut group: BTreeMap<AgentId, AgentId> = agents.iter().map(|&agent| (agent, agent)).collect();
    let mut tree = BTreeSet::new();
    for (&id, merge) in order {
        let (one, other) = (group[&merge.from], group[&merge.to]);
        if one != other {
            group.values_mut().filter(|name| **name == other).for_each(|name| *name = one);
            tree.insert(id);
        }
    }
    tree
}

/// The root's component along the tree.
fn places(
    root: AgentId,
    touching: &BTreeMap<AgentId, Vec<MergeId>>,
    merges: &Merges,
) -> BTreeMap<AgentId, Placement> {
    let at_root = Placement {
        root_from_agent: Sim3::identity(),
        covariance: SMatrix::zeros(),
        path: Vec::new(),
        confidence: f64::INFINITY,
    };
    let mut placed = BTreeMap::from([(root, at_root)]);
    let mut queue = VecDeque::from([root]);
    while let Some(here) = queue.pop_front() {
        for id in touching.get(&here).into_iter().flatten() {
            let Accepted { merge, covariance } = &merges[id];
            let from_from_to = merge.from_from_to.a_from_b;
            let (there, here_from_there, covariance) = if merge.from == here {
                (merge.to, from_from_to, *covariance)
            } else {
                // (exp(ε) T)⁻¹ = exp(−Ad_T⁻¹ ε) T⁻¹.
                let back = from_from_to.inverse();
                (merge.from, back, moved(&back, covariance))
            };
            if !placed.contains_key(&there) {
                let place = placed[&here].beyond(*id, merge.confidence, &here_from_there, &covariance);
                placed.insert(there, place);
                queue.push_back(there);
            }
        }
    }
    placed
}

/// The covariance of `Ad_T ε` by that of ε.
fn moved(by: &Sim3, covariance: &Matrix7) -> Matrix7 {
    let adjoint = by.adjoint();
    adjoint * covariance * adjoint.transpose()
}

impl Placement {
    /// The place of an agent one merge further.
    fn beyond(&self, id: MergeId, confidence: f64, here_from_there: &Sim3, covariance: &Matrix7) -> Self {
        let mut path = self.path.clone();
        path.push(id);
        Self {
            root_from_agent: self.root_from_agent * *here_from_there,
            // exp(ε) R exp(η) H = exp(ε + Ad_R η) R H to first order.
            covariance: self.covariance + moved(&self.root_from_agent, covariance),
            path,
            confidence: self.confidence.min(confidence),
        }
    }
}
