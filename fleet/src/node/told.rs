//! Maps that others tell: which version is known, and what of it is to be fetched.

mod taking;

use super::Heard;
use crate::hash::ObjectHash;
use crate::link::Want;
use crate::manifest::{Entry, Kind, Manifest, sensor_of};
use crate::store::Store;
use crate::wire::{Message, Offer};
use map::{SensorKind, Uuid};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Another's map.
pub(super) struct Told {
    /// Who tells it; nobody of one that was here when the program began.
    pub teller: Uuid,
    /// Whose agent it is, where parties have keys.
    pub party: Option<Uuid>,
    /// Its newest version.
    pub offer: Offer,
    /// The newest version of which the lists are here, if they are of the newest offered.
    manifest: Option<Manifest>,
    entries: Option<Arc<[Entry]>>,
    /// Objects of these that are not here, but for those that stand in for others.
    missing: BTreeSet<ObjectHash>,
    /// Those that stand in for others, until all others are here.
    stand_ins: BTreeSet<ObjectHash>,
    /// Objects that are fetched before others and did not come yet.
    awaited: BTreeSet<ObjectHash>,
    /// Objects that came.
    came: u64,
    /// All objects of these, lists among them.
    all: BTreeSet<ObjectHash>,
    /// The newest version that is whole here, and on the disk.
    held: (u64, u64),
    /// What the last whole version consists of.
    held_objects: BTreeSet<ObjectHash>,
    /// Objects of keyframes that come before others, the most wanted first.
    preferred: Vec<(Kind, u32)>,
    /// Whether all others come too.
    rest: bool,
}

impl Told {
    /// A map that was never heard of before.
    fn new(teller: Uuid, party: Option<Uuid>, offer: Offer, rest: bool) -> Self {
        let (manifest, entries, missing, stand_ins, all, held, held_objects, preferred) = Default::default();
        let (awaited, came) = Default::default();
        Self {
            teller,
            party,
            offer,
            manifest,
            entries,
            missing,
            stand_ins,
            awaited,
            came,
            all,
            held,
            held_objects,
            preferred,
            rest,
        }
    }

    /// A map that was whole when the program ended.
    pub fn whole(
        offer: Offer,
        party: Option<Uuid>,
        manifest: Manifest,
        entries: Vec<Entry>,
        store: &dyn Store,
    ) -> Self {
        let mut told = Self::new(Uuid::nil(), party, offer, true);
        told.set_lists(manifest, entries, store);
        (told.held, told.held_objects) = (offer.version(), told.all.clone());
        told
    }

    fn set_lists(&mut self, manifest: Manifest, entries: Vec<Entry>, store: &dyn Store) {
        let lists = manifest.pages.iter().map(|page| page.hash).chain([self.offer.hash]);
        self.all = entries.iter().map(|entry| entry.hash).chain(lists).collect();
        let (stand_ins, needed): (Vec<&Entry>, _) =
            entries.iter().partition(|entry| entry.kind.is_stand_in());
        self.missing = needed.iter().map(|entry| entry.hash).filter(|hash| !store.has(hash)).collect();
        self.stand_ins = stand_ins.iter().map(|entry| entry.hash).collect();
        (self.manifest, self.entries) = (Some(manifest), Some(entries.into()));
    }

    /// Whether it is of this party, where parties have keys, or else of this neighbour.
    fn is_of(&self, teller: Uuid, party: Option<Uuid>) -> bool {
        if party.is_some() { self.party == party } else { self.teller == teller }
    }

    /// Whether an object is one of the map's.
    pub fn has(&self, hash: &ObjectHash) -> bool {
        self.all.contains(hash) || self.held_objects.contains(hash)
    }

    /// What is said of it to whoever tells it.
    pub fn held(&self) -> Message {
        let missing = match &self.entries {
            Some(_) => self.missing.len() as u32,
            None if self.held == self.offer.version() => 0,
            None => u32::MAX,
        };
        let (begun, revision) = self.held;
        Message::Held { agent: self.offer.agent, begun, revision, missing }
    }

