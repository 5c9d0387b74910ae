//! What one party of the fleet says and does: a function of what comes and of the time, without sockets, threads and
//! clocks.
//!
//! Every second it says on each link who it is, which maps of its own can be asked for and how much of the other's it
//! holds; a link on which nothing is heard is closed, for whoever dials to open anew. What others tell is fetched
//! (`told`), checked against its hash, kept in the store, and acknowledged when it is on the disk.

mod believing;
mod quota;
mod saying;
mod status;
mod told;
mod types;

pub use quota::Quota;
pub use status::{AgentStatus, NeighbourStatus, Status};
pub use types::{Action, Config, Event, Heard, LinkId, News};

use crate::bytes::printable;
use crate::hash::ObjectHash;
use crate::keys::{Party, Signature};
use crate::link::{Fetch, Taken};
use crate::manifest::{Kind, MAX_LIST, Manifest};
use crate::publishing::Publication;
use crate::store::{Head, Store};
use crate::wire::{FindingsRef, Message, Offer, Role, VERSION};
use map::{Identity, Uuid};
use quota::Said;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use told::Told;

/// How often one says who one is and what one has.
pub const BEAT: Duration = Duration::from_secs(1);
/// A link on which nothing was heard for so long is closed. Eight beats: at 20 % loss one in 400,000 times by chance.
pub const SILENCE: Duration = Duration::from_secs(8);
/// After a silence so long what is late is asked for again at once: a link that was cut works again.
const CUT: Duration = Duration::from_millis(2500);
/// States of maps, of one's own and of those one holds, that are said in one beat: the others' turn comes later.
const STATES: usize = 2;
/// How long nothing is fetched after the disk refused.
const DISK_PAUSE: Duration = Duration::from_secs(10);

/// A party of the fleet.
pub struct Node {
    config: Config,
    store: Arc<dyn Store>,
    /// Maps that are told.
    own: BTreeMap<Identity, Own>,
    /// Maps that others tell.
    told: BTreeMap<Identity, Told>,
    findings: Option<(FindingsRef, Vec<u8>)>,
    neighbours: BTreeMap<Uuid, Neighbour>,
    links: BTreeMap<LinkId, Link>,
    /// Neighbours and parties of whom nothing is believed, and why.
    distrusted: BTreeMap<Uuid, String>,
    /// How often something came that somebody waits for.
    arrivals: u64,
    /// Nothing is fetched before.
    paused_until: Duration,
    actions: Vec<Action>,
}

/// A map of one's own.
struct Own {
    offer: Offer,
    /// The party's under it, if parties have keys.
    signature: Option<Signature>,
    all: BTreeSet<ObjectHash>,
    /// What the version before had: somebody may be fetching it.
    before: BTreeSet<ObjectHash>,
}

/// Another party.
#[derive(Default)]
struct Neighbour {
    name: String,
    /// Whose node it is, where parties have keys.
    party: Option<Party>,
    is_station: bool,
    link: Option<LinkId>,
    fetch: Fetch,
    /// Of own maps, the last version that it holds whole, and how many objects of the newest it lacks.
    holds: BTreeMap<Identity, ((u64, u64), u32)>,
    /// What it found out, by its own word.
    findings: Option<FindingsRef>,
    /// The revision of what is here of that.
    findings_here: u64,
}

struct Link {
    address: String,
    /// Whose certificate was shown there.
    party: Option<Party>,
    node: Option<Uuid>,
    heard: Duration,
    /// When it was last told who one is; nothing where it is to be told at once.
    beat: Option<Duration>,
    turn: usize,
    said: Said,
}

