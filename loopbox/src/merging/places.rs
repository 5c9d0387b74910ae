//! Which places every two maps may share: one index over all of them, asked once for each keyframe.

use super::{Input, MergingParams};
use map::KeyframeId;
use place_recog::{Appearance, CommonIndex, Proposal, Vocabulary};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// The places of two maps.
#[derive(Default)]
pub(crate) struct Places {
    /// Best first.
    pub proposals: Vec<Proposal>,
    /// What its part of the queries took, seconds.
    pub seconds: f64,
}

/// The places that the keyframes of each input may share with the inputs before it in [`order`], of the pairs that are
/// `wanted`, by target and source.
pub(super) fn places(
    inputs: &[Input],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    wanted: &dyn Fn([usize; 2]) -> bool,
) -> BTreeMap<[usize; 2], Places> {
    let order = order(inputs);
    let mut index = CommonIndex::new(vocabulary, &params.places);
    let mut all = BTreeMap::new();
    // Maps that no later one asks for, and those that ask for none, cost nothing.
    let wanted = |earlier: usize, later: usize| wanted([earlier.min(later), earlier.max(later)]);
    let mut numbers: Vec<usize> = Vec::new();
    for (at, &source) in order.iter().enumerate() {
        let start = Instant::now();
        let of_source = seen(&inputs[source]);
        let maps: Vec<usize> = (0..numbers.len()).filter(|&map| wanted(numbers[map], source)).collect();
        if !maps.is_empty() {
            let found = index.propose(&of_source, &maps);
            let seconds = start.elapsed().as_secs_f64() / maps.len() as f64;
            for (map, proposals) in maps.into_iter().zip(found) {
                all.insert([numbers[map], source], Places { proposals, seconds });
            }
        }
        if order[at + 1..].iter().any(|&later| wanted(source, later)) {
            index.add(of_source.into_iter());
            numbers.push(source);
        }
    }
    all
}

/// What the index looks at of a map's keyframes.
fn seen(input: &Input) -> BTreeMap<KeyframeId, Appearance<'_>> {
    let seen = |(id, words): (&KeyframeId, _)| {
        let image = input.map.keyframes.get(id).map(|keyframe| &*keyframe.image);
        (*id, Appearance { words, image })
    };
    input.words.iter().map(seen).collect()
}

/// The inputs in the order in which they are searched, whatever the order in which they are given: by when they were
/// recorded, then by what they hold. Of two the first is the target. Maps alike in all of this are one map, which is not
/// merged with itself.
pub(super) fn order(inputs: &[Input]) -> Vec<usize> {
    fn key(input: &Input) -> (u64, usize, &[u8]) {
        let first = input.map.keyframes.values().next();
        let time = first.map_or(0, |keyframe| keyframe.timestamp.to_bits());
        let pixels = first.map_or(&[][..], |keyframe| keyframe.image.data());
        (time, input.map.keyframes.len(), pixels)
    }
    let mut order: Vec<usize> = (0..inputs.len()).collect();
    order.sort_by(|&a, &b| key(&inputs[a]).cmp(&key(&inputs[b])));
    order
}
