//! The pose graph over the keyframes of a closure (Appendix A, Fig. 11).

use super::{MethodRefusal, Observed, Side};
use crate::estimate::Estimate;
use backend::posegraph::{PoseGraphParams, optimise};
use geometry::Sim3;
use map::{Edge, EdgeKind, KeyframeId};
use std::collections::{BTreeMap, BTreeSet};

/// An edge between the agents.
pub(super) struct Bond {
    /// Keyframe of the source.
    pub source: KeyframeId,
    /// Keyframe of the target.
    pub target: KeyframeId,
    /// How they stand to each other.
    pub target_from_source: Estimate,
}

/// Optimises the poses of all keyframes and gives how those of `middle`, source and target, then stand to each
/// other: target_from_source.
///
/// `start`, target_world_from_source_world, places the source's keyframes that have no bond; those that have start
/// where their first bond puts them. The middle keyframe of the target holds the gauge.
pub(super) fn optimised(
    observed: &Observed,
    bonds: &[Bond],
    middle: (KeyframeId, KeyframeId),
    start: &Sim3,
    params: &PoseGraphParams,
) -> Result<Sim3, MethodRefusal> {
    let (source, target) = (Numbering::new(&observed.source, 0), &observed.target);
    let target = Numbering::new(target, source.ids.len() as u32);
    let mut nodes = BTreeMap::new();
    for (id, pose) in &observed.target.world_from_keyframes {
        nodes.insert(target.of(*id)?, *pose);
    }
    for (id, pose) in &observed.source.world_from_keyframes {
        let bond = bonds.iter().find(|bond| bond.source == *id);
        let bonded = bond.and_then(|bond| {
            let world = observed.target.world_from_keyframes.get(&bond.target)?;
            Some(*world * bond.target_from_source.a_from_b)
        });
        nodes.insert(source.of(*id)?, bonded.unwrap_or(*start * *pose));
    }
    let mut edges = source.edges(&observed.source)?;
    edges.extend(target.edges(&observed.target)?);
    for bond in bonds {
        let Estimate { a_from_b, information } = bond.target_from_source;
        let (from, to) = (target.of(bond.target)?, source.of(bond.source)?);
        edges.push(Edge { from, to, from_from_to: a_from_b, information, kind: EdgeKind::Merge });
    }
    let (s, t) = (source.of(middle.0)?, target.of(middle.1)?);
    optimise(&mut nodes, &edges, &BTreeSet::from([t]), params)?;
    Ok(nodes[&t].inverse() * nodes[&s])
}

/// The ids that one side's keyframes have in the graph: both maps count theirs from zero.
struct Numbering {
    ids: BTreeMap<KeyframeId, KeyframeId>,
}

impl Numbering {
    /// Numbers from `first` on.
    fn new(side: &Side, first: u32) -> Self {
        let ids = side.world_from_keyframes.keys().copied();
        Self { ids: ids.zip((first..).map(KeyframeId)).collect() }
    }

    fn of(&self, id: KeyframeId) -> Result<KeyframeId, MethodRefusal> {
        self.ids.get(&id).copied().ok_or(MethodRefusal::NoMotion)
    }

    /// The map's own edges.
    fn edges(&self, side: &Side) -> Result<Vec<Edge>, MethodRefusal> {
        let renamed =
            |edge: &Edge| Ok(Edge { from: self.of(edge.from)?, to: self.of(edge.to)?, ..edge.clone() });
        side.edges.iter().map(renamed).collect()
    }
}
