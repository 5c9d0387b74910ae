//! Direction of travel, and which neighbours of a loop closure pair up (Loop-box, §IV-B).
//!
//! A closure pairs keyframe i of the source with keyframe j of the target. Agents that travel in the same direction
//! see (i − 1, j − 1) and (i + 1, j + 1) alike; agents that meet, (i − 1, j + 1) and (i + 1, j − 1). The pairing
//! with more matches holds. Matches are counted, so their noise is Poisson's: a difference within it decides nothing.
//!
//! Fig. 2 of the paper has four states. Agents travel in the same direction (a, b) or in opposite ones (c, d): [`Travel`]
//! tells which. They have several loop closures (a, c) or only one (b, d): one is enough to merge their maps, and
//! [`further`](crate::further) looks for the others once it is found. `bench` measures all four as the cases `same`,
//! `same-once`, `opposite` and `opposite-once`.

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

/// How the direction is decided.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PairingParams {
    /// Least difference of the two pairings' match counts, in standard deviations of its noise. Default 3.0; above
    /// 0. Higher says "unknown" more often and is wrong less often.
    pub min_deviations: f64,
    /// Least share of the larger count by which the two must differ. Default 0.1; 0 to 1. Neighbours that hardly
    /// moved give pairs that match alike in both directions, with counts whose noise is not Poisson's alone.
    pub min_share: f64,
}

impl Default for PairingParams {
    fn default() -> Self {
        Self { min_deviations: 3.0, min_share: 0.1 }
    }
}

/// How the agents travelled past the common place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Travel {
    /// The same way: later keyframes of the source pair with later ones of the target.
    Same,
    /// Opposite ways: later keyframes of the source pair with earlier ones of the target.
    Opposite,
    /// The counts do not say.
    Unknown,
}

/// The pairs of adjacent keyframes of a closure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pairing {
    /// The direction.
    pub travel: Travel,
    /// Positions (source, target) in the lists of keyframes of the pairs z = −1, 0, 1, z counted along the source.
    /// The centre is always there; another is missing where a list ends or the direction is unknown.
    pub pairs: [Option<(usize, usize)>; 3],
    /// Matches of the neighbours if paired in the same direction, over the pairs compared.
    pub same_count: usize,
    /// Matches of the neighbours if paired in opposite directions, over the pairs compared.
    pub opposite_count: usize,
}

/// The pairs z = −1, 0, 1 of a direction around `(source, target)` in lists of the given lengths.
fn pairs(travel: Travel, centre: (usize, usize), lengths: (usize, usize)) -> [Option<(usize, usize)>; 3] {
    let at = |source: Option<usize>, target: Option<usize>| {
        let (source, target) = (source?, target?);
        (source < lengths.0 && target < lengths.1).then_some((source, target))
    };
    let (before, after) = (centre.0.checked_sub(1), centre.0.checked_add(1));
    let (earlier, later) = (centre.1.checked_sub(1), centre.1.checked_add(1));
    match travel {
        Travel::Same => [at(before, earlier), Some(centre), at(after, later)],
        Travel::Opposite => [at(before, later), Some(centre), at(after, earlier)],
        Travel::Unknown => [None, Some(centre), None],
    }
}

/// Decides the direction of travel around the closure of keyframes `centre` = (i, j), positions in the source's and
/// target's keyframes in order of time, of which there are `lengths`.
///
/// `count` gives how many matches two keyframes have, by position; matches that agree with one relative pose (γ of
/// [`crate::two_view`]) say more than raw ones. It is asked for at most four pairs, and not at all where the lists
/// end so that the directions cannot be compared. Nothing if `centre` is not in the lists.
///
/// Where a list ends, one pair of either direction can be missing. Then both directions are judged by one pair
/// each that exists, with the same neighbour of the one list: what a view shows is as rich for both.
pub fn pair_neighbours(
    centre: (usize, usize),
    lengths: (usize, usize),
    mut count: impl FnMut(usize, usize) -> usize,
    params: &PairingParams,
) -> Option<Pairing> {
    if centre.0 >= lengths.0 || centre.1 >= lengths.1 {
        return None;
    }
    let same = pairs(Travel::Same, centre, lengths);
    let opposite = pairs(Travel::Opposite, centre, lengths);
    let (mut same_count, mut opposite_count) = (0, 0);
    // Both directions by the same views: pairs that share their source, else pairs that share their target.
    let compared = [(0, 0), (2, 2), (0, 2), (2, 0)];
    let both = |&(s, o): &(usize, usize)| Some((same[s]?, opposite[o]?));
    let shared_source = compared[..2].iter().filter_map(both).collect::<Vec<_>>();
    let chosen = if shared_source.is_empty() {
        compared[2..].iter().filter_map(both).collect()
    } else {
        shared_source
    };
    for (s, o) in chosen {
        same_count += count(s.0, s.1);
        opposite_count += count(o.0, o.1);
    }
    let travel = decide(same_count, opposite_count, params);
    Some(Pairing { travel, pairs: pairs(travel, centre, lengths), same_count, opposite_count })
}

/// The direction that two counts speak for.
fn decide(same: usize, opposite: usize, params: &PairingParams) -> Travel {
    let (larger, difference) = (same.max(opposite) as f64, same.abs_diff(opposite) as f64);
    // The variance of a difference of two Poisson counts is estimated by their sum.
    let noise = ((same + opposite) as f64).sqrt();
    let clear = difference > 0.0
        && difference >= params.min_deviations * noise
        && difference >= params.min_share * larger;
    match (clear, same > opposite) {
        (false, _) => Travel::Unknown,
        (true, true) => Travel::Same,
        (true, false) => Travel::Opposite,
    }
}
