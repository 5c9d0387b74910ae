//! What the verdicts on all pairs of a command say together: which merges cannot stand.
//!
//! A verdict is a function of its two maps. How often pairs look alike by chance among many, and that a group may hold no two
//! places, only all of them can tell, so that is asked once, afterwards, of the numbers that the verdicts keep.

use super::{MergingParams, PairResult, PairResults};

/// A pair of inputs as far as others are concerned.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    inputs: [usize; 2],
    /// Whether the pair is merged.
    is_joined: bool,
    /// Whether the two show two places: they fit in all but what both saw of the surface.
    is_double: bool,
    /// `ln p(what both saw | one place) − ln p(… | two)`; 0 where that was not asked.
    ln_ratio: f64,
    /// ln of how often such a closure comes about by chance between two maps.
    ln_false_alarms: f64,
}

/// Why a merge cannot stand.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Why {
    /// Among so many pairs one like it may come about by chance.
    Chance { pairs: usize },
    /// It joins two inputs that show two places.
    Double([usize; 2]),
}

/// The merges that cannot stand beside the other verdicts, by their inputs, each with the reason; `names` are those of the inputs.
pub(super) fn contradicted(
    pair_results: &PairResults,
    params: &MergingParams,
    names: &[&str],
) -> Vec<([usize; 2], String)> {
    let pairs: Vec<Pair> = pair_results.iter().map(|pair_result| Pair::new(&pair_result, params)).collect();
    let limit = params.verification.closure.pair.two_view.max_false_alarms.ln();
    let found =
        taken_back(&pairs, limit).into_iter().map(|(index, why)| (pairs[index].inputs, why.text(names)));
    found.collect()
}

impl Pair {
    fn new(pair_result: &PairResult, params: &MergingParams) -> Self {
        let evaluated = pair_result.decisive();
        let evidence = evaluated.map(|evaluated| &evaluated.verdict.evidence);
        let place = evidence.and_then(|evidence| evidence.place);
        let tests = params.verification.matched_of(pair_result.proposed).max(1) as f64;
        Self {
            inputs: pair_result.as_given(),
            is_joined: pair_result.joined.is_some(),
            is_double: evaluated.is_some_and(|evaluated| evaluated.verdict.is_double()),
            ln_ratio: place.map_or(0.0, |place| place.ln_ratio),
            ln_false_alarms: evidence
                .map_or(f64::NEG_INFINITY, |evidence| evidence.ln_false_alarms + tests.ln()),
        }
    }
}

impl Why {
    fn text(self, names: &[&str]) -> String {
        match self {
            Self::Chance { pairs } => {
                format!("among {pairs} pairs of maps one may look so much alike by chance")
            }
            Self::Double([a, b]) => format!(
                "it would join {} and {}, which show two places; of the merges between them this is the least certain",
                names[a], names[b]
            ),
        }
    }
}

/// Which of the pairs, by index, are not to be joined, where no more false alarms than e^`limit` are expected of all together.
fn taken_back(pairs: &[Pair], limit: f64) -> Vec<(usize, Why)> {
    let chance = (pairs.len().max(1) as f64).ln();
    let mut taken = Vec::new();
    let mut stands: Vec<bool> = pairs.iter().map(|pair| pair.is_joined).collect();
    for (index, pair) in pairs.iter().enumerate() {
        if pair.is_joined && pair.ln_false_alarms + chance > limit {
            stands[index] = false;
            taken.push((index, Why::Chance { pairs: pairs.len() }));
        }
    }
    // Those that are told apart most surely first; of equals the earlier.
    let mut doubles: Vec<&Pair> = pairs.iter().filter(|pair| pair.is_double).collect();
    doubles.sort_by(|a, b| a.ln_ratio.total_cmp(&b.ln_ratio).then(a.inputs.cmp(&b.inputs)));
    for double in doubles {
        while let Some(weakest) = weakest_between(pairs, &stands, double.inputs) {
            stands[weakest] = false;
            taken.push((weakest, Why::Double(double.inputs)));
        }
    }
    taken
}

/// Of the most certain way over merges from one input to another its least certain merge; nothing where there is no way.
fn weakest_between(pairs: &[Pair], stands: &[bool], [from, to]: [usize; 2]) -> Option<usize> {
    let mut order: Vec<usize> = (0..pairs.len()).filter(|&index| stands[index]).collect();
    order.sort_by(|&a, &b| {
        pairs[b].ln_ratio.total_cmp(&pairs[a].ln_ratio).then(pairs[a].inputs.cmp(&pairs[b].inputs))
    });
    let inputs = pairs.iter().flat_map(|pair| pair.inputs).max()? + 1;
    let mut group: Vec<usize> = (0..inputs).collect();
    // The most certain first, until the one that joins both.
    order.into_iter().find(|&index| {
        let [a, b] = pairs[index].inputs.map(|input| group[input]);
        group.iter_mut().filter(|of| **of == b).for_each(|of| *of = a);
        group[from] == group[to]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joined(inputs: [usize; 2], ln_ratio: f64) -> Pair {
        Pair { inputs, is_joined: true, is_double: false, ln_ratio, ln_false_alarms: -100.0 }
    }

    fn double(inputs: [usize; 2]) -> Pair {
        Pair { is_joined: false, is_double: true, ..joined(inputs, -9.0) }
    }

    /// 0 and 3 are two places, joined over 1 and 2, and over 4 as well.
    #[test]
    fn what_joins_two_places_is_cut_where_it_is_weakest() {
        let pairs = [
            joined([0, 1], 8.0),
            joined([1, 2], 3.0),
            joined([2, 3], 7.0),
            double([0, 3]),
            joined([0, 4], 9.0),
            joined([3, 4], 2.0),
        ];
        let cut =
            |pairs: &[Pair]| taken_back(pairs, -13.8).into_iter().map(|(index, _)| index).collect::<Vec<_>>();
        assert_eq!(cut(&pairs), [1, 5]);
        // Whatever the order.
        let turned: Vec<Pair> = pairs.iter().rev().copied().collect();
        assert_eq!(cut(&turned), [4, 0]);
        // Who is told apart and not joined contradicts nothing.
        assert!(
            cut(&pairs[..4].iter().filter(|pair| pair.inputs != [1, 2]).copied().collect::<Vec<_>>())
                .is_empty()
        );
    }

    /// Of ten thousand pairs one like that is expected, of one not.
    #[test]
    fn among_many_pairs_more_is_asked_of_each() {
        let pair = Pair { ln_false_alarms: -20.0, ..joined([0, 1], 8.0) };
        assert!(taken_back(&[pair], -13.8).is_empty());
        let strangers = (0..10_000).map(|i| Pair { is_joined: false, ..joined([2 * i + 2, 2 * i + 3], 0.0) });
        let all: Vec<Pair> = std::iter::once(pair).chain(strangers).collect();
        assert_eq!(taken_back(&all, -13.8), [(0, Why::Chance { pairs: 10_001 })]);
    }
}