impl Node {
    /// A node that keeps objects in `store`; what is whole there is known again.
    pub fn new(config: Config, store: Arc<dyn Store>) -> Self {
        let (own, told, neighbours, links, distrusted, actions) = Default::default();
        let (findings, arrivals, paused_until) = (None, 0, Duration::ZERO);
        let mut node = Self {
            config,
            store,
            own,
            told,
            findings,
            neighbours,
            links,
            distrusted,
            arrivals,
            paused_until,
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
        let Ok(Some(entries)) = crate::assembling::entries_of(&manifest, &*self.store) else { return };
        let keyframes = entries.iter().filter(|entry| entry.kind == Kind::Depth);
        let offer = Offer {
            agent,
            begun: manifest.begun,
            revision: manifest.revision,
            newest: keyframes.map(|entry| entry.number).max().unwrap_or(0),
            size: bytes.len() as u32,
            hash: head.manifest,
        };
        if head.own {
            let pages = manifest.pages.iter().map(|page| page.hash);
            let all = entries.iter().map(|entry| entry.hash).chain(pages).chain([head.manifest]).collect();
            let signature = self.signed(&offer);
            self.own.insert(agent, Own { offer, signature, all, before: BTreeSet::new() });
        } else {
            self.told.insert(agent, Told::whole(offer, head.party, manifest, entries, &*self.store));
        }
    }

    /// What is to be done now that this happened; `now` is the time since any moment, and never less than before.
    pub fn handle(&mut self, now: Duration, event: Event) -> Vec<Action> {
        match event {
            Event::Up { link, address, party } => {
                let (node, beat, said) = Default::default();
                self.links.insert(link, Link { address, party, node, heard: now, beat, turn: 0, said });
            }
            Event::Trouble(text) => self.actions.push(Action::News(News::Trouble(text))),
            Event::Down { link } => self.forget(link),
            Event::Received { link, bytes } => match Message::from_bytes(&bytes) {
                Ok(message) => self.received(now, link, message),
                Err(what) => self.refuse(link, format!("it sent what is no message: {what}")),
            },
            Event::Tick => {}
            Event::Publish(publication) => self.publish(*publication),
            Event::Prefer { agent, objects, rest } => self.prefer(agent, objects, rest),
            Event::Distrust { agent, reason } => self.distrust(agent, reason),
            Event::Findings { revision, bytes } => self.take_findings(revision, bytes),
        }
        self.beat(now);
        self.fetch(now);
        std::mem::take(&mut self.actions)
    }

    /// Maps that are whole or in part here, of others.
    pub fn heard(&self) -> impl Iterator<Item = Heard> + '_ {
        self.told.values().filter_map(|told| told.heard(self.is_near(told)))
    }

    /// Whether there is a link to whoever tells a map; one on which nothing is heard is closed.
    fn is_near(&self, told: &Told) -> bool {
        self.neighbours.get(&told.teller).is_some_and(|teller| teller.link.is_some())
    }

    /// How often something came by which it may be decided what is next: of a map the last of what comes before others
    /// (lists, places of keyframes, and what was preferred) or the last of all, whatever of other maps is still to come; or what
    /// a neighbour found out.
    pub fn arrivals(&self) -> u64 {
        self.arrivals
    }

    fn received(&mut self, now: Duration, link: LinkId, message: Message) {
        let Some(known) = self.links.get_mut(&link) else { return };
        let silent = now.saturating_sub(known.heard);
        known.heard = now;
        let node = known.node;
        let is_push = matches!(message, Message::Hello { .. } | Message::State { .. } | Message::Held { .. });
        if is_push && let Err(reason) = known.said.one_more(now) {
            return self.refuse(link, reason);
        }
        if let Message::Hello { version, node, role, name, findings } = message {
            return self.hello(link, (version, node, role == Role::Station), name, findings);
        }
        if let Message::Refused { reason } = message {
            let name = node.and_then(|node| self.neighbours.get(&node)).map_or("a neighbour", |n| &n.name);
            let text = format!("{name} refused this one: {}", printable(&reason));
            self.actions.push(Action::News(News::Trouble(text.clone())));
            self.forget(link);
            return self.actions.push(Action::Close { link, reason: text });
        }
        // Before it said who it is, nothing is believed; it will say it again.
        let Some(node) = node else { return };
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        if silent > CUT {
            neighbour.fetch.heard_again();
        }
        match message {
            Message::Hello { .. } | Message::Refused { .. } => {}
            Message::State { offer, signature } => self.offered(link, node, offer, signature),
            Message::Held { agent, begun, revision, missing } => {
                let version = (begun, revision);
                let before = neighbour.holds.insert(agent, (version, missing));
                let is_own = self.own.get(&agent).is_some_and(|own| own.offer.version() == version);
                if is_own && before.map(|(before, _)| before) != Some(version) {
                    let by = neighbour.name.clone();
                    self.actions.push(Action::News(News::Held { by, agent, version }));
                }
            }
            Message::Get { hash, offset, length } => {
                let part = self.may_have(&hash).then(|| self.store.part(&hash, offset, length)).flatten();
                let found = self.findings.as_ref().filter(|(known, _)| known.hash == hash);
                let findings = found.map(|(_, bytes)| {
                    let end = bytes.len().min((offset + length) as usize);
                    bytes.get(offset as usize..end).unwrap_or_default().to_vec()
                });
                match findings.or(part) {
                    Some(bytes) => self.send(link, &Message::Part { hash, offset, bytes }),
                    None => self.send(link, &Message::Missing { hash }),
                }
            }
            Message::Part { hash, offset, bytes } => match neighbour.fetch.take(now, &hash, offset, &bytes) {
                Taken::More | Taken::Unwanted => {}
                Taken::Whole(bytes) => self.object(now, link, node, hash, bytes),
                Taken::Wrong => self.refuse(link, "it sent an object that is not what it is called".into()),
            },
            Message::Missing { hash } => neighbour.fetch.drop_object(&hash),
        }
    }

