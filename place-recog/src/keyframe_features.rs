//! The features of a map's keyframes: found now, or kept with the map and read when they are first asked for.

use crate::features::{Descriptor, Features, Keypoint, codec};
use map::{KeyframeId, SharedBytes};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The features of keyframes. Of a large map few are compared with others' once their words are known
/// ([`FeatureWords`](crate::FeatureWords)), so those that are stored stay so until then.
#[derive(Clone, Debug, Default)]
pub struct KeyframeFeatures(BTreeMap<KeyframeId, OfKeyframe>);

#[derive(Debug)]
struct OfKeyframe {
    /// As [`codec`] writes them.
    stored: Option<SharedBytes>,
    read: Mutex<Option<Arc<Features>>>,
}

impl OfKeyframe {
    fn read(&self) -> MutexGuard<'_, Option<Arc<Features>>> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Clone for OfKeyframe {
    fn clone(&self) -> Self {
        Self { stored: self.stored.clone(), read: Mutex::new(self.read().clone()) }
    }
}

impl KeyframeFeatures {
    /// Adds the features of a keyframe, or replaces them.
    pub fn insert(&mut self, id: KeyframeId, features: Features) {
        self.0.insert(id, OfKeyframe { stored: None, read: Mutex::new(Some(features.into())) });
    }

    /// The same for features as [`codec`] writes them. Those that cannot be read are none.
    pub fn insert_stored(&mut self, id: KeyframeId, bytes: SharedBytes) {
        self.0.insert(id, OfKeyframe { stored: Some(bytes), read: Mutex::default() });
    }

    /// Forgets a keyframe.
    pub fn remove(&mut self, id: KeyframeId) {
        self.0.remove(&id);
    }

    /// The features of a keyframe; `None` when it is not here.
    pub fn get(&self, id: KeyframeId) -> Option<Arc<Features>> {
        let of_keyframe = self.0.get(&id)?;
        let decoded = || {
            let stored = of_keyframe.stored.as_ref();
            Arc::new(stored.and_then(|bytes| codec::decode(bytes).ok()).unwrap_or_default())
        };
        Some(Arc::clone(of_keyframe.read().get_or_insert_with(decoded)))
    }

    /// What those that were read take, bytes, about.
    pub fn bytes(&self) -> usize {
        let read = self.0.values().filter_map(|of_keyframe| of_keyframe.read().clone());
        let of_one = size_of::<Keypoint>() + size_of::<Descriptor>();
        read.map(|features| features.len() * of_one).sum()
    }

    /// Gives back the memory of those that were read, until they are asked for again: they stay stored.
    pub fn rest(&self) {
        for of_keyframe in self.0.values() {
            if let Some(stored) = &of_keyframe.stored {
                drop(of_keyframe.read().take());
                stored.rest();
            }
        }
    }

    /// Whether the keyframe is here.
    pub fn contains(&self, id: KeyframeId) -> bool {
        self.0.contains_key(&id)
    }

    /// The keyframes that are here, ascending.
    pub fn keyframes(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        self.0.keys().copied()
    }

    /// How many keyframes are here.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether no keyframe is here.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl FromIterator<(KeyframeId, Features)> for KeyframeFeatures {
    fn from_iter<I: IntoIterator<Item = (KeyframeId, Features)>>(features: I) -> Self {
        let mut all = Self::default();
        features.into_iter().for_each(|(id, features)| all.insert(id, features));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some(count: usize) -> Features {
        let keypoint = |i: usize| Keypoint { pixel: [i as f32, 2.0], size: 4.0, angle: 0.0 };
        Features { keypoints: (0..count).map(keypoint).collect(), descriptors: vec![[20; 128]; count] }
    }

    #[test]
    fn stored_features_are_read_when_asked_for_and_unreadable_ones_are_none() {
        let mut all: KeyframeFeatures = [(KeyframeId(1), some(3))].into_iter().collect();
        all.insert_stored(KeyframeId(2), codec::encode(&some(7)).into());
        all.insert_stored(KeyframeId(3), vec![codec::encode(&some(7))[0], 9].into());
        let is_read = |all: &KeyframeFeatures, id| all.0[&KeyframeId(id)].read().is_some();
        for _ in 0..2 {
            assert!(is_read(&all, 1) && !is_read(&all, 2));
            let counts = all.keyframes().map(|id| all.get(id).unwrap().len());
            assert_eq!(counts.collect::<Vec<_>>(), [3, 7, 0]);
            assert!(is_read(&all, 2) && all.bytes() == 10 * (16 + 128));
            all.rest();
        }
        all.remove(KeyframeId(1));
        assert!(all.get(KeyframeId(1)).is_none() && !all.contains(KeyframeId(1)) && all.len() == 2);
    }
}
