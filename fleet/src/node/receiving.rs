//! What a node makes of what neighbours say.

use super::{ASK_AGAIN, Action, BAN_DURATION, LINKS_OF_PEER, Link, LinkId, Node, Notice, part_of};
use crate::bytes::printable;
use crate::keys::Peer;
use crate::link::PartOutcome;
use crate::wire::{Message, ResultsRef, Role};
use map::{Identity, Uuid};
use std::time::Duration;

impl Node {
    /// Whether the other end of a link speaks a newer version of the protocol.
    pub(super) fn is_newer(&self, link: LinkId) -> bool {
        let speaks = self.links.get(&link).and_then(|link| link.speaks);
        speaks.is_some_and(|[_, newest]| newest > self.config.versions[1])
    }

    /// Nobody answers where it was dialled.
    pub(super) fn unanswered(&mut self, address: String, reason: String) {
        let is_known = self.unanswered.contains_key(&address);
        self.unanswered.entry(address.clone()).or_insert((self.now, String::new())).1.clone_from(&reason);
        if !is_known {
            self.actions.push(Action::Notify(Notice::Unanswered { address, reason }));
        }
    }

    pub(super) fn link_opened(&mut self, now: Duration, link: LinkId, address: String, peer: Option<Peer>) {
        self.unanswered.remove(&address);
        let id = peer.as_ref().map(|peer| peer.id);
        let is_of_same = |link: &&Link| id.is_some() && link.peer.as_ref().map(|peer| peer.id) == id;
        let count = self.links.values().filter(is_of_same).count();
        let (node, beat, bucket, speaks, sent_results) = Default::default();
        let opened =
            Link { address, peer, node, last_received: now, beat, cycle: 0, bucket, speaks, sent_results };
        self.links.insert(link, opened);
        if count >= LINKS_OF_PEER {
            self.refuse(link, format!("its party has {count} links already"));
        }
    }

    pub(super) fn handle_message(&mut self, now: Duration, link: LinkId, message: Message) {
        let Some(known) = self.links.get_mut(&link) else { return };
        known.last_received = now;
        let node = known.node;
        if let Some(neighbour) = node.and_then(|node| self.neighbours.get_mut(&node)) {
            neighbour.fetch.note_message(now);
        }
        let is_push =
            !matches!(message, Message::Get { .. } | Message::Part { .. } | Message::Missing { .. });
        if is_push && let Err(reason) = known.bucket.one_more(now) {
            return self.refuse(link, reason);
        }
        match (message, node) {
            (Message::Hello { version, node, role, name, results }, _) => {
                self.handle_hello(now, link, (version, node, role == Role::Station), name, results);
            }
            (Message::Speaks { oldest, newest }, _) => known.speaks = Some([oldest, newest]),
            (Message::Refused { reason }, _) => self.handle_refusal(link, node, &reason),
            (message, Some(node)) => self.handle_known(now, (link, node), message),
            // Nothing is believed before the neighbour says who it is; it will say it again.
            (_, None) => {}
        }
    }

    fn handle_refusal(&mut self, link: LinkId, node: Option<Uuid>, reason: &str) {
        let name = node.and_then(|node| self.neighbours.get(&node)).map_or("a neighbour", |n| &n.name);
        let text = format!("{name} refused us: {}", printable(reason));
        self.actions.push(Action::Notify(Notice::Trouble(text.clone())));
        self.forget(link, "it refused us");
        self.actions.push(Action::Close { link, reason: text });
    }

