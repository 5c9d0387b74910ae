//! Places that two maps may share: queries of all keyframes of the one in the other, with the support of their
//! neighbours, thinned so that the best few are not all of one spot.

use crate::{
    Appearance, BowParams, CommonIndex, FabMapParams, IndexMethod, SequenceParams, ThumbnailParams,
    Vocabulary, WordBag, supported,
};
use map::{KeyframeId, PlaceCandidate};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

/// How places are proposed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProposeParams {
    /// By what keyframes are found. Default bag-of-words; fab-map and thumbnails are there to compare it with.
    pub method: IndexMethod,
    /// The index by the words that keyframes share.
    pub bow: BowParams,
    /// The one by the probability of one place.
    pub fab_map: FabMapParams,
    /// The one by small blurred images.
    pub thumbnails: ThumbnailParams,
    /// Support by neighbouring keyframes.
    pub sequence: SequenceParams,
    /// Candidates of each keyframe before its neighbours have their say. Default 10; at least 1.
    pub candidates: usize,
    /// How many keyframes apart, in either map, two proposals are at least. Default 2; 0 for all. Wider looks at more
    /// spots among the first few, and may pass the best view of a spot.
    pub apart: usize,
}

impl Default for ProposeParams {
    fn default() -> Self {
        Self {
            method: IndexMethod::default(),
            bow: BowParams::default(),
            fab_map: FabMapParams::default(),
            thumbnails: ThumbnailParams::default(),
            sequence: SequenceParams::default(),
            candidates: 10,
            apart: 2,
        }
    }
}

/// Two keyframes that may show the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal {
    /// Keyframe of the map that is searched.
    pub keyframe: KeyframeId,
    /// Keyframe of the map whose keyframes are looked for.
    pub query: KeyframeId,
    /// Likeness of the words, 0–1, with the support of the keyframes before and after.
    pub score: f32,
    /// How many features the keyframes share, where [`ranked`](crate::ranked) has counted them.
    pub shared: Option<usize>,
}

/// Proposes the places that two maps may share by the words of their keyframes, best first: what a [`CommonIndex`] does
/// with one map in it.
///
/// Ids are taken to grow with time, as those of an agent do.
pub fn propose(
    map: &BTreeMap<KeyframeId, WordBag>,
    queries: &BTreeMap<KeyframeId, WordBag>,
    vocabulary: &Arc<Vocabulary>,
    params: &ProposeParams,
) -> Vec<Proposal> {
    let mut index = CommonIndex::new(vocabulary, params);
    index.add(map.iter().map(|(id, words)| (*id, Appearance { words, image: None })));
    let queries = queries.iter().map(|(id, words)| (*id, Appearance { words, image: None })).collect();
    index.propose(&queries, &[0]).pop().unwrap_or_default()
}

/// The proposals of successive keyframes `names` from the candidates `found` of each among `ids`, both in order of time.
pub(crate) fn proposals(
    found: &[Vec<PlaceCandidate>],
    names: &[KeyframeId],
    ids: &[KeyframeId],
    params: &ProposeParams,
) -> Vec<Proposal> {
    let mut proposals: Vec<Proposal> = names
        .iter()
        .zip(supported(found, ids, &params.sequence))
        .flat_map(|(&query, candidates)| {
            candidates.into_iter().map(move |c| Proposal {
                keyframe: c.keyframe,
                query,
                score: c.score,
                shared: None,
            })
        })
        .collect();
    proposals
        .sort_by(|a, b| b.score.total_cmp(&a.score).then((a.query, a.keyframe).cmp(&(b.query, b.keyframe))));
    thinned(proposals, ids, names, params.apart)
}

/// The proposals that are no closer than `apart` to a better one in both maps.
fn thinned(
    proposals: Vec<Proposal>,
    ids: &[KeyframeId],
    queries: &[KeyframeId],
    apart: usize,
) -> Vec<Proposal> {
    if apart == 0 {
        return proposals;
    }
    let rank = |all: &[KeyframeId], id| all.binary_search(&id).unwrap_or_default();
    let mut taken: HashSet<(usize, usize)> = HashSet::new();
    let mut kept = proposals;
    kept.retain(|proposal| {
        let (a, b) = (rank(ids, proposal.keyframe), rank(queries, proposal.query));
        let around = |at: usize| at.saturating_sub(apart - 1)..at + apart;
        let is_near = around(a).any(|x| around(b).any(|y| taken.contains(&(x, y))));
        !is_near && taken.insert((a, b))
    });
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_proposals_side_by_side_the_best_stays() {
        let at = |keyframe: u32, query: u32, score: f32| Proposal {
            keyframe: KeyframeId(keyframe),
            query: KeyframeId(query),
            score,
            shared: None,
        };
        let ids: Vec<KeyframeId> = (0..20).map(KeyframeId).collect();
        let all = vec![at(5, 7, 0.9), at(6, 7, 0.8), at(6, 9, 0.7), at(15, 7, 0.6), at(14, 8, 0.5)];
        let kept = thinned(all.clone(), &ids, &ids, 2);
        assert_eq!(kept, [all[0], all[2], all[3]]);
        assert_eq!(thinned(all.clone(), &ids, &ids, 0), all);
    }
}
