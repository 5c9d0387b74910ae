//! Changes of a map: who works on a map publishes them, and who stores or shows it applies them.

use crate::{AgentId, Edge, Keyframe, KeyframeId, Map, Point, SemiDense, Shared, SharedBytes};
use geometry::Sim3;
use std::collections::BTreeMap;

/// What one step of work changed in an agent's map.
///
/// [`Map::take_in`] applies deltas. Applied in order of their numbers, from the first one on, they give the
/// publisher's map. Who writes or shows a map gets from them what is new, without comparing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapDelta {
    /// Number of the delta, from 0, each one more than the one before.
    pub sequence: u64,
    /// Keyframes that are new, with image and pose.
    pub added: Vec<Keyframe>,
    /// Keyframes that were moved.
    pub moved: Vec<Moved>,
    /// Keyframes whose depth became known.
    pub settled: Vec<Settled>,
    /// Keyframes whose features were found.
    pub described: Vec<Described>,
    /// All edges, if they were made anew.
    pub edges: Option<Vec<Edge>>,
    /// Keyframes that are gone.
    pub removed: Vec<KeyframeId>,
    /// Entries of the agent's [`provenance`](crate::AgentInfo::provenance) that are new or others.
    pub provenance: BTreeMap<String, String>,
}

/// A keyframe that was moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Which.
    pub keyframe: KeyframeId,
    /// Its new pose and unit; depths and frames that are measured in it do not change.
    pub world_from_keyframe: Sim3,
}

/// A keyframe whose depth became known.
#[derive(Clone, Debug, PartialEq)]
pub struct Settled {
    /// Which.
    pub keyframe: KeyframeId,
    /// Its semi-dense depth.
    pub semi_dense: Shared<SemiDense>,
    /// The points it hosts.
    pub points: Vec<Point>,
}

/// A keyframe whose features were found.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// Which.
    pub keyframe: KeyframeId,
    /// Its [`features`](Keyframe::features).
    pub features: SharedBytes,
}

impl MapDelta {
    /// The delta that makes the whole map from an empty one, except its frames.
    pub fn whole(map: &Map) -> Self {
        let added = map.keyframes.values().cloned().collect();
        Self { added, edges: Some(map.edges.clone()), ..Self::default() }
    }

    /// Whether nothing happened.
    pub fn is_empty(&self) -> bool {
        let Self { sequence: _, added, moved, settled, described, edges, removed, provenance } = self;
        let keyframes = added.is_empty() && moved.is_empty() && settled.is_empty() && described.is_empty();
        keyframes && edges.is_none() && removed.is_empty() && provenance.is_empty()
    }
}

impl Map {
    /// Applies `delta`. It ignores keyframes that are not in the map.
    pub fn take_in(&mut self, delta: MapDelta) {
        for keyframe in delta.added {
            self.keyframes.insert(keyframe.id, keyframe);
        }
        for Moved { keyframe, world_from_keyframe } in delta.moved {
            if let Some(keyframe) = self.keyframes.get_mut(&keyframe) {
                keyframe.world_from_keyframe = world_from_keyframe;
            }
        }
        for Settled { keyframe, semi_dense, points } in delta.settled {
            if let Some(keyframe) = self.keyframes.get_mut(&keyframe) {
                (keyframe.semi_dense, keyframe.points) = (semi_dense, points);
            }
        }
        for Described { keyframe, features } in delta.described {
            if let Some(keyframe) = self.keyframes.get_mut(&keyframe) {
                keyframe.features = Some(features);
            }
        }
        for id in &delta.removed {
            self.keyframes.remove(id);
        }
        if let Some(edges) = delta.edges {
            self.edges = edges;
        }
        // Deltas are of one agent's own map.
        if let Some(about) = self.agents.get_mut(&AgentId::default()) {
            about.provenance.extend(delta.provenance);
        }
    }
}

impl SemiDense {
    /// Brings the depths to a unit in which lengths are `factor` times what they were.
    pub fn scale(&mut self, factor: f32) {
        self.inverse_depth.iter_mut().for_each(|d| *d /= factor);
        self.variance.iter_mut().for_each(|v| *v /= factor * factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::united;

    #[test]
    fn a_map_sent_in_deltas_is_the_map() {
        let map = united();
        let mut replica = Map { keyframes: Default::default(), edges: Vec::new(), ..map.clone() };
        let bare = |k: &Keyframe| Keyframe {
            world_from_keyframe: Sim3::identity(),
            semi_dense: SemiDense::default().into(),
            points: Vec::new(),
            features: None,
            ..k.clone()
        };
        let spurious = Keyframe { id: KeyframeId(9999), ..bare(map.keyframes.values().next().unwrap()) };
        let added = map.keyframes.values().map(bare).chain([spurious]).collect();
        let moved = map
            .keyframes
            .values()
            .map(|k| Moved { keyframe: k.id, world_from_keyframe: k.world_from_keyframe });
        let settled = map.keyframes.values().map(|k| Settled {
            keyframe: k.id,
            semi_dense: k.semi_dense.clone(),
            points: k.points.clone(),
        });
        let described = map
            .keyframes
            .values()
            .filter_map(|k| Some(Described { keyframe: k.id, features: k.features.clone()? }));
        let (moved, settled, described) = (moved.collect(), settled.collect(), described.collect());
        replica.take_in(MapDelta { added, ..MapDelta::default() });
        assert_eq!(replica.keyframes.len(), map.keyframes.len() + 1);
        replica.take_in(MapDelta { sequence: 1, moved, settled, described, ..MapDelta::default() });
        let (edges, removed) = (Some(map.edges.clone()), vec![KeyframeId(9999)]);
        let last = MapDelta { sequence: 2, edges, removed, ..MapDelta::default() };
        assert!(!last.is_empty() && MapDelta::default().is_empty());
        replica.take_in(last);
        assert!(replica == map);
    }

    #[test]
    fn a_map_can_be_one_delta() {
        let map = united();
        let mut replica = Map { keyframes: Default::default(), edges: Vec::new(), ..map.clone() };
        replica.take_in(MapDelta::whole(&map));
        assert!(replica == map);
    }
}
