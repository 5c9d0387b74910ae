//! One index over the keyframes of all maps: it grows map by map, and each new keyframe asks it once for its places in all
//! maps that came before.

use crate::{
    BowIndex, FabMap, Proposal, ProposeParams, ThumbnailIndex, Vocabulary, WordBag, propose::proposals,
};
use geometry::GrayImage;
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// By what keyframes are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IndexMethod {
    /// The words they share: [`BowIndex`].
    #[default]
    BagOfWords,
    /// The probability that they show one place: [`FabMap`].
    FabMap,
    /// A global descriptor, the small blurred image: [`ThumbnailIndex`]. It finds views from nearly the same spot only.
    Thumbnails,
}

/// What an index looks at of a keyframe.
#[derive(Clone, Copy, Debug)]
pub struct Appearance<'a> {
    /// The words of its features.
    pub words: &'a WordBag,
    /// Its image; without one [`IndexMethod::Thumbnails`] does not find it.
    pub image: Option<&'a GrayImage>,
}

/// Keyframes of several maps, to be searched at once.
pub struct CommonIndex {
    index: AnyIndex,
    params: ProposeParams,
    /// By the keyframe's number here: its map, from 0 on in the order of their coming, and its name there.
    entries: Vec<(usize, KeyframeId)>,
    /// The keyframes of each map, in order of time.
    maps: Vec<Vec<KeyframeId>>,
}

enum AnyIndex {
    Bow(BowIndex),
    FabMap(FabMap),
    Thumbnails(ThumbnailIndex),
}

impl CommonIndex {
    /// An empty one.
    pub fn new(vocabulary: &Arc<Vocabulary>, params: &ProposeParams) -> Self {
        let index = match params.method {
            IndexMethod::BagOfWords => {
                AnyIndex::Bow(BowIndex::new(Arc::clone(vocabulary), params.bow.clone()))
            }
            IndexMethod::FabMap => {
                AnyIndex::FabMap(FabMap::new(Arc::clone(vocabulary), params.fab_map.clone()))
            }
            IndexMethod::Thumbnails => AnyIndex::Thumbnails(ThumbnailIndex::new(params.thumbnails.clone())),
        };
        Self { index, params: params.clone(), entries: Vec::new(), maps: Vec::new() }
    }

    /// The number of maps in it.
    pub fn maps(&self) -> usize {
        self.maps.len()
    }

    /// Adds the keyframes of a map, whose ids are taken to grow with time; it is the next one.
    pub fn add<'a>(&mut self, keyframes: impl Iterator<Item = (KeyframeId, Appearance<'a>)>) {
        let map = self.maps.len();
        self.maps.push(Vec::new());
        for (id, appearance) in keyframes {
            let entry = KeyframeId(self.entries.len() as u32);
            self.entries.push((map, id));
            self.maps[map].push(id);
            self.index.add(entry, &appearance);
        }
    }

    /// Proposes the places that keyframes of one more map may share with each of `maps`, which are in the index: of each the
    /// best first.
    pub fn propose(&self, queries: &BTreeMap<KeyframeId, Appearance>, maps: &[usize]) -> Vec<Vec<Proposal>> {
        let mut group_of = vec![None; self.maps.len()];
        maps.iter().enumerate().for_each(|(group, &map)| group_of[map] = Some(group));
        let entry = |id: KeyframeId| self.entries[id.0 as usize];
        let group = |id: KeyframeId| group_of[entry(id).0];
        let ask = |appearance: &Appearance| -> Vec<Vec<PlaceCandidate>> {
            let mut of_maps = vec![Vec::new(); maps.len()];
            for found in self.index.query_each(appearance, self.params.candidates, maps.len(), &group) {
                let keyframe = entry(found.keyframe).1;
                if let Some(group) = group(found.keyframe) {
                    of_maps[group].push(PlaceCandidate { keyframe, ..found });
                }
            }
            of_maps
        };
        let (names, views): (Vec<KeyframeId>, Vec<&Appearance>) =
            queries.iter().map(|(id, appearance)| (*id, appearance)).unzip();
        let mut found: Vec<_> = views.into_par_iter().map(ask).collect();
        let of_map = |(group, &map): (usize, &usize)| {
            let single: Vec<_> =
                found.iter_mut().map(|of_maps| std::mem::take(&mut of_maps[group])).collect();
            proposals(&single, &names, &self.maps[map], &self.params)
        };
        maps.iter().enumerate().map(of_map).collect()
    }
}

