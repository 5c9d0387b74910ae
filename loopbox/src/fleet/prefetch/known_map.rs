//! What is known of an agent's map before its images and depths come.

use crate::fleet::agents::FEWEST;
use features::codec;
use fleet::hash::ObjectHash;
use fleet::lossy_codec::digest::Digest;
use fleet::manifest::{Entry, Kind, sensor_of};
use fleet::node::MapSnapshot;
use fleet::store::Objects;
use geometry::{Pinhole, Sim3};
use map::parts::{agent_from_bytes, graph_from_bytes};
use map::{KeyframeId, SensorKind};
use merge::overlap::Glimpse;
use place_recog::{DirectIndex, Directed, KeyframeFeatures, Vocabulary, WordBag};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What a keyframe is merged by, the features first: without them there is nothing to match.
const PARTS: [Kind; 3] = [Kind::Features, Kind::LossyDepth, Kind::LossyImage];

/// How long another one that a pair is left to may take before one looks oneself, and how long a map waits for its pairs before all of
/// it is fetched: twice what two maps of 100 keyframes may take over 256 kbit/s.
pub(super) const PATIENCE: Duration = Duration::from_secs(180);

/// What is known of an agent's map.
#[derive(Default)]
pub(super) struct KnownMap {
    entries: Option<Arc<[Entry]>>,
    sensor: Option<SensorKind>,
    listed: BTreeMap<(Kind, u32), ObjectHash>,
    digests: BTreeMap<KeyframeId, (ObjectHash, Digest)>,
    /// Of keyframes with depth.
    pub words: BTreeMap<KeyframeId, WordBag>,
    features: KeyframeFeatures,
    index: BTreeMap<KeyframeId, DirectIndex>,
    /// Keyframes whose digests are not here.
    pub missing: usize,
    /// How often it changed.
    pub version: u64,
    /// Since when something is known of it.
    pub since: Option<Instant>,
}

impl KnownMap {
    /// Takes in what came since.
    ///
    /// # Errors
    /// When a digest is none.
    pub fn update(
        &mut self,
        snapshot: &MapSnapshot,
        store: &dyn Objects,
        vocabulary: &Vocabulary,
    ) -> Result<(), String> {
        self.since.get_or_insert_with(Instant::now);
        let same = self.entries.as_ref().is_some_and(|known| Arc::ptr_eq(known, &snapshot.entries));
        if same && self.missing == 0 {
            return Ok(());
        }
        self.listed = snapshot.entries.iter().map(|entry| ((entry.kind, entry.number), entry.hash)).collect();
        self.entries = Some(Arc::clone(&snapshot.entries));
        self.sensor = sensor_of(&snapshot.entries);
        self.missing = 0;
        for entry in snapshot.entries.iter().filter(|entry| entry.kind == Kind::Digest) {
            let id = KeyframeId(entry.number);
            if self.digests.get(&id).is_some_and(|(hash, _)| *hash == entry.hash) {
                continue;
            }
            let Some(bytes) = store.get(&entry.hash) else {
                self.missing += 1;
                continue;
            };
            let digest = Digest::from_bytes(&bytes, id, vocabulary)
                .map_err(|what| format!("the digest of keyframe {} cannot be read: {what}", id.0))?;
            if !digest.samples.is_empty() {
                self.words.insert(id, digest.words.clone());
            }
            self.digests.insert(id, (entry.hash, digest));
            self.version += 1;
        }
        let is_listed = |id: &KeyframeId| self.listed.contains_key(&(Kind::Digest, id.0));
        let before = self.digests.len();
        self.digests.retain(|id, _| is_listed(id));
        self.words.retain(|id, _| is_listed(id));
        self.version += u64::from(self.digests.len() != before);
        Ok(())
    }

    /// Whether it is known for so long that nobody waits for what becomes of its pairs any more.
    pub fn is_overdue(&self) -> bool {
        self.since.is_some_and(|since| since.elapsed() >= PATIENCE)
    }

    /// Whether agents may meet: their sensors are of one kind, as far as is known.
    pub fn may_meet(&self, other: &Self) -> bool {
        self.sensor.zip(other.sensor).is_none_or(|(one, other)| one == other)
    }

    /// The digests that are not here.
    pub fn lacking_digests(&self) -> Vec<(Kind, u32)> {
        let listed = self.listed.range((Kind::Digest, 0)..=(Kind::Digest, u32::MAX));
        let lacking = listed.filter(|((_, number), hash)| {
            self.digests.get(&KeyframeId(*number)).is_none_or(|(known, _)| known != *hash)
        });
        lacking.map(|(object, _)| *object).collect()
    }

