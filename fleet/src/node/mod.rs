//! What one peer of the fleet says and does: a function of what comes and of the time, without sockets, threads and
//! clocks.
//!
//! Every second it says on each link who it is, which maps of its own can be asked for and how much of the other's it
//! holds; a link on which nothing is heard is closed, for whoever dials to open anew. What others tell is fetched
//! (`remote_map`), checked against its hash, kept in the store, and acknowledged when it is on the disk. It never waits for a disk:
//! the store says later what became of what it was given, and what others ask for is read by whoever carries out
//! [`Action::Serve`].

mod announcing;
mod authorisation;
mod lists;
mod publishing;
mod quota;
mod receiving;
mod remote_map;
mod status;
mod types;

pub use quota::Quota;
pub use status::{AgentStatus, NeighbourStatus, Status};
pub use types::{Action, Config, Event, LinkId, MapSnapshot, Notice};

use crate::hash::ObjectHash;
use crate::keys::Peer;
use crate::link::Fetch;
use crate::manifest::{Kind, Manifest};
use crate::merge_results::ByAgent;
use crate::store::{Head, Store, StoreEvent};
use crate::wire::{MapVersion, Message, ResultsRef};
use announcing::SentResults;
use lists::{Ledger, Lists};
use map::{Identity, Uuid};
use publishing::Own;
use quota::TokenBucket;
use remote_map::RemoteMap;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// How often one says who one is and what one has.
pub const BEAT: Duration = Duration::from_secs(1);
/// A link on which nothing was heard for so long is closed. Eight beats: at 20 % loss one in 400,000 times by chance.
pub const SILENCE: Duration = Duration::from_secs(8);
/// States of maps, of one's own and of those one holds, that are said in one beat: the others' turn comes later.
const STATES: usize = 2;
/// Nothing is fetched while so many bytes of what came are not on the disk yet.
const UNWRITTEN: usize = 64 << 20;
/// A node to which nothing happened for so long stood still itself: ticks come ten times a second and more often.
const STOOD_STILL: Duration = Duration::from_secs(1);
/// When an object is asked for again that a neighbour did not have, and one that came as another than it is called.
const ASK_AGAIN: [Duration; 2] = [Duration::from_secs(2), Duration::from_secs(30)];
/// How long nothing is believed of whoever told a map that is none.
const BAN_DURATION: Duration = Duration::from_secs(300);
/// Links of a peer at once: those of a machine's programs, and some that are being replaced.
const LINKS_OF_PEER: usize = 64;

/// A peer of the fleet.
pub struct Node {
    config: Config,
    store: Arc<dyn Store>,
    /// Maps that are told.
    own: BTreeMap<Identity, Own>,
    /// Maps that others tell.
    remote_maps: BTreeMap<Identity, RemoteMap>,
    /// What own maps, and those that others tell, need of the store.
    of_own: Ledger,
    of_remote: Ledger,
    /// What nothing needs any more, each with all who read then.
    unused: VecDeque<(u64, ObjectHash)>,
    /// The newest that was found out, and which version of that it is.
    results: Option<(u64, ByAgent)>,
    neighbours: BTreeMap<Uuid, Neighbour>,
    links: BTreeMap<LinkId, Link>,
    /// Where nobody answers who is dialled, since when and why.
    unanswered: BTreeMap<String, (Duration, String)>,
    /// Neighbours and peers of whom nothing is believed, why, and until when.
    banned: BTreeMap<Uuid, (String, Duration)>,
    /// How often something came that somebody waits for.
    arrivals: u64,
    /// What time it is.
    now: Duration,
    /// When it looked last how things are.
    looked: Duration,
    actions: Vec<Action>,
}

/// Another peer.
#[derive(Default)]
struct Neighbour {
    name: String,
    /// Whose node it is, where peers have keys.
    peer: Option<Peer>,
    is_station: bool,
    link: Option<LinkId>,
    /// Since when there is one, or is none.
    changed: Duration,
    fetch: Fetch,
    /// When objects are asked for again that could not be had.
    later: BTreeMap<ObjectHash, Duration>,
    /// Of own maps, the last version that it holds whole, and how many objects of the newest it lacks.
    stored: BTreeMap<Identity, ((u64, u64), u32)>,
    /// What it found out, by its own word.
    results: Option<ResultsRef>,
    /// The revision of what is here of that.
    results_here: u64,
}