    fn hello(
        &mut self,
        link: LinkId,
        (version, node, is_station): (u16, Uuid, bool),
        name: String,
        findings: Option<FindingsRef>,
    ) {
        if version != VERSION {
            let reason = format!("it speaks version {version} of the protocol, this one {VERSION}");
            return self.refuse(link, reason);
        }
        if node == self.config.node {
            return self.refuse(link, "it is this one itself: the address is one's own".into());
        }
        let Some(known) = self.links.get(&link) else { return };
        let party = known.party.as_ref().map(|party| party.id);
        let node = match self.known_as(known, node) {
            Ok(node) => node,
            Err(reason) => return self.refuse(link, reason),
        };
        if !self.neighbours.contains_key(&node) {
            self.forget_gone(party);
        }
        let Some(known) = self.links.get_mut(&link) else { return };
        if known.node.is_some_and(|before| before != node) {
            return self.refuse(link, "it said that it is another one than before".into());
        }
        let is_new = known.node.replace(node).is_none();
        let address = known.address.clone();
        let neighbour = self.neighbours.entry(node).or_default();
        neighbour.call(&name, known.party.as_ref());
        neighbour.is_station = is_station;
        let name = neighbour.name.clone();
        let newer = |known: &FindingsRef| findings.is_some_and(|new| new.revision > known.revision);
        if neighbour.findings.as_ref().is_none_or(newer) {
            neighbour.findings = findings;
        }
        if is_new {
            let earlier = neighbour.link.replace(link).filter(|earlier| *earlier != link);
            neighbour.fetch.lost();
            if let Some(earlier) = earlier {
                self.links.remove(&earlier);
                let reason = "a newer link took its place".into();
                self.actions.push(Action::Close { link: earlier, reason });
            }
            self.actions.push(Action::News(News::Met { name, address }));
        }
        self.want(node);
    }

    /// Has nothing more to do with whoever told a map that is none, as long as the program runs.
    fn distrust(&mut self, agent: Identity, reason: String) {
        let Some(told) = self.told.remove(&agent) else { return };
        let reason = format!("its map {agent} cannot be used: {reason}");
        let link = self.neighbours.get(&told.teller).and_then(|neighbour| neighbour.link);
        for whoever in [Some(told.teller), told.party].into_iter().flatten() {
            self.distrusted.insert(whoever, reason.clone());
        }
        if let Some(link) = link {
            self.refuse(link, reason);
        }
    }

    /// Whether an object may be asked for: it is one of the maps that are told.
    fn may_have(&self, hash: &ObjectHash) -> bool {
        self.own.values().any(|own| own.all.contains(hash) || own.before.contains(hash))
    }

    fn publish(&mut self, publication: Publication) {
        let Publication { offer, objects, all } = publication;
        let kept = objects.iter().try_for_each(|(hash, bytes)| self.store.put(hash, bytes));
        let head = Head { manifest: offer.hash, own: true, party: None };
        if let Err(error) = kept.and_then(|()| self.store.set_head(offer.agent, head)) {
            // The version before stays; the next one is tried again.
            let text = format!("what is new of the map cannot be kept and is not told: {error}");
            return self.actions.push(Action::News(News::Trouble(text)));
        }
        self.told.remove(&offer.agent);
        let before = self.own.remove(&offer.agent);
        let (earlier, before) = before.map_or_else(Default::default, |own| (own.before, own.all));
        let signature = self.signed(&offer);
        self.own.insert(offer.agent, Own { offer, signature, all, before });
        self.discard(earlier);
        self.links.values_mut().for_each(|link| link.beat = None);
    }

    fn take_findings(&mut self, revision: u64, bytes: Vec<u8>) {
        if bytes.len() > MAX_LIST as usize {
            let text = "what was found out is too much to be told";
            return self.actions.push(Action::News(News::Trouble(text.into())));
        }
        let known = FindingsRef { revision, size: bytes.len() as u32, hash: ObjectHash::of(&bytes) };
        self.findings = Some((known, bytes));
        self.links.values_mut().for_each(|link| link.beat = None);
    }

    /// Removes those of some objects that no map has any more.
    fn discard(&self, objects: BTreeSet<ObjectHash>) {
        let used = |hash: &ObjectHash| self.may_have(hash) || self.told.values().any(|told| told.has(hash));
        let unused: BTreeSet<ObjectHash> = objects.into_iter().filter(|hash| !used(hash)).collect();
        self.store.remove(&unused);
    }
}
