//! What the baselines see of a closure: its keyframes, their poses, edges and clouds, and the pairs measured.

use super::{Baseline, BaselineParams, Configuration, Measurement};
use crate::closure::Closure;
use crate::icp::{Cloud, keyframe_cloud};
use crate::pair::PairRefusal;
use crate::prepared::PreparedMap;
use crate::scale_filter::ScaleRefusal;
use geometry::Sim3;
use map::{Edge, EdgeKind, KeyframeId};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// One agent's keyframes at a closure.
#[derive(Clone, Debug, PartialEq)]
pub struct Side {
    /// World poses in the agent's own map.
    pub world_from_keyframes: BTreeMap<KeyframeId, Sim3>,
    /// The map's edges between them.
    pub edges: Vec<Edge>,
    /// Their clouds, in camera frames and units.
    pub clouds: BTreeMap<KeyframeId, Cloud>,
}

/// A pair of keyframes with what PCR-Pro measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservedPair {
    /// Keyframe of the source.
    pub source: KeyframeId,
    /// Keyframe of the target.
    pub target: KeyframeId,
    /// R, σ and t.
    pub measured: Result<Measurement, PairRefusal>,
}

/// What a baseline works on.
#[derive(Clone, Debug, PartialEq)]
pub struct Observed {
    /// The source's keyframes S.
    pub source: Side,
    /// The target's keyframes T.
    pub target: Side,
    /// S_z–T_z for z = −1, 0, 1; `None` where the maps have no such neighbours or the method does not look at them.
    pub direct: [Option<ObservedPair>; 3],
    /// S_z–T_z′ with z and z′ one apart, where the method looks at them.
    pub cross: Vec<ObservedPair>,
}

/// z and z′ of the cross pairs S_z–T_z′, as indices of the direct ones.
const CROSS: [(usize, usize); 4] = [(1, 0), (0, 1), (2, 1), (1, 2)];

/// Measures what `baseline` needs at a closure.
pub fn observe(
    baseline: Baseline,
    source: &PreparedMap,
    target: &PreparedMap,
    closure: &Closure,
    params: &BaselineParams,
) -> Observed {
    let mut places =
        closure.pairs.each_ref().map(|pair| pair.as_ref().map(|pair| (pair.source, pair.target)));
    let cross: Vec<(KeyframeId, KeyframeId)> = match baseline {
        Baseline::PoseGraph(Configuration::Full) => {
            CROSS.into_iter().filter_map(|(s, t)| Some((places[s]?.0, places[t]?.1))).collect()
        }
        _ => Vec::new(),
    };
    if baseline == Baseline::PcrPro {
        places = [None, places[1], None];
    }
    let all: Vec<(KeyframeId, KeyframeId)> = places.iter().flatten().copied().chain(cross).collect();
    let mut measured = all.par_iter().map(|&(i, j)| pair(source, target, i, j, params)).collect::<Vec<_>>();
    let cross = measured.split_off(places.iter().flatten().count());
    let mut measured = measured.into_iter();
    let direct = places.map(|place| place.and_then(|_| measured.next()));
    let with_clouds = (baseline != Baseline::PcrPro).then_some(params);
    Observed {
        source: Side::new(source, places.iter().flatten().map(|place| place.0), with_clouds),
        target: Side::new(target, places.iter().flatten().map(|place| place.1), with_clouds),
        direct,
        cross,
    }
}

/// Measures one pair.
fn pair(
    source: &PreparedMap,
    target: &PreparedMap,
    i: KeyframeId,
    j: KeyframeId,
    params: &BaselineParams,
) -> ObservedPair {
    let measured = match (source.get(i), target.get(j)) {
        (Some(a), Some(b)) => Measurement::new(a, b, &params.pair),
        // Without features there is nothing to match.
        _ => Err(ScaleRefusal::TooFew { given: 0, needed: params.pair.scale_filter.min_used }.into()),
    };
    ObservedPair { source: i, target: j, measured }
}

impl Side {
    /// The keyframes `ids` of a map, with clouds where their parameters are given.
    fn new(
        map: &PreparedMap,
        ids: impl Iterator<Item = KeyframeId>,
        with_clouds: Option<&BaselineParams>,
    ) -> Self {
        let ids: BTreeSet<KeyframeId> = ids.collect();
        let cloud = |id: KeyframeId| {
            let keyframe = map.get(id)?;
            Some((id, keyframe_cloud(keyframe.depth(), keyframe.camera, &with_clouds?.cloud)))
        };
        let among =
            |edge: &&Edge| edge.kind != EdgeKind::Merge && ids.contains(&edge.from) && ids.contains(&edge.to);
        Self {
            world_from_keyframes: ids.iter().filter_map(|&id| Some((id, map.world_from(id)?))).collect(),
            edges: map.map().edges.iter().filter(among).cloned().collect(),
            clouds: ids.par_iter().filter_map(|&id| cloud(id)).collect(),
        }
    }
}

impl Observed {
    /// The pair of most matches among the direct ones, the first of equals.
    pub(super) fn most_matched(&self) -> Option<(&ObservedPair, &Measurement)> {
        let measured =
            self.direct.iter().flatten().filter_map(|pair| Some((pair, pair.measured.as_ref().ok()?)));
        measured.reduce(|best, next| if next.1.match_count > best.1.match_count { next } else { best })
    }

    /// World poses of a pair's keyframes, the source's first.
    pub(super) fn poses(&self, source: KeyframeId, target: KeyframeId) -> Option<(Sim3, Sim3)> {
        let source = self.source.world_from_keyframes.get(&source)?;
        Some((*source, *self.target.world_from_keyframes.get(&target)?))
    }
}