struct Link {
    address: String,
    /// Whose certificate was shown there.
    peer: Option<Peer>,
    node: Option<Uuid>,
    last_received: Duration,
    /// When it was last told who one is; nothing where it is to be told at once.
    beat: Option<Duration>,
    cycle: usize,
    bucket: TokenBucket,
    /// The oldest and the newest version of the protocol that the other end speaks, where it said so.
    speaks: Option<[u16; 2]>,
    /// What it is told of what was found out.
    sent_results: Option<SentResults>,
}

impl Node {
    /// A node that keeps objects in `store`; what is whole there is known again.
    pub fn new(config: Config, store: Arc<dyn Store>) -> Self {
        let (own, remote_maps, neighbours, links, banned, actions) = Default::default();
        let (results, arrivals, looked, unused, now, unanswered) = Default::default();
        let (of_own, of_remote) = (Ledger::new(true), Ledger::new(false));
        let mut node = Self {
            config,
            store,
            own,
            remote_maps,
            of_own,
            of_remote,
            unused,
            results,
            neighbours,
            links,
            unanswered,
            banned,
            arrivals,
            now,
            looked,
            actions,
        };
        for (agent, head) in node.store.heads() {
            node.remember(agent, head);
        }
        node
    }

    /// Knows a map again that was whole when the program ended.
    fn remember(&mut self, agent: Identity, head: Head) {
        let Some(bytes) = self.store.get(&head.manifest) else { return };
        let Ok(manifest) = Manifest::from_bytes(&bytes) else { return };
        let Ok(Some(pages)) = crate::assembling::pages_of(&manifest, &*self.store) else { return };
        let keyframes = pages.iter().flat_map(|page| page.iter()).filter(|entry| entry.kind == Kind::Depth);
        let version = MapVersion {
            agent,
            begun: manifest.begun,
            revision: manifest.revision,
            newest: keyframes.map(|entry| entry.number).max().unwrap_or(0),
            size: bytes.len() as u32,
            hash: head.manifest,
        };
        let Ok(lists) = Lists::new(version, manifest, pages).map(Arc::new) else { return };
        if head.own {
            self.of_own.add(&lists);
            let signature = self.signed(&version);
            self.own.insert(agent, Own::new(lists, signature));
        } else {
            // As the newest, and as the last that was whole.
            self.of_remote.add(&lists);
            self.of_remote.add(&lists);
            self.remote_maps.insert(agent, RemoteMap::whole(lists, head.peer, &*self.store));
        }
    }

    /// What is to be done now that this happened; `now` is the time since any moment, and never less than before.
    pub fn handle(&mut self, now: Duration, event: Event) -> Vec<Action> {
        self.apply(now, event);
        self.step(now)
    }

    /// Applies an event. Of several events at once all are applied before the next [`step`](Self::step).
    pub fn apply(&mut self, now: Duration, event: Event) {
        self.now = now;
        match event {
            Event::Up { link, address, peer } => self.link_opened(now, link, address, peer),
            Event::Trouble(text) => self.actions.push(Action::Notify(Notice::Trouble(text))),
            Event::Unanswered { address, reason } => self.unanswered(address, reason),
            Event::Down { link } => self.forget(link, "its connection ended"),
            Event::Received { link, bytes } => match Message::from_bytes(&bytes) {
                Ok(message) => self.handle_message(now, link, message),
                // Who speaks a newer version may say more.
                Err(_) if self.is_newer(link) => {}
                Err(what) => self.refuse(link, format!("it sent what is no message: {what}")),
            },
            Event::Tick => {}
            Event::Publish(publication) => self.publish(*publication),
            Event::Prefer { agent, objects, rest } => self.prefer(agent, objects, rest),
            Event::Ban { agent, reason } => self.ban(now, agent, reason),
            Event::Results { revision, found } => self.set_results(revision, found),
        }
    }

