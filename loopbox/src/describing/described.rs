//! The features and words of a map's keyframes.

use super::complete as find_features;
use features::{Features, codec};
use geometry::Swap;
use map::{Keyframe, KeyframeId, Map, SharedBytes};
use place_recog::{FeatureWords, KeyframeFeatures, Vocabulary};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The features that are kept with a keyframe; nothing where there are none, or none that can be read.
pub(crate) fn decoded(keyframe: &Keyframe) -> Option<Features> {
    codec::decode(keyframe.features.as_deref()?).ok()
}

/// Gives the keyframes of a map the features and words that a merge would give them. `swap` keeps those found now, as far as
/// it has room.
pub(crate) fn describe(map: &mut Map, vocabulary: &Vocabulary, swap: Option<&dyn Swap>) {
    Described::of(map, vocabulary, swap);
}

/// What a map's keyframes with depth look like. Keyframes without could be recognised, but nothing could come of it.
#[derive(Default)]
pub(crate) struct Described {
    pub features: KeyframeFeatures,
    pub words: BTreeMap<KeyframeId, FeatureWords>,
    /// Of how many keyframes the features were found now.
    pub found: usize,
}

impl Described {
    /// Features and words that are kept in the map; where it has none, or none that can be read, those found now, which it
    /// keeps from now on, by `swap` as far as that has room.
    pub fn of(map: &mut Map, vocabulary: &Vocabulary, swap: Option<&dyn Swap>) -> Self {
        let mut all = Self::default();
        all.take_in(map, vocabulary, swap);
        all.found = find_features(map, swap);
        if all.found > 0 {
            // As they come back from the map, so that it makes no difference when they were found.
            all.take_in(map, vocabulary, swap);
        }
        all
    }

    /// Takes in the keyframes that are not here and have features.
    fn take_in(&mut self, map: &mut Map, vocabulary: &Vocabulary, swap: Option<&dyn Swap>) {
        let lacks = |(id, keyframe): &(&KeyframeId, &mut Keyframe)| {
            !keyframe.semi_dense.is_empty() && !self.features.contains(**id)
        };
        let looked_up: Vec<_> = map
            .keyframes
            .par_iter_mut()
            .filter(lacks)
            .filter_map(|(id, keyframe)| {
                let (words, stored) = look_up(keyframe, vocabulary, swap)?;
                stored.rest();
                Some((*id, words, stored))
            })
            .collect();
        for (id, words, stored) in looked_up {
            self.features.insert_stored(id, stored);
            self.words.insert(id, words);
        }
    }
}

/// The words of the features that are kept with a keyframe, kept with them or looked up now, and the features; nothing where
/// there are none, or none that can be read, which are forgotten.
fn look_up(
    keyframe: &mut Keyframe,
    vocabulary: &Vocabulary,
    swap: Option<&dyn Swap>,
) -> Option<(FeatureWords, SharedBytes)> {
    let kept = keyframe.words.as_deref().and_then(|words| FeatureWords::from_bytes(words, vocabulary));
    if let Some(found) = kept.zip(keyframe.features.clone()) {
        return Some(found);
    }
    let Some(features) = decoded(keyframe) else {
        (keyframe.features, keyframe.words) = (None, None);
        return None;
    };
    let words = FeatureWords::of(&features, vocabulary);
    keyframe.words = Some(SharedBytes::kept_by(swap, words.to_bytes(vocabulary)));
    Some((words, keyframe.features.clone()?))
}