    /// Whether an object is here, or what it stands in for.
    fn has(&self, kind: Kind, id: KeyframeId, store: &dyn Objects) -> bool {
        let has = |kind: Kind| self.listed.get(&(kind, id.0)).is_some_and(|hash| store.has(hash));
        kind.stands_in_for().is_some_and(has) || has(kind) || !self.listed.contains_key(&(kind, id.0))
    }

    /// Of the objects by which keyframes are merged, those that are not here.
    pub fn lacks(&self, keyframes: &[KeyframeId], store: &dyn Objects) -> Vec<(Kind, u32)> {
        let parts = keyframes.iter().flat_map(|id| PARTS.map(|kind| (kind, *id)));
        parts.filter(|(kind, id)| !self.has(*kind, *id, store)).map(|(kind, id)| (kind, id.0)).collect()
    }

    /// Reads the features of keyframes; those that are not here.
    pub fn read(
        &mut self,
        keyframes: &[KeyframeId],
        store: &dyn Objects,
        vocabulary: &Vocabulary,
    ) -> Vec<(Kind, u32)> {
        let mut lacking = Vec::new();
        for &id in keyframes {
            if self.features.contains(id) {
                continue;
            }
            if !self.has(Kind::Features, id, store) {
                lacking.push((Kind::Features, id.0));
                continue;
            }
            let listed = self.listed.get(&(Kind::Features, id.0)).map(|hash| store.get(hash));
            if let Some(None) = listed {
                // It was damaged, and comes again.
                lacking.push((Kind::Features, id.0));
                continue;
            }
            // What cannot be read is found again from the image.
            let features = listed.flatten().and_then(|bytes| codec::decode(&bytes).ok()).unwrap_or_default();
            self.index.insert(id, DirectIndex::with_words(&features, vocabulary).0);
            self.features.insert(id, features);
        }
        lacking
    }

    /// The keyframes that were read, as the direct index needs them.
    pub fn directed(&self) -> Directed<'_> {
        Directed { features: &self.features, index: &self.index }
    }

    /// All keyframes with depth.
    pub fn all(&self) -> Vec<KeyframeId> {
        self.words.keys().copied().collect()
    }

    /// The keyframe and those next to it, after it and before it in turn: [`FEWEST`] adjacent ones, also at the first and
    /// at the last.
    pub fn around(&self, id: KeyframeId) -> Vec<KeyframeId> {
        let after = self.words.range(id..).take(FEWEST).enumerate().map(|(far, (id, _))| (2 * far, *id));
        let before =
            self.words.range(..id).rev().take(FEWEST).enumerate().map(|(far, (id, _))| (2 * far + 3, *id));
        let nearest: BTreeMap<usize, KeyframeId> = after.chain(before).collect();
        nearest.into_values().take(FEWEST).collect()
    }

    /// The agent's camera and the poses of its keyframes, as far as they are here.
    pub fn places(&self, store: &dyn Objects) -> Option<(Pinhole, BTreeMap<KeyframeId, Sim3>)> {
        let objects = |kind: Kind| {
            let listed = self.listed.range((kind, 0)..=(kind, u32::MAX));
            listed.filter_map(|(_, hash)| store.get(hash))
        };
        let camera = *agent_from_bytes(&objects(Kind::Agent).next()?).ok()?.camera()?;
        let parts = objects(Kind::Poses).filter_map(|bytes| graph_from_bytes(&bytes).ok());
        Some((camera, parts.flat_map(|part| part.poses).collect()))
    }

    /// The keyframes with depth as they are told of by their digests.
    pub fn glimpses<'a>(&self, camera: &'a Pinhole, poses: &BTreeMap<KeyframeId, Sim3>) -> Vec<Glimpse<'a>> {
        let glimpse = |(id, (_, digest)): (&KeyframeId, &(ObjectHash, Digest))| {
            Glimpse::new(*id, *poses.get(id)?, camera, digest.samples.iter().copied())
        };
        self.digests.iter().filter_map(glimpse).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn around_every_keyframe_there_are_as_many_as_a_closure_rests_on() {
        let mut known_map = KnownMap::default();
        let numbers = [2, 3, 7, 8, 9];
        for (number, expected) in [(2, vec![2]), (3, vec![3, 2])] {
            known_map.words.insert(KeyframeId(number), WordBag::default());
            assert_eq!(
                known_map.around(KeyframeId(number)),
                expected.into_iter().map(KeyframeId).collect::<Vec<_>>()
            );
        }
        known_map.words.extend(numbers.map(|number| (KeyframeId(number), WordBag::default())));
        let cases = [(2, [2, 3, 7]), (3, [3, 7, 2]), (8, [8, 9, 7]), (9, [9, 8, 7])];
        for (number, expected) in cases {
            assert_eq!(known_map.around(KeyframeId(number)), expected.map(KeyframeId));
        }
    }
}