    /// Handles the message of a neighbour that has said who it is.
    fn handle_known(&mut self, now: Duration, (link, node): (LinkId, Uuid), message: Message) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        match message {
            Message::Hello { .. } | Message::Speaks { .. } | Message::Refused { .. } => {}
            Message::State { version, signature } => self.handle_version(link, node, version, signature),
            Message::Stored { agent, begun, revision, missing } => {
                // Only what is stored of own maps matters here.
                let Some(own) = self.own.get(&agent) else { return };
                let acknowledged = ((begun, revision), missing);
                let before = neighbour.stored.insert(agent, acknowledged);
                let Some(version) = own.version().map(|version| version.order()) else { return };
                if acknowledged == (version, 0) && before != Some(acknowledged) {
                    let by = neighbour.name.clone();
                    self.actions.push(Action::Notify(Notice::Stored { by, agent, version }));
                }
            }
            Message::Get { hash, offset, length } => {
                let sent_results = self.links.get(&link).and_then(|link| link.sent_results.as_ref());
                let found = sent_results.filter(|sent_results| sent_results.known.hash == hash);
                let part = found.map(|found| part_of(&found.bytes, offset, length));
                match part {
                    Some(bytes) => self.send(link, &Message::Part { hash, offset, bytes }),
                    None if self.of_own.has(&hash) => {
                        self.actions.push(Action::Serve { link, hash, offset, length });
                    }
                    None => self.send(link, &Message::Missing { hash }),
                }
            }
            Message::Part { hash, offset, bytes } => {
                match neighbour.fetch.handle_part(now, &hash, offset, &bytes) {
                    PartOutcome::More | PartOutcome::Unwanted => {}
                    PartOutcome::Whole(bytes) => self.handle_object(link, node, hash, bytes),
                    PartOutcome::Wrong => {
                        // The neighbour's disk may be at fault, so it is not refused.
                        neighbour.later.insert(hash, now + ASK_AGAIN[1]);
                        let text = format!("{} sent an object that is not what it is called", neighbour.name);
                        self.actions.push(Action::Notify(Notice::Trouble(text)));
                    }
                }
            }
            Message::Missing { hash } => {
                if neighbour.fetch.drop_object(&hash) {
                    neighbour.later.insert(hash, now + ASK_AGAIN[0]);
                }
            }
        }
    }

    fn handle_hello(
        &mut self,
        now: Duration,
        link: LinkId,
        (version, node, is_station): (u16, Uuid, bool),
        name: String,
        results: Option<ResultsRef>,
    ) {
        let Some(known) = self.links.get(&link) else { return };
        let peer = known.peer.as_ref().map(|peer| peer.id);
        let node = match self.admitted(now, known, version, node) {
            Ok(node) => node,
            Err(reason) => return self.refuse(link, reason),
        };
        if !self.neighbours.contains_key(&node) {
            self.forget_gone(peer);
        }
        let Some(known) = self.links.get_mut(&link) else { return };
        if known.node.is_some_and(|before| before != node) {
            return self.refuse(link, "it said that it is another one than before".into());
        }
        let is_new = known.node.replace(node).is_none();
        let address = known.address.clone();
        let neighbour = self.neighbours.entry(node).or_default();
        neighbour.call(&name, known.peer.as_ref());
        neighbour.is_station = is_station;
        let name = neighbour.name.clone();
        let newer = |known: &ResultsRef| results.is_some_and(|new| new.revision > known.revision);
        let is_new_results = results.is_some() && neighbour.results.as_ref().is_none_or(newer);
        if is_new_results {
            neighbour.results = results;
        }
        if is_new {
            // It may have lost what it held.
            neighbour.stored.clear();
            neighbour.changed = now;
            let earlier = neighbour.link.replace(link).filter(|earlier| *earlier != link);
            neighbour.fetch.lost();
            if let Some(earlier) = earlier {
                self.links.remove(&earlier);
                let reason = "a newer link took its place".into();
                self.actions.push(Action::Close { link: earlier, reason });
            }
            self.actions.push(Action::Notify(Notice::Connected { name, address }));
        }
        if is_new || is_new_results {
            self.plan_fetch(node);
        }
    }

    /// The name by which a neighbour is known that says this version and this name; the reason where it is refused.
    fn admitted(&self, now: Duration, known: &Link, version: u16, node: Uuid) -> Result<Uuid, String> {
        // A neighbour that does not say which versions it speaks speaks only this one.
        let [oldest, newest] = known.speaks.unwrap_or([version; 2]);
        let [own_oldest, own_newest] = self.config.versions;
        if oldest > own_newest || newest < own_oldest {
            return Err(format!(
                "it speaks versions {oldest} to {newest} of the protocol, this one {own_oldest} to {own_newest}"
            ));
        }
        if node == self.config.node {
            return Err("it is this one itself: the address is one's own".into());
        }
        self.known_as(now, known, node)
    }

    /// Has nothing more to do with whoever told a map that is none, for some minutes.
    pub(super) fn ban(&mut self, now: Duration, agent: Identity, reason: String) {
        let Some(remote) = self.remote_maps.remove(&agent) else { return };
        for lists in remote.in_use() {
            self.release_remote(lists);
        }
        let reason = format!("its map {agent} cannot be used: {reason}");
        let link = self.neighbours.get(&remote.publisher).and_then(|neighbour| neighbour.link);
        self.banned.retain(|_, (_, until)| *until > now);
        for culprit in [Some(remote.publisher), remote.peer].into_iter().flatten() {
            self.banned.insert(culprit, (reason.clone(), now + BAN_DURATION));
        }
        if let Some(link) = link {
            self.refuse(link, reason);
        }
    }
}
