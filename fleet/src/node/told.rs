//! Maps that others tell: which version is known, and what of it is to be fetched.

use super::quota::Load;
use super::{Action, DISK_PAUSE, Heard, LinkId, News, Node};
use crate::assembling::entries_of;
use crate::hash::ObjectHash;
use crate::keys::Signature;
use crate::link::Want;
use crate::manifest::{Entry, Kind, Manifest};
use crate::store::{Head, Store};
use crate::wire::{Message, Offer};
use map::Uuid;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

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
        let came = 0;
        Self {
            teller,
            party,
            offer,
            manifest,
            entries,
            missing,
            stand_ins,
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

    /// How much of it is here; `None` before its lists are.
    pub fn heard(&self) -> Option<Heard> {
        let entries = Arc::clone(self.entries.as_ref()?);
        let finished = self.manifest.as_ref().is_some_and(|manifest| manifest.finished);
        let (agent, begun) = (self.offer.agent, self.offer.begun);
        let (missing, came) = (self.missing.len(), self.came);
        Some(Heard { agent, begun, entries, missing, came, finished })
    }

    /// Of how many keyframes the depth is listed.
    pub fn keyframes(&self) -> usize {
        let entries = self.entries.iter().flat_map(|entries| entries.iter());
        entries.filter(|entry| entry.kind == Kind::Depth).count()
    }

    /// How many objects are not here yet.
    pub fn missing(&self) -> usize {
        self.missing.len()
    }

    /// What is to be fetched of it, the most urgent first.
    fn wants(&self, store: &dyn Store) -> Vec<Want> {
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
        wants.extend(entries.iter().map(|(_, entry)| Want { hash: entry.hash, size: entry.size }));
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
        Kind::LossyDepth | Kind::LossyImage | Kind::Depth | Kind::Image => 3,
        Kind::Edges | Kind::Frames => 4,
    }
}

impl Node {
    /// A neighbour says which version of a map it has.
    pub(super) fn offered(&mut self, link: LinkId, node: Uuid, offer: Offer, signature: Option<Signature>) {
        let Some(known) = self.links.get(&link) else { return };
        if let Err(reason) = self.may_tell(known, &offer, signature.as_ref()) {
            return self.refuse(link, reason);
        }
        let party = known.party.as_ref().map(|party| party.id);
        if self.own.contains_key(&offer.agent) {
            let agent = offer.agent;
            let reason = format!(
                "it tells the map of agent {agent}, which is told here: two runs of one recording are one agent"
            );
            return self.refuse(link, reason);
        }
        let is_linked = |teller: &Uuid| self.neighbours.get(teller).is_some_and(|n| n.link.is_some());
        match self.told.get_mut(&offer.agent) {
            None => {
                let told = self.told.values().filter(|told| told.is_of(node, party)).count();
                if told >= self.config.quota.maps {
                    return self.refuse(link, format!("it tells more than {told} maps, as many as one may"));
                }
                let told = Told::new(node, party, offer, !self.config.waits);
                self.told.insert(offer.agent, told);
            }
            Some(told) if told.teller != node && is_linked(&told.teller) => {
                let agent = offer.agent;
                return self
                    .refuse(link, format!("it tells the map of agent {agent}, which another one tells"));
            }
            Some(told) => {
                if offer.version() < told.offer.version() {
                    // An older one, that comes late or is told again by who must not: the newer stays.
                    return;
                }
                let is_new = offer.version() > told.offer.version();
                if !is_new && offer.hash != told.offer.hash {
                    let reason = "it tells two maps as the same version of one".into();
                    return self.refuse(link, reason);
                }
                let is_told_again = told.teller != node;
                (told.teller, told.party) = (node, party.or(told.party));
                if !is_new && !is_told_again {
                    return;
                }
                told.offer = offer;
            }
        }
        self.lists(link, offer.agent);
        self.want(node);
    }

