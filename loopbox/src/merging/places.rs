//! Which places every two maps may share.

#[cfg(test)]
mod tests;

use super::{Input, MergingParams};
use geometry::{GrayImage, Swap};
use map::{Keyframe, KeyframeId};
use place_recog::{Appearance, CommonIndex, IndexMethod, Proposal, ProposeParams, Vocabulary, WordBag};
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

/// What place recognition looks at of a map: its words, and few images or none. Without the map it takes a hundredth of the memory.
#[derive(Clone, Debug)]
pub(crate) struct Appearances {
    words: Arc<BTreeMap<KeyframeId, WordBag>>,
    /// The images of the first keyframe and of those that the index looks at.
    images: BTreeMap<KeyframeId, Arc<GrayImage>>,
    /// When the first keyframe was recorded, as the bits of its time in seconds; 0 without any.
    begin: u64,
    /// How many keyframes the map has.
    keyframes: usize,
}

impl Appearances {
    /// Those of an input, with which it shares what is large.
    pub fn of(input: &Input, params: &ProposeParams) -> Self {
        let keyframes = &input.map.keyframes;
        let count = if params.method == IndexMethod::Thumbnails { keyframes.len() } else { 1 };
        let image = |keyframe: &Keyframe| (keyframe.id, Arc::clone(&keyframe.image));
        Self {
            words: Arc::clone(&input.words),
            images: keyframes.values().take(count).map(image).collect(),
            begin: keyframes.values().next().map_or(0, |keyframe| keyframe.timestamp.to_bits()),
            keyframes: keyframes.len(),
        }
    }

    /// The same with images of their own, which `swap` keeps as far as it has room: nothing of the map is held any more.
    pub fn apart(mut self, swap: &dyn Swap) -> Self {
        for image in self.images.values_mut() {
            let pixels = image.data().to_vec();
            let copy = GrayImage::from_vec(image.width(), image.height(), pixels).unwrap_or_default();
            *image = Arc::new(copy.swapped_out(swap).unwrap_or(copy));
            image.rest();
        }
        self
    }

    /// What the index looks at of the keyframes.
    fn of_keyframes(&self) -> BTreeMap<KeyframeId, Appearance<'_>> {
        let seen = |(id, words): (&KeyframeId, _)| {
            let image = self.images.get(id).map(|image| &**image);
            (*id, Appearance { words, image })
        };
        self.words.iter().map(seen).collect()
    }

    /// The first keyframe's pixels.
    fn first_pixels(&self) -> &[u8] {
        self.images.values().next().map_or(&[], |image| image.data())
    }
}

/// The places that the keyframes of each map may share with the maps before it in [`order`], of the pairs that are `wanted`, by
/// target and source. Each map has an index of its own, so that what a pair gets does not depend on which other maps there are.
pub(super) fn places(
    maps: &[Appearances],
    vocabulary: &Arc<Vocabulary>,
    params: &MergingParams,
    wanted: &dyn Fn([usize; 2]) -> bool,
) -> BTreeMap<[usize; 2], Places> {
    let order = order(maps);
    let mut all = BTreeMap::new();
    for (at, &target) in order.iter().enumerate() {
        let is_wanted = |source: &usize| wanted([target.min(*source), target.max(*source)]);
        let sources: Vec<usize> = order[at + 1..].iter().copied().filter(is_wanted).collect();
        // A map that no later one asks for costs nothing.
        if sources.is_empty() {
            continue;
        }
        let mut index = CommonIndex::new(vocabulary, &params.places);
        index.add(maps[target].of_keyframes().into_iter());
        for source in sources {
            let start = Instant::now();
            let proposals = index.propose(&maps[source].of_keyframes(), &[0]).pop().unwrap_or_default();
            all.insert([target, source], Places { proposals, seconds: start.elapsed().as_secs_f64() });
        }
    }
    all
}

/// The same of all pairs by one index over all maps, which is asked once for each keyframe. Of many maps it scores the likeliest keyframes
/// alone, so it tells which pairs are worth a verdict, and not what the verdict rests on.
pub(super) fn likely_places(
    maps: &[Appearances],
    vocabulary: &Arc<Vocabulary>,
    params: &ProposeParams,
) -> BTreeMap<[usize; 2], Vec<Proposal>> {
    let order = order(maps);
    let mut index = CommonIndex::new(vocabulary, params);
    let mut all = BTreeMap::new();
    for (at, &source) in order.iter().enumerate() {
        let of_source = maps[source].of_keyframes();
        let found = index.propose(&of_source, &(0..at).collect::<Vec<_>>());
        all.extend(order[..at].iter().zip(found).map(|(&target, proposals)| ([target, source], proposals)));
        index.add(of_source.into_iter());
    }
    all
}

/// The maps in the order in which they are searched, whatever the order in which they are given: by when they were recorded,
/// then by what they hold. Of two the first is the target. Maps alike in all of this are one map, which is not merged with itself.
fn order(maps: &[Appearances]) -> Vec<usize> {
    let key = |map: usize| (maps[map].begin, maps[map].keyframes, maps[map].first_pixels());
    let mut order: Vec<usize> = (0..maps.len()).collect();
    order.sort_by(|&a, &b| key(a).cmp(&key(b)));
    order
}
