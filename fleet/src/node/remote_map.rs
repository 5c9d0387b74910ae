//! Maps that others tell: which version is known, and what of it is to be fetched.

mod fetching;

use super::quota::Load;
use super::{Ledger, Lists, MapSnapshot};
use crate::hash::ObjectHash;
use crate::link::ObjectRef;
use crate::manifest::{Entry, Kind, Manifest, Page, PageRef};
use crate::store::Store;
use crate::wire::{MapVersion, Message};
use map::{SensorKind, Uuid};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Another's map.
pub(super) struct RemoteMap {
    /// Who tells it; nobody of one that was here when the program began.
    pub publisher: Uuid,
    /// Whose agent it is, where peers have keys.
    pub peer: Option<Uuid>,
    /// Its newest version.
    pub version: MapVersion,
    /// What came of the lists of a newer version than `lists`.
    coming: Coming,
    /// The newest version of which all lists are here.
    lists: Option<Arc<Lists>>,
    /// The last whole one, which stays until another one is whole.
    whole: Option<Arc<Lists>>,
    /// One that is whole and goes to the disk.
    writing: Option<Arc<Lists>>,
    /// Objects of the newest that are not here, but for those that stand in for others.
    missing: BTreeSet<ObjectHash>,
    /// Those that stand in for others, until all others are here.
    previews: BTreeSet<ObjectHash>,
    /// Those of them that came.
    previews_here: BTreeSet<ObjectHash>,
    /// Objects that are fetched before others and did not come yet.
    awaited: BTreeSet<ObjectHash>,
    /// Objects that came.
    came: u64,
    /// The newest version that is whole here, and on the disk.
    stored_version: (u64, u64),
    /// Objects of keyframes that come before others, the most wanted first.
    preferred: Vec<(Kind, u32)>,
    /// Whether all others come too.
    rest: bool,
}

/// Lists of a version, as far as they came; none of it is kept before all of it is here and may be.
#[derive(Default)]
struct Coming {
    manifest: Option<(Manifest, Arc<[u8]>)>,
    pages: BTreeMap<ObjectHash, (Page, Arc<[u8]>)>,
}

impl RemoteMap {
    /// A map that was never heard of before.
    fn new(publisher: Uuid, peer: Option<Uuid>, version: MapVersion, rest: bool) -> Self {
        let (coming, lists, whole, writing, missing, previews, previews_here) = Default::default();
        let (awaited, came, stored_version, preferred) = Default::default();
        Self {
            publisher,
            peer,
            version,
            coming,
            lists,
            whole,
            writing,
            missing,
            previews,
            previews_here,
            awaited,
            came,
            stored_version,
            preferred,
            rest,
        }
    }

    /// A map that was whole when the program ended. What is not there by now, or not as long as it should be, is fetched
    /// again.
    pub fn whole(lists: Arc<Lists>, peer: Option<Uuid>, store: &dyn Store) -> Self {
        let mut remote = Self::new(Uuid::nil(), peer, lists.map_version, true);
        remote.whole = Some(Arc::clone(&lists));
        remote.set_lists(lists, store);
        let previews = remote.previews.iter().filter(|hash| store.has(hash));
        remote.previews_here = previews.copied().collect();
        if remote.missing.is_empty() {
            remote.stored_version = remote.version.order();
        }
        remote
    }

    /// Takes the lists of the newest version.
    fn set_lists(&mut self, lists: Arc<Lists>, store: &dyn Store) {
        let (previews, needed): (Vec<&Entry>, Vec<&Entry>) =
            lists.entries.iter().partition(|entry| entry.kind.is_preview());
        let is_missing = |entry: &&Entry| store.size(&entry.hash) != Some(entry.size);
        self.missing = needed.into_iter().filter(is_missing).map(|entry| entry.hash).collect();
        self.previews = previews.iter().map(|entry| entry.hash).collect();
        (self.lists, self.coming) = (Some(lists), Coming::default());
    }

    /// The versions that the store is to have.
    pub fn in_use(&self) -> impl Iterator<Item = &Lists> {
        [&self.lists, &self.whole, &self.writing].into_iter().flatten().map(|lists| &**lists)
    }

    /// An object is gone or damaged here; whether it is one that is to be fetched again.
    pub fn lost(&mut self, hash: &ObjectHash) -> bool {
        let Some(lists) = &self.lists else { return false };
        let lists_it = lists.entries.iter().any(|entry| entry.hash == *hash && !entry.kind.is_preview());
        let is_list =
            lists.map_version.hash == *hash || lists.manifest.pages.iter().any(|page| page.hash == *hash);
        if lists_it || is_list {
            self.stored_version = (0, 0);
            self.missing.insert(*hash);
        }
        lists_it || is_list
    }

    /// Whether it is of this peer, where peers have keys, or else of this neighbour.
    fn is_of(&self, publisher: Uuid, peer: Option<Uuid>) -> bool {
        if peer.is_some() { self.peer == peer } else { self.publisher == publisher }
    }

