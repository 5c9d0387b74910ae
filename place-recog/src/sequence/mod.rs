//! Temporal consistency: a camera that sees a place again sees its surroundings again too.
//!
//! The candidates of successive queries that lie near each other form an island (Gálvez-López & Tardós, "Bags of
//! Binary Words for Fast Place Recognition in Image Sequences", T-RO 2012); each candidate's score becomes the
//! mean over the queries around its own of the best score nearby. A chance likeness stands alone and loses. It
//! does not matter in which direction the places are passed the second time.

#[cfg(test)]
mod tests;

use map::{KeyframeId, PlaceCandidate};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How candidates of neighbouring queries support each other.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SequenceParams {
    /// Queries before and after that count. Default 2; 0 leaves scores as they are. More refuse more chance
    /// likenesses, and meetings that last only a few keyframes.
    pub reach: usize,
    /// How many keyframes the camera passes in the map while the query goes on by one, at most. Default 2; at
    /// least 1. More forgive a slower or faster camera and support by chance.
    pub pace: usize,
}

impl Default for SequenceParams {
    fn default() -> Self {
        Self { reach: 2, pace: 2 }
    }
}

/// Gives each candidate the support of the queries around its own, and orders each query's candidates anew, best
/// first; of equal ones the first keyframe.
///
/// `queries` are the candidates of successive keyframes of one agent, in order of time; `keyframes` are all
/// keyframes that were searched, in order of time. Scores must be comparable between queries.
pub fn supported(
    queries: &[Vec<PlaceCandidate>],
    keyframes: &[KeyframeId],
    params: &SequenceParams,
) -> Vec<Vec<PlaceCandidate>> {
    let rank: BTreeMap<KeyframeId, usize> = keyframes.iter().enumerate().map(|(i, &id)| (id, i)).collect();
    let ranked = |query: &Vec<PlaceCandidate>| {
        let of = |c: &PlaceCandidate| Some((*rank.get(&c.keyframe)?, c.score));
        let mut found: Vec<(usize, f32)> = query.iter().filter_map(of).collect();
        found.sort_by_key(|&(at, _)| at);
        found
    };
    let islands: Vec<Vec<(usize, f32)>> = queries.iter().map(ranked).collect();
    let rescored = |(i, query): (usize, &Vec<PlaceCandidate>)| {
        let around = i.saturating_sub(params.reach)..(i + params.reach + 1).min(queries.len());
        let rescore = |c: &PlaceCandidate| {
            let Some(&at) = rank.get(&c.keyframe) else { return *c };
            let support = |j: usize| {
                if j == i { c.score } else { best_near(&islands[j], at, i.abs_diff(j) * params.pace) }
            };
            PlaceCandidate { score: around.clone().map(support).sum::<f32>() / around.len() as f32, ..*c }
        };
        let mut rescored: Vec<PlaceCandidate> = query.iter().map(rescore).collect();
        rescored.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.keyframe.cmp(&b.keyframe)));
        rescored
    };
    queries.iter().enumerate().map(rescored).collect()
}

/// The best score within `reach` of `at`, 0 where there is none.
fn best_near(found: &[(usize, f32)], at: usize, reach: usize) -> f32 {
    let from = found.partition_point(|&(other, _)| other + reach < at);
    let near = found[from..].iter().take_while(|&&(other, _)| other <= at + reach);
    near.map(|&(_, score)| score).fold(0.0, f32::max)
}