    /// What is to be fetched from a neighbour by now.
    pub(super) fn want(&mut self, node: Uuid) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        let newer = neighbour.findings.filter(|findings| findings.revision > neighbour.findings_here);
        let mut wants: Vec<Want> =
            newer.iter().map(|findings| Want { hash: findings.hash, size: findings.size }).collect();
        for told in self.told.values().filter(|told| told.teller == node) {
            wants.extend(told.wants(&*self.store));
        }
        let mut seen = BTreeSet::new();
        wants.retain(|want| seen.insert(want.hash));
        neighbour.fetch.want(wants);
    }

    /// Fetches some objects before others, or others too.
    pub(super) fn prefer(&mut self, agent: map::Identity, objects: Vec<(Kind, u32)>, rest: bool) {
        let Some(told) = self.told.get_mut(&agent) else { return };
        if told.preferred == objects && told.rest == rest {
            return;
        }
        (told.preferred, told.rest) = (objects, rest);
        let teller = told.teller;
        self.want(teller);
    }

    /// An object came.
    pub(super) fn object(
        &mut self,
        now: Duration,
        link: LinkId,
        node: Uuid,
        hash: ObjectHash,
        bytes: Vec<u8>,
    ) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        if let Some(findings) = neighbour.findings.filter(|findings| findings.hash == hash) {
            neighbour.findings_here = findings.revision;
            return self.actions.push(Action::News(News::Findings { from: node, bytes }));
        }
        if let Err(error) = self.store.put(&hash, &bytes) {
            self.paused_until = now + DISK_PAUSE;
            let text = format!("what others tell cannot be kept: {error}; it is tried again");
            self.actions.push(Action::News(News::Trouble(text)));
            return self.want(node);
        }
        let agents: Vec<_> =
            self.told.iter().filter(|(_, told)| told.teller == node).map(|(agent, _)| *agent).collect();
        let mut lists_came = false;
        for agent in agents {
            let Some(told) = self.told.get_mut(&agent) else { continue };
            if told.missing.remove(&hash) || told.stand_ins.contains(&hash) {
                told.came += 1;
                self.actions.extend(told.heard().map(|heard| Action::News(News::Map(heard))));
                self.complete(link, agent);
            } else if !told.all.contains(&hash) {
                lists_came |= self.lists(link, agent);
            }
        }
        if lists_came {
            self.want(node);
        }
    }

    /// Takes the lists of a map's newest version, as far as they are here; whether there is more to fetch now.
    fn lists(&mut self, link: LinkId, agent: map::Identity) -> bool {
        let Some(told) = self.told.get(&agent) else { return false };
        if told.manifest.as_ref().is_some_and(|manifest| told.is_newest(manifest)) {
            return false;
        }
        let Some(bytes) = self.store.get(&told.offer.hash) else { return false };
        let manifest = match Manifest::from_bytes(&bytes) {
            Ok(manifest) if manifest.agent == agent && told.is_newest(&manifest) => manifest,
            Ok(_) => {
                self.refuse(link, "it tells another map than it says".into());
                return false;
            }
            Err(what) => {
                self.refuse(link, format!("the list of its map's objects cannot be read: {what}"));
                return false;
            }
        };
        let entries = entries_of(&manifest, &*self.store);
        let (teller, party, quota) = (told.teller, told.party, self.config.quota);
        let others = self.told.values().filter(|told| told.offer.agent != agent && told.is_of(teller, party));
        let others = Load::of(others.flat_map(|told| told.entries.iter().flat_map(|entries| entries.iter())));
        match entries.and_then(|entries| {
            quota.check(others + Load::of(entries.iter().flatten()))?;
            Ok(entries)
        }) {
            Err(reason) => {
                self.refuse(link, reason);
                return false;
            }
            // Pages are missing, which are known now.
            Ok(None) => return true,
            Ok(Some(entries)) => {
                let Some(told) = self.told.get_mut(&agent) else { return false };
                told.set_lists(manifest, entries, &*self.store);
            }
        }
        let Some(told) = self.told.get(&agent) else { return false };
        self.actions.extend(told.heard().map(|heard| Action::News(News::Map(heard))));
        self.complete(link, agent);
        true
    }

    /// Tries again what the disk refused before.
    pub(super) fn complete_all(&mut self) {
        let agents: Vec<_> = self.told.keys().copied().collect();
        for agent in agents {
            let teller = self.told.get(&agent).and_then(|told| self.neighbours.get(&told.teller));
            if let Some(link) = teller.and_then(|neighbour| neighbour.link) {
                self.complete(link, agent);
            }
        }
    }

    /// Acknowledges a map of which nothing is missing any more, once it is on the disk.
    fn complete(&mut self, link: LinkId, agent: map::Identity) {
        let Some(told) = self.told.get_mut(&agent) else { return };
        let is_newest = told.manifest.as_ref().is_some_and(|manifest| told.is_newest(manifest));
        if !told.missing.is_empty() || !is_newest || told.held == told.offer.version() {
            return;
        }
        let head = Head { manifest: told.offer.hash, own: false, party: told.party };
        if let Err(error) = self.store.set_head(agent, head) {
            let text = format!("what others tell cannot be kept: {error}; it is tried again");
            return self.actions.push(Action::News(News::Trouble(text)));
        }
        told.held = told.offer.version();
        // What stood in for others is needed no more.
        let stand_ins = std::mem::take(&mut told.stand_ins);
        told.all.retain(|hash| !stand_ins.contains(hash));
        let mut before = std::mem::replace(&mut told.held_objects, told.all.clone());
        before.extend(stand_ins);
        let held = told.held();
        self.discard(before);
        self.send(link, &held);
    }
}
