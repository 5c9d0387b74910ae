//! Resuming the common map of several agents, as one more of them.
//!
//! The working map has the keyframes of all agents, the others' first. Frames are tracked against all of them, and
//! optimisation moves all of them. The agent publishes its own map alone, in the world of the common map: its
//! keyframes from number 0 on, what they observe of each other, and frames relative to them. A [`Joint`] has the
//! edges between its keyframes and the others'.

use super::Agent;
use crate::closing::edges;
use crate::local_map::LocalMap;
use crate::publish;
use map::{Described, Settled};
use map::{Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Map, MapDelta, MapError, Moved};
use std::collections::BTreeMap;

/// Ties of two agents that are kept, spread over the way: whoever makes a map of them compares any two of them.
const MOST_TIES: usize = 100;

/// The common map that an agent resumed, with the edges between its keyframes and those of the others.
#[derive(Clone, Debug)]
pub struct Joint {
    /// With keyframes where they are by now.
    common: Map,
    /// Between keyframes of different agents, the agent's called as if they were the common map's next ones.
    ties: Vec<Edge>,
}

impl Joint {
    /// The common map with one more agent, the last: the one whose map is `own`.
    ///
    /// # Errors
    /// Those of [`Map::unite`].
    pub fn united(self, own: Map) -> Result<Map, MapError> {
        let count = self.common.keyframes.len() as u32;
        let merge_provenance = self.common.merge_provenance.clone();
        let map = Map::unite(vec![self.common, own])?;
        let last = map.agents.values().next_back().and_then(|about| about.own.as_ref());
        let first = last.map_or(0, |own| own.first_keyframe);
        let rename = |id: KeyframeId| if id.0 < count { id } else { KeyframeId(id.0 - count + first) };
        let ties = self.ties.into_iter();
        let ties = ties.map(|edge| Edge { from: rename(edge.from), to: rename(edge.to), ..edge });
        Ok(Map { edges: map.edges.into_iter().chain(ties).collect(), merge_provenance, ..map })
    }
}

impl Agent {
    /// How many keyframes at the begin of the working map are others'.
    pub(super) fn others(&self) -> usize {
        self.common.as_ref().map_or(0, |common| common.keyframes.len())
    }

    /// Whether the agent goes on in a common map and has no keyframe of its own yet: the first frame that is found becomes one.
    pub(super) fn lacks_keyframes(&self) -> bool {
        self.common.is_some() && self.view.keyframes.len() == self.others()
    }

    /// What the agent's own map calls a keyframe of the working map; `None` of another's.
    pub(super) fn own_id(&self, id: KeyframeId) -> Option<KeyframeId> {
        publish::own_id(id, self.others())
    }

    /// A closed loop, `(newer, older)` keyframe, in the agent's own map; `None` where it ends at another's keyframe.
    pub(super) fn own_loop(&self, closed: (KeyframeId, KeyframeId)) -> Option<(KeyframeId, KeyframeId)> {
        Some((self.own_id(closed.0)?, self.own_id(closed.1)?))
    }

    /// What the working map calls a keyframe of the agent's own map.
    pub(super) fn working_id(&self, own: KeyframeId) -> KeyframeId {
        LocalMap::id(own.0 as usize + self.others())
    }

    /// A frame of the working map in the agent's own: where it was tracked against another's keyframe, it is relative to the
    /// agent's newest one. `None` before there is one.
    pub(super) fn own_frame(&self, frame: FramePose) -> Option<FramePose> {
        if let Some(reference) = self.own_id(frame.reference) {
            return Some(FramePose { reference, ..frame });
        }
        let newest = self.view.keyframes.len().checked_sub(1).filter(|_| !self.lacks_keyframes())?;
        let camera_from_world =
            self.view.camera_from_world(frame.reference.0 as usize, &frame.keyframe_from_frame);
        let reference = self.own_id(LocalMap::id(newest))?;
        let keyframe_from_frame = self.view.keyframe_from_frame(newest, &camera_from_world);
        Some(FramePose { reference, keyframe_from_frame, ..frame })
    }

