//! A common map that stands: merges that turn out wrong when all are seen together are taken back.
//!
//! A merge is accepted for what two maps say of each other. With more maps more is known: over a third agent two others
//! stand to each other in two ways, and the joint pose graph weighs all closures. What contradicts there ends its own
//! merge, never those of others.

use super::{CommonMap, Fused, FusionError, FusionParams};
use crate::merge_graph::{Component, MergeGraph, MergeId};
use geometry::Sim3;
use map::AgentId;
use nalgebra::{SMatrix, SVector};
use std::collections::BTreeSet;

/// A merge of two agents that was taken back.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TakenBack {
    /// The agents.
    pub agents: (AgentId, AgentId),
    /// Why, in words.
    pub why: String,
}

impl CommonMap {
    /// Makes the common maps as [`fuse`](Self::fuse) does, and takes back the merges that cannot stand: whose closures
    /// cannot be used or contradict each other, of which the joint pose graph believes none, or that put an agent
    /// elsewhere than the merges over third agents do, which are trusted more.
    ///
    /// # Errors
    /// When what is wrong is not one merge.
    pub fn fuse_consistently(
        &mut self,
        params: &FusionParams,
    ) -> Result<(Vec<Fused>, Vec<TakenBack>), FusionError> {
        let mut taken_back = Vec::new();
        loop {
            let contradicted = match self.graph(params) {
                Ok(graph) => self.contradicting_cycle(&graph, params),
                Err(_) => None,
            };
            let next = match contradicted {
                Some(taken) => taken,
                None => match self.fuse(params) {
                    Ok(fused) => match self.unsupported_merge(&fused, params)? {
                        Some(taken) => taken,
                        None => return Ok((fused, taken_back)),
                    },
                    Err(error) => match error.between() {
                        Some(agents) => TakenBack { agents, why: error.to_string() },
                        None => return Err(error),
                    },
                },
            };
            // Each round takes a merge back, so there is an end.
            if self.separate(next.agents.0, next.agents.1) == 0 {
                return self.fuse(params).map(|fused| (fused, taken_back));
            }
            taken_back.push(next);
        }
    }

    /// A merge of which no closure is believed. Agents that hang together over none are in no fused map together, so
    /// closures that contradict each other are asked for by themselves.
    fn unsupported_merge(
        &self,
        fused: &[Fused],
        params: &FusionParams,
    ) -> Result<Option<TakenBack>, FusionError> {
        let contradicting = self.consistent(params)?.contradicting;
        let suppressed: BTreeSet<_> = fused
            .iter()
            .flat_map(|fused| &fused.suppressed)
            .chain(&contradicting)
            .map(|link| (link.from.min(link.to), link.from.max(link.to)))
            .collect();
        let believed = |agents: &(AgentId, AgentId)| {
            self.links.iter().filter(|link| link.agents() == *agents).any(|link| {
                let ends = (link.from.min(link.to), link.from.max(link.to));
                !suppressed.contains(&ends)
            })
        };
        let taken = self.merged().into_iter().find(|agents| !believed(agents)).map(|agents| TakenBack {
            agents,
            why: "all of its closures contradict the joint pose graph or each other".to_owned(),
        });
        Ok(taken)
    }

    /// The merge beside the spanning tree that contradicts it most.
    fn contradicting_cycle(&self, graph: &MergeGraph, params: &FusionParams) -> Option<TakenBack> {
        let components = graph.components();
        let error = |component: &Component, id: MergeId| -> Option<(f64, (AgentId, AgentId))> {
            let merge = graph.merges().find(|(other, _)| *other == id)?.1;
            let (from, to) = (component.agents.get(&merge.from)?, component.agents.get(&merge.to)?);
            let over_others = from.root_from_agent.inverse() * to.root_from_agent;
            let error = self.cycle_error(merge.from, &merge.from_from_to.a_from_b, &over_others, params)?;
            Some((error, (merge.from.min(merge.to), merge.from.max(merge.to))))
        };
        let spare = components.iter().flat_map(|c| c.spare.iter().filter_map(move |id| error(c, *id)));
        let worst = spare.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
        let limit = params.max_cycle_error;
        (worst.0 > limit).then(|| TakenBack {
            agents: worst.1,
            why: format!(
                "over other agents they stand to each other otherwise, by {:.1} times what the maps may drift",
                worst.0 / limit
            ),
        })
    }

    /// By how much two motions of agent `to`'s world into `from`'s differ, in standard deviations of the drift of a
    /// whole map. Where agents met, and how well each meeting is known, matters less than how far apart the meetings
    /// are: the way is at most the length of the map.
    fn cycle_error(
        &self,
        from: AgentId,
        direct: &Sim3,
        over_others: &Sim3,
        params: &FusionParams,
    ) -> Option<f64> {
        let map = self.agents.get(&from)?;
        let positions: Vec<_> =
            map.keyframes.values().map(|keyframe| keyframe.world_from_keyframe.translation).collect();
        let middle = positions.iter().sum::<nalgebra::Vector3<f64>>() / positions.len().max(1) as f64;
        let length: f64 = positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        // Seen from the middle of the map: at a far origin a turn would move it.
        let centred = Sim3 { translation: -middle, ..Sim3::identity() };
        let difference = (centred * *direct * over_others.inverse() * centred.inverse()).log();
        let drift = &params.consistency;
        let edges = (positions.len() as f64).sqrt();
        let translation = drift.drift_translation * length;
        let rotation = drift.drift_rotation.to_radians() * edges;
        let scale = drift.drift_scale * edges;
        let deviations = SVector::<f64, 7>::from([
            translation,
            translation,
            translation,
            rotation,
            rotation,
            rotation,
            scale,
        ]);
        let weights = SMatrix::<f64, 7, 7>::from_diagonal(&deviations.map(|d| (d * d).recip()));
        let squared = (difference.transpose() * weights * difference)[0];
        squared.is_finite().then(|| squared.sqrt())
    }
}

impl FusionError {
    /// The two agents whose merge is at fault; nothing where it is not one merge.
    fn between(&self) -> Option<(AgentId, AgentId)> {
        match self {
            Self::Closures { agents, .. } => Some(*agents),
            Self::NoClosure(a, b) | Self::NoMean(a, b) | Self::NoConfidence(a, b) => {
                Some((*a.min(b), *a.max(b)))
            }
            Self::Map(_) | Self::Graph(_) | Self::PoseGraph(_) => None,
        }
    }
}