impl AnyIndex {
    fn add(&mut self, id: KeyframeId, appearance: &Appearance) {
        match self {
            Self::Bow(index) => index.add(id, appearance.words),
            Self::FabMap(index) => index.add(id, appearance.words),
            Self::Thumbnails(index) => {
                if let Some(image) = appearance.image {
                    index.add(id, image);
                }
            }
        }
    }

    fn query_each(
        &self,
        appearance: &Appearance,
        count: usize,
        groups: usize,
        group: &dyn Fn(KeyframeId) -> Option<usize>,
    ) -> Vec<PlaceCandidate> {
        match (self, appearance.image) {
            (Self::Bow(index), _) => index.query_each(appearance.words, count, groups, group),
            (Self::FabMap(index), _) => index.query_each(appearance.words, count, groups, group),
            (Self::Thumbnails(index), Some(image)) => index.query_each(image, count, groups, group),
            (Self::Thumbnails(_), None) => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{WordId, propose};

    /// Words of a place, some of which another look at it has as well.
    fn look(place: u32, seed: u32) -> WordBag {
        let word = |i: u32, salt: u32| {
            (place * 977 + salt).wrapping_mul(2_654_435_761).wrapping_add(i * 40_503) >> 4
        };
        WordBag::new((0..60).map(|i| WordId(word(i, if i % 3 == 0 { 0 } else { seed }) % 28_000)))
    }

    fn map(places: std::ops::Range<u32>, seed: u32) -> BTreeMap<KeyframeId, WordBag> {
        places.map(|place| (KeyframeId(place * 3), look(place, seed))).collect()
    }

    fn seen(map: &BTreeMap<KeyframeId, WordBag>) -> BTreeMap<KeyframeId, Appearance<'_>> {
        map.iter().map(|(id, words)| (*id, Appearance { words, image: None })).collect()
    }

    #[test]
    fn asking_once_for_all_maps_finds_what_asking_for_each_does() {
        let vocabulary = Vocabulary::shipped();
        let maps = [map(0..40, 1), map(30..70, 2), map(60..110, 3)];
        let new = map(35..65, 4);
        for method in [IndexMethod::BagOfWords, IndexMethod::FabMap] {
            let params = ProposeParams { method, ..ProposeParams::default() };
            let mut index = CommonIndex::new(&vocabulary, &params);
            maps.iter().for_each(|map| index.add(seen(map).into_iter()));
            assert_eq!(index.maps(), 3);
            let all = index.propose(&seen(&new), &[2, 0, 1]);
            assert!(all.iter().all(|of_map| !of_map.is_empty()));
            if method == IndexMethod::BagOfWords {
                for (found, of_map) in all.iter().zip([2, 0, 1]) {
                    assert_eq!(*found, propose(&maps[of_map], &new, &vocabulary, &params), "{of_map}");
                }
            }
            // Only maps that are asked for.
            assert_eq!(index.propose(&seen(&new), &[0]).len(), 1);
        }
    }

    #[test]
    fn thumbnails_need_images() {
        let vocabulary = Vocabulary::shipped();
        let params = ProposeParams { method: IndexMethod::Thumbnails, ..ProposeParams::default() };
        let mut index = CommonIndex::new(&vocabulary, &params);
        let image = |seed: usize| {
            let pixel = |i: usize| ((i % 80) / (seed + 2) * 37 + (i / 80) / 9 * 53 * seed) as u8;
            GrayImage::from_vec(80, 60, (0..80 * 60).map(pixel).collect()).unwrap()
        };
        let (images, none): (Vec<GrayImage>, _) = ((1..9).map(image).collect(), WordBag::default());
        let seen = |i: usize| (KeyframeId(i as u32), Appearance { words: &none, image: Some(&images[i]) });
        index.add((0..8).map(seen));
        let query = BTreeMap::from([(KeyframeId(0), seen(5).1)]);
        assert_eq!(index.propose(&query, &[0])[0][0].keyframe, KeyframeId(5));
        let query = BTreeMap::from([(KeyframeId(0), Appearance { words: &none, image: None })]);
        assert!(index.propose(&query, &[0])[0].is_empty());
    }
}