    /// What is said of it to whoever tells it.
    pub fn acknowledgement(&self) -> Message {
        let missing = match self.is_newest() {
            true => self.missing.len() as u32,
            false if self.stored_version == self.version.order() => 0,
            false => u32::MAX,
        };
        let (begun, revision) = self.stored_version;
        Message::Stored { agent: self.version.agent, begun, revision, missing }
    }

    /// How much of it is here, whoever tells it being near or not; `None` before its lists are.
    pub fn snapshot(&self, is_near: bool) -> Option<MapSnapshot> {
        let entries = Arc::clone(&self.lists.as_ref()?.entries);
        let (agent, begun, finished) = (self.version.agent, self.version.begun, self.is_finished());
        let (missing, came) = (self.missing.len(), self.came);
        Some(MapSnapshot { agent, begun, entries, missing, came, finished, is_near })
    }

    /// Whether the agent's run has ended, by the newest lists that are here.
    pub fn is_finished(&self) -> bool {
        self.lists.as_ref().is_some_and(|lists| lists.manifest.finished)
    }

    /// What it takes by these.
    pub fn load(&self) -> Load {
        self.lists.as_ref().map_or_else(Load::default, |lists| lists.load)
    }

    /// The kind of the agent's sensor, once a keyframe is listed.
    pub fn sensor(&self) -> Option<SensorKind> {
        self.lists.as_ref()?.sensor
    }

    /// How many objects are not here yet.
    pub fn missing(&self) -> usize {
        self.missing.len()
    }

    /// Whether all of it is here, and not on the disk yet.
    pub fn is_unkept(&self) -> bool {
        self.is_newest() && self.missing.is_empty() && self.stored_version != self.version.order()
    }

    /// Whether the lists that are here are those of the newest version.
    fn is_newest(&self) -> bool {
        self.lists.as_ref().is_some_and(|lists| lists.map_version.order() == self.version.order())
    }

    /// The lists that are to be fetched; `known` are pages that need not be.
    fn lists_to_fetch(&self, known: &Ledger) -> Vec<ObjectRef> {
        let of_page = |page: &PageRef| ObjectRef { hash: page.hash, size: page.size };
        let manifest = ObjectRef { hash: self.version.hash, size: self.version.size };
        match (&self.coming.manifest, &self.lists) {
            _ if self.is_newest() => {
                // Their files may be lost.
                let pages = self.lists.iter().flat_map(|lists| &lists.manifest.pages).map(of_page);
                pages.chain([manifest]).filter(|want| self.missing.contains(&want.hash)).collect()
            }
            (Some((newest, _)), _) => {
                let is_here = |hash| self.coming.pages.contains_key(hash) || known.page(hash).is_some();
                newest.pages.iter().filter(|page| !is_here(&page.hash)).map(of_page).collect()
            }
            (None, _) => vec![manifest],
        }
    }

    /// What is to be fetched of it, the most urgent first; takes note of what of that is awaited.
    fn objects_to_fetch(&mut self, store: &dyn Store, known: &Ledger) -> Vec<ObjectRef> {
        // The lists of the newest version; as long as they are not here, what is known of the one before.
        let mut wanted = self.lists_to_fetch(known);
        let lists = wanted.iter().map(|want| want.hash);
        let mut awaited: BTreeSet<ObjectHash> = lists.collect();
        let places: BTreeMap<(Kind, u32), usize> = self.preferred.iter().copied().zip(0..).collect();
        let entries = self.lists.iter().flat_map(|lists| lists.entries.iter());
        // What is chosen by, then what was chosen, keyframe by keyframe, then all that the whole map needs.
        let priority = |entry: &&Entry| {
            let place = places.get(&(entry.kind, entry.number)).copied();
            let is_missing = match entry.kind.is_preview() {
                true => place.is_some() && !self.missing.is_empty() && !store.has(&entry.hash),
                false => self.missing.contains(&entry.hash),
            };
            let priority = match (tier(entry.kind), place) {
                (0, _) => (0, entry.kind as usize),
                (_, Some(place)) => (1, place),
                (tier, None) => (tier, 0),
            };
            (is_missing && (priority.0 < 2 || self.rest)).then_some((priority, entry.number, entry.kind))
        };
        let mut entries: Vec<_> = entries.filter_map(|entry| Some((priority(&entry)?, entry))).collect();
        entries.sort_by_key(|(priority, _)| *priority);
        let first = entries.iter().take_while(|(((tier, _), ..), _)| *tier < 2);
        awaited.extend(first.map(|(_, entry)| entry.hash));
        wanted.extend(entries.iter().map(|(_, entry)| ObjectRef { hash: entry.hash, size: entry.size }));
        self.awaited = awaited;
        wanted
    }
}

/// What comes before what of a map's objects; in between comes what is preferred.
fn tier(kind: Kind) -> usize {
    match kind {
        Kind::Agent | Kind::Poses => 0,
        Kind::Digest | Kind::Features => 2,
        Kind::LossyDepth | Kind::LossyImage | Kind::Depth | Kind::Image | Kind::Scan => 3,
        Kind::Edges | Kind::Frames | Kind::Color => 4,
    }
}
