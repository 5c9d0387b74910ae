//! Where the agents are, and which of them hang together.

use crate::common_map::names::Names;
use crate::merging::Merging;
use geometry::Sim3;
use map::{AgentId, Map};
use merge::common_map::Fused;
use merge::merge_graph::{MergeGraph, MergeId, Placement};
use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use serde::Serialize;

/// An agent.
#[derive(Clone, Debug, Serialize)]
pub struct AgentRecord {
    /// Its name, unique among all.
    pub name: String,
    /// Its keyframes.
    pub keyframes: usize,
    /// Its frames with a pose.
    pub frames: usize,
    /// The agent whose world is the common one of the group.
    pub root: String,
    /// Maps the agent's world into the root's, as the spanning tree has it; the joint pose graph then moves its
    /// keyframes one by one.
    pub root_from_agent: Sim3,
    /// How well that is known, by the merges on the way.
    pub deviations: Deviations,
    /// The agents on the way from the root to this one, both included.
    pub path: Vec<String>,
    /// The smallest confidence of a merge on the way; nothing for the root.
    pub confidence: Option<f64>,
}

/// Standard deviations of an agent's place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Deviations {
    /// Of the position of the middle of its keyframes, over all three axes, units of the common map.
    pub position: f64,
    /// Of the rotation, its worst axis, degrees.
    pub rotation_deg: f64,
    /// Of the scale, parts.
    pub scale: f64,
}

/// Agents that hang together.
#[derive(Clone, Debug, Serialize)]
pub struct GroupRecord {
    /// Their names.
    pub agents: Vec<String>,
    /// The file of their map.
    pub map: String,
    /// Keyframes of all.
    pub keyframes: usize,
    /// Edges between keyframes of different agents.
    pub closures: usize,
    /// What the joint pose graph did; nothing where there was none.
    pub pose_graph: Option<PoseGraphRecord>,
}

/// What the joint pose graph did.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PoseGraphRecord {
    /// Linear systems solved.
    pub iterations: usize,
    /// Robust cost before.
    pub initial_cost: f64,
    /// Robust cost after.
    pub final_cost: f64,
    /// Whether it came to rest.
    pub converged: bool,
    /// Closures between agents that it came to disbelieve.
    pub suppressed: usize,
}

/// Every agent, group by group.
pub(super) fn all(merging: &Merging, names: &Names) -> anyhow::Result<Vec<AgentRecord>> {
    let graph = &merging.graph;
    let own = merging.common.agents();
    let agents = merging.fused.iter().flat_map(|fused| {
        fused.component.agents.iter().map(|(agent, placement)| (fused.component.root, *agent, placement))
    });
    let record = |(root, agent, placement): (AgentId, AgentId, &Placement)| AgentRecord {
        name: names.of(agent).to_owned(),
        keyframes: own.get(&agent).map_or(0, |map| map.keyframes.len()),
        frames: own.get(&agent).map_or(0, |map| map.frames.len()),
        root: names.of(root).to_owned(),
        root_from_agent: placement.root_from_agent,
        deviations: own.get(&agent).map_or_else(Deviations::none, |map| Deviations::new(placement, map)),
        path: path(root, &placement.path, graph)
            .into_iter()
            .map(|agent| names.of(agent).to_owned())
            .collect(),
        confidence: placement.confidence.is_finite().then_some(placement.confidence),
    };
    Ok(agents.map(record).collect())
}

/// The agents that merges lead over, from the root on.
fn path(root: AgentId, merges: &[MergeId], graph: &MergeGraph) -> Vec<AgentId> {
    let mut path = vec![root];
    for id in merges {
        let last = path[path.len() - 1];
        let ends = graph.merges().find(|(found, _)| found == id).map(|(_, merge)| (merge.from, merge.to));
        path.extend(ends.map(|(from, to)| if from == last { to } else { from }));
    }
    path
}

impl Deviations {
    /// Those of what is known exactly.
    const fn none() -> Self {
        Self { position: 0.0, rotation_deg: 0.0, scale: 0.0 }
    }

    fn new(placement: &Placement, own: &Map) -> Self {
        let count = own.keyframes.len().max(1) as f64;
        let middle: Vector3<f64> = own
            .keyframes
            .values()
            .map(|keyframe| placement.root_from_agent * keyframe.world_from_keyframe.translation)
            .sum::<Vector3<f64>>()
            / count;
        // At the agent: seen from the common world's origin a turn shifts everything.
        let adjoint = Sim3::new(UnitQuaternion::identity(), -middle, 1.0).adjoint();
        let covariance: SMatrix<f64, 7, 7> = adjoint * placement.covariance * adjoint.transpose();
        let variances = covariance.diagonal();
        Self {
            position: variances.fixed_rows::<3>(0).sum().max(0.0).sqrt(),
            rotation_deg: variances.fixed_rows::<3>(3).max().sqrt().to_degrees(),
            scale: variances[6].sqrt(),
        }
    }
}

impl GroupRecord {
    pub(super) fn new(fused: &Fused, map: &str, names: &Names) -> Self {
        let is_merge = |edge: &&map::Edge| edge.kind == map::EdgeKind::Merge;
        Self {
            agents: fused.agents.iter().map(|agent| names.of(*agent).to_owned()).collect(),
            map: map.to_owned(),
            keyframes: fused.map.keyframes.len(),
            closures: fused.map.edges.iter().filter(is_merge).count(),
            pose_graph: PoseGraphRecord::new(fused),
        }
    }
}

impl PoseGraphRecord {
    fn new(fused: &Fused) -> Option<Self> {
        let report = fused.report.as_ref()?;
        Some(Self {
            iterations: report.iterations,
            initial_cost: report.initial_cost,
            final_cost: report.final_cost,
            converged: report.converged,
            suppressed: fused.suppressed.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pinhole;

    /// A turn about the origin shifts an agent that is far from it, a turn about the agent does not.
    #[test]
    fn the_position_deviates_by_what_moves_the_agent() {
        let camera = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };
        let away = Sim3::new(UnitQuaternion::identity(), Vector3::new(10.0, 0.0, 0.0), 1.0);
        let mut about_origin = SMatrix::<f64, 7, 7>::zeros();
        about_origin[(5, 5)] = 1e-4;
        let adjoint = away.adjoint();
        let about_agent = adjoint * about_origin * adjoint.transpose();
        let deviations = |covariance| {
            let mut own = Map::new(camera);
            let keyframe = map::Keyframe {
                id: map::KeyframeId(0),
                agent: AgentId::default(),
                timestamp: 0.0,
                frame_index: 0,
                world_from_keyframe: Sim3::identity(),
                image: std::sync::Arc::new(geometry::GrayImage::filled(4, 3, 0)),
                color: None,
                scan: None,
                semi_dense: map::SemiDense::default().into(),
                points: Vec::new(),
                features: None,
                words: None,
            };
            own.keyframes.insert(map::KeyframeId(0), keyframe);
            let placement = Placement { root_from_agent: away, covariance, path: vec![], confidence: 1.0 };
            Deviations::new(&placement, &own)
        };
        let (origin, agent) = (deviations(about_origin), deviations(about_agent));
        assert!((origin.position - 0.1).abs() < 1e-12 && agent.position < 1e-9);
        assert!((origin.rotation_deg - 0.01_f64.to_degrees()).abs() < 1e-12);
        assert!((agent.rotation_deg - origin.rotation_deg).abs() < 1e-12);
    }
}