    /// How much of it is here, whoever tells it being near or not; `None` before its lists are.
    pub fn heard(&self, is_near: bool) -> Option<Heard> {
        let entries = Arc::clone(self.entries.as_ref()?);
        let (agent, begun, finished) = (self.offer.agent, self.offer.begun, self.is_finished());
        let (missing, came) = (self.missing.len(), self.came);
        Some(Heard { agent, begun, entries, missing, came, finished, is_near })
    }

    /// Whether the agent's run has ended, by the newest lists that are here.
    pub fn is_finished(&self) -> bool {
        self.manifest.as_ref().is_some_and(|manifest| manifest.finished)
    }

    /// Of how many keyframes the depth is listed.
    pub fn keyframes(&self) -> usize {
        let entries = self.entries.iter().flat_map(|entries| entries.iter());
        entries.filter(|entry| entry.kind == Kind::Depth).count()
    }

    /// The kind of the agent's sensor, once a keyframe is listed.
    pub fn sensor(&self) -> Option<SensorKind> {
        sensor_of(self.entries.as_deref().unwrap_or_default())
    }

    /// How many objects are not here yet.
    pub fn missing(&self) -> usize {
        self.missing.len()
    }

    /// What is to be fetched of it, the most urgent first; takes note of what of that is awaited.
    fn wants(&mut self, store: &dyn Store) -> Vec<Want> {
        // The lists of the newest version; as long as they are not here, what is known of the one before.
        let newest = self.manifest.as_ref().filter(|manifest| self.is_newest(manifest));
        let mut wants = Vec::new();
        if newest.is_none() {
            match store.get(&self.offer.hash).and_then(|bytes| Manifest::from_bytes(&bytes).ok()) {
                None => wants.push(Want { hash: self.offer.hash, size: self.offer.size }),
                Some(manifest) => {
                    let pages = manifest.pages.iter().filter(|page| !store.has(&page.hash));
                    wants.extend(pages.map(|page| Want { hash: page.hash, size: page.size }));
                }
            }
        }
        let lists = wants.iter().map(|want| want.hash);
        let mut awaited: BTreeSet<ObjectHash> = lists.collect();
        let places: BTreeMap<(Kind, u32), usize> = self.preferred.iter().copied().zip(0..).collect();
        let entries = self.entries.iter().flat_map(|entries| entries.iter());
        // What is chosen by, then what was chosen, keyframe by keyframe, then all that the whole map needs.
        let turn = |entry: &&Entry| {
            let place = places.get(&(entry.kind, entry.number)).copied();
            let is_missing = match entry.kind.is_stand_in() {
                true => place.is_some() && !self.missing.is_empty() && !store.has(&entry.hash),
                false => self.missing.contains(&entry.hash),
            };
            let turn = match (tier(entry.kind), place) {
                (0, _) => (0, entry.kind as usize),
                (_, Some(place)) => (1, place),
                (tier, None) => (tier, 0),
            };
            (is_missing && (turn.0 < 2 || self.rest)).then_some((turn, entry.number, entry.kind))
        };
        let mut entries: Vec<_> = entries.filter_map(|entry| Some((turn(&entry)?, entry))).collect();
        entries.sort_by_key(|(turn, _)| *turn);
        let first = entries.iter().take_while(|(((tier, _), ..), _)| *tier < 2);
        awaited.extend(first.map(|(_, entry)| entry.hash));
        wants.extend(entries.iter().map(|(_, entry)| Want { hash: entry.hash, size: entry.size }));
        self.awaited = awaited;
        wants
    }

    fn is_newest(&self, manifest: &Manifest) -> bool {
        (manifest.begun, manifest.revision) == self.offer.version()
    }
}

/// What comes before what of a map's objects; in between comes what is preferred.
fn tier(kind: Kind) -> usize {
    match kind {
        Kind::Agent | Kind::Poses => 0,
        Kind::Digest | Kind::Features => 2,
        Kind::LossyDepth | Kind::LossyImage | Kind::Depth | Kind::Image | Kind::Scan => 3,
        Kind::Edges | Kind::Frames => 4,
    }
}