    /// What is to be done by now, after the events that were applied.
    pub fn step(&mut self, now: Duration) -> Vec<Action> {
        self.now = now;
        let stood_still = now.saturating_sub(std::mem::replace(&mut self.looked, now));
        if stood_still > STOOD_STILL {
            // What others said meanwhile may still be to be looked at.
            self.links
                .values_mut()
                .for_each(|link| link.last_received = (link.last_received + stood_still).min(now));
        }
        for event in self.store.events() {
            self.handle_store_event(event);
        }
        self.discard();
        self.beat(now);
        self.fetch(now);
        std::mem::take(&mut self.actions)
    }

    /// Something happened in the store.
    fn handle_store_event(&mut self, event: StoreEvent) {
        match event {
            StoreEvent::Head(agent, head) if head.own => self.published(agent, head.manifest),
            StoreEvent::Head(agent, head) => self.completed(agent, head.manifest),
            StoreEvent::Lost(hash) => self.lost(hash),
            StoreEvent::Failed(reason) => {
                let text = format!("what is told cannot be kept: {reason}; it is tried again");
                self.actions.push(Action::Notify(Notice::Trouble(text)));
            }
        }
    }

    /// An object is gone or damaged here: of others' maps it is fetched again, and of own ones it is told again.
    fn lost(&mut self, hash: ObjectHash) {
        if self.of_remote.has(&hash) {
            let remote = self
                .remote_maps
                .values_mut()
                .filter_map(|remote| remote.lost(&hash).then_some(remote.publisher));
            let publishers: BTreeSet<Uuid> = remote.collect();
            publishers.into_iter().for_each(|publisher| self.plan_fetch(publisher));
        }
        if self.of_own.has(&hash) {
            let text = "an object of an own map is damaged on the disk".to_owned();
            self.actions.extend([Notice::Trouble(text), Notice::Unkept].map(Action::Notify));
        }
    }

    /// Maps that are whole or in part here, of others.
    pub fn snapshots(&self) -> impl Iterator<Item = MapSnapshot> + '_ {
        self.remote_maps.values().filter_map(|remote| remote.snapshot(self.is_near(remote)))
    }

    /// Whether there is a link to whoever tells a map; one on which nothing is heard is closed.
    fn is_near(&self, remote: &RemoteMap) -> bool {
        self.neighbours.get(&remote.publisher).is_some_and(|publisher| publisher.link.is_some())
    }

    /// How often something came by which it may be decided what is next: of a map the last of what comes before others
    /// (lists, places of keyframes, and what was preferred) or the last of all, whatever of other maps is still to come; or what
    /// a neighbour found out.
    pub fn arrivals(&self) -> u64 {
        self.arrivals
    }

    /// A version of a map is needed no more.
    fn release_remote(&mut self, lists: &Lists) {
        let unused = self.of_remote.remove(lists);
        self.set_aside(unused);
    }

    /// Objects that may be needed no more.
    fn set_aside(&mut self, objects: impl IntoIterator<Item = ObjectHash>) {
        let moment = self.store.pins().now();
        self.unused.extend(objects.into_iter().map(|hash| (moment, hash)));
    }

    /// Removes what nothing needs, once nobody reads it who may have begun before that was so.
    fn discard(&mut self) {
        let mut unused = Vec::new();
        while let Some((moment, hash)) = self.unused.front().copied() {
            if !self.store.pins().have_ended(moment) {
                break;
            }
            self.unused.pop_front();
            if !self.of_own.has(&hash) && !self.of_remote.has(&hash) {
                unused.push(hash);
            }
        }
        if !unused.is_empty() {
            self.store.remove(&unused);
        }
    }
}

/// A part of an object.
pub(crate) fn part_of(bytes: &[u8], offset: u32, length: u32) -> Vec<u8> {
    let rest = bytes.get(offset as usize..).unwrap_or_default();
    rest[..rest.len().min(length as usize)].to_vec()
}