    /// What a change of the working map is to the agent's own.
    pub(super) fn own_delta(&self, delta: MapDelta) -> MapDelta {
        if self.common.is_none() {
            return delta;
        }
        let MapDelta { sequence, added, moved, settled, described, edges, removed, provenance } = delta;
        let (own, first) = (|id| self.own_id(id), self.others());
        let keyframe = |k: Keyframe| {
            Some(Keyframe { id: own(k.id)?, points: publish::own_points(k.points, first), ..k })
        };
        let settled_depth = |s: Settled| {
            let keyframe = own(s.keyframe)?;
            Some(Settled { keyframe, points: publish::own_points(s.points, first), ..s })
        };
        MapDelta {
            sequence,
            added: added.into_iter().filter_map(keyframe).collect(),
            moved: moved
                .into_iter()
                .filter_map(|m| Some(Moved { keyframe: own(m.keyframe)?, ..m }))
                .collect(),
            settled: settled.into_iter().filter_map(settled_depth).collect(),
            described: described
                .into_iter()
                .filter_map(|d| Some(Described { keyframe: own(d.keyframe)?, ..d }))
                .collect(),
            edges: edges.map(|edges| edges.into_iter().filter_map(|edge| self.own_edge(edge)).collect()),
            removed: removed.into_iter().filter_map(own).collect(),
            provenance,
        }
    }

    /// The edges of the agent's own map, by what it knows now; weak ones of keyframes that hang on others' alone.
    pub(super) fn edges(&self) -> Vec<Edge> {
        if self.common.is_none() {
            return edges::all(&self.view, &self.closed);
        }
        let is_own = |edge: &Edge| self.own_id(edge.from.min(edge.to)).is_some();
        let measured = edges::measured(&self.view, self.others(), &self.closed);
        let mut own: Vec<Edge> = measured.into_iter().filter(is_own).collect();
        own.extend(edges::loose(&self.view, self.others() + 1, &own));
        own.into_iter().filter_map(|edge| self.own_edge(edge)).collect()
    }

    /// An edge of the working map in the agent's own; `None` of one that ends at another's keyframe.
    fn own_edge(&self, edge: Edge) -> Option<Edge> {
        Some(Edge { from: self.own_id(edge.from)?, to: self.own_id(edge.to)?, ..edge })
    }

    /// The edges between the agent's keyframes and those of the others, if it resumed a common map. Call it after
    /// [`finish`](Self::finish), and before the map is taken.
    pub fn joint(&self) -> Option<Joint> {
        let mut common = Map::clone(self.common.as_ref()?);
        for (index, keyframe) in common.keyframes.values_mut().enumerate() {
            keyframe.world_from_keyframe = self.view.world_from_keyframe(index);
        }
        let whose = |id: KeyframeId| common.keyframes.get(&id).map(|keyframe| keyframe.agent);
        // Of the others too: what only they saw of each other must not be outweighed by what the agent saw of each.
        let measured = edges::measured(&self.view, 0, &self.closed);
        // One between each keyframe and each agent whose are older: what is known best. Those of one keyframe are in its unit.
        let mut best: BTreeMap<_, BTreeMap<KeyframeId, (f64, Edge)>> = BTreeMap::new();
        for edge in measured {
            let (from, to) = (whose(edge.from), whose(edge.to));
            // What says nothing of one of the seven degrees of freedom ties nothing.
            let certainty = edge.information.cholesky().map(|root| root.determinant());
            let Some(certainty) = certainty.filter(|_| from != to) else { continue };
            let best = best.entry((from, to)).or_default();
            if best.get(&edge.from).is_none_or(|(known, _)| *known < certainty) {
                best.insert(edge.from, (certainty, Edge { kind: EdgeKind::Merge, ..edge }));
            }
        }
        let spread = |ties: BTreeMap<KeyframeId, (f64, Edge)>| {
            let step = ties.len().div_ceil(MOST_TIES);
            ties.into_values().map(|(_, edge)| edge).step_by(step)
        };
        let ties = best.into_values().flat_map(spread).collect();
        Some(Joint { common, ties })
    }
}
