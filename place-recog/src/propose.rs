//! Places that two maps may share: queries of all keyframes of the one in the other, with the support of their
//! neighbours, thinned so that the best few are not all of one spot.

use crate::{BowIndex, BowParams, SequenceParams, Vocabulary, WordBag, supported};
use map::{KeyframeId, PlaceIndex};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// How places are proposed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProposeParams {
    /// The index.
    pub bow: BowParams,
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
        Self { bow: BowParams::default(), sequence: SequenceParams::default(), candidates: 10, apart: 2 }
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

/// Proposes the places that two maps may share, best first.
///
/// Ids are taken to grow with time, as those of an agent do.
pub fn propose(
    map: &BTreeMap<KeyframeId, WordBag>,
    queries: &BTreeMap<KeyframeId, WordBag>,
    vocabulary: &Arc<Vocabulary>,
    params: &ProposeParams,
) -> Vec<Proposal> {
    let mut index = BowIndex::new(Arc::clone(vocabulary), params.bow.clone());
    map.iter().for_each(|(&id, bag)| index.add(id, bag));
    let ids: Vec<KeyframeId> = map.keys().copied().collect();
    let asked: Vec<(&KeyframeId, &WordBag)> = queries.iter().collect();
    let single: Vec<_> = asked.par_iter().map(|(_, bag)| index.query(*bag, params.candidates)).collect();
    let mut proposals: Vec<Proposal> = queries
        .keys()
        .zip(supported(&single, &ids, &params.sequence))
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
    thinned(proposals, &ids, &queries.keys().copied().collect::<Vec<_>>(), params.apart)
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
    let mut kept: Vec<(Proposal, usize, usize)> = Vec::new();
    for proposal in proposals {
        let (a, b) = (rank(ids, proposal.keyframe), rank(queries, proposal.query));
        let near = |&(_, x, y): &(Proposal, usize, usize)| x.abs_diff(a) < apart && y.abs_diff(b) < apart;
        if !kept.iter().any(near) {
            kept.push((proposal, a, b));
        }
    }
    kept.into_iter().map(|(proposal, _, _)| proposal).collect()
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
