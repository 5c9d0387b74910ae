//! What a node says by itself: signs of life, what it has, what it wants, and why it has nothing more to do with somebody.

use super::publishing::Own;
use super::{Action, BEAT, Link, LinkId, Node, Notice, RemoteMap, SILENCE, STATES, UNWRITTEN};
use crate::bytes::cut;
use crate::hash::ObjectHash;
use crate::manifest::MAX_LIST;
use crate::merge_results::{ByAgent, MergeResults};
use crate::wire::{MAX_NAME, MAX_REASON, Message, ResultsRef};
use map::Uuid;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// How often a neighbour is told anew what was found out, at the most: the time by the number of links, as it takes some
/// milliseconds to say it to one.
const RESULTS_INTERVAL: Duration = Duration::from_millis(10);

/// What a neighbour is told of what was found out.
pub(super) struct SentResults {
    pub known: ResultsRef,
    pub bytes: Vec<u8>,
    /// Of which version it is, and when it was made.
    of: u64,
    made: Duration,
}

impl Node {
    /// Something new was found out.
    pub(super) fn set_results(&mut self, revision: u64, found: Arc<MergeResults>) {
        self.results = Some((revision, ByAgent::new(found)));
        self.links.values_mut().for_each(|link| link.beat = None);
    }

    /// What was found out, as a neighbour is told it: of what concerns the agents that it tells, and where all are.
    fn results_for(&self, now: Duration, link: &Link, node: Uuid) -> Option<SentResults> {
        let (revision, found) = self.results.as_ref()?;
        let pause = RESULTS_INTERVAL * self.links.len() as u32;
        if let Some(known) = &link.sent_results
            && (known.of == *revision || now < known.made + pause)
        {
            return None;
        }
        let remote = self.remote_maps.iter().filter(|(_, remote)| remote.publisher == node);
        let agents: BTreeSet<String> = remote.map(|(agent, _)| agent.to_string()).collect();
        let bytes = found.about(&agents).to_bytes_within(MAX_LIST as usize);
        let known =
            ResultsRef { revision: *revision, size: bytes.len() as u32, hash: ObjectHash::of(&bytes) };
        Some(SentResults { known, bytes, of: *revision, made: now })
    }

    /// Signs of life, and the end of links that give none.
    pub(super) fn beat(&mut self, now: Duration) {
        let silent = |link: &Link| now.saturating_sub(link.last_received) > SILENCE;
        let dead: Vec<LinkId> =
            self.links.iter().filter(|(_, link)| silent(link)).map(|(id, _)| *id).collect();
        for link in dead {
            let reason = format!("nothing was heard for {} s", SILENCE.as_secs());
            self.forget(link, &reason);
            self.actions.push(Action::Close { link, reason });
        }
        let due: Vec<LinkId> = self
            .links
            .iter_mut()
            .filter(|(_, link)| link.beat.is_none_or(|beat| now.saturating_sub(beat) >= BEAT))
            .map(|(id, link)| {
                (link.beat, link.cycle) = (Some(now), link.cycle.wrapping_add(1));
                *id
            })
            .collect();
        for link in due {
            self.ask_again(now, link);
            self.announce(now, link);
        }
    }

    /// Says on a link who one is and what one has.
    pub(super) fn announce(&mut self, now: Duration, link: LinkId) {
        let Some(known) = self.links.get(&link) else { return };
        let sent_results = known.node.and_then(|node| self.results_for(now, known, node));
        let Some(known) = self.links.get_mut(&link) else { return };
        if sent_results.is_some() {
            known.sent_results = sent_results;
        }
        let Link { cycle, node, sent_results, .. } = &*known;
        let [oldest, newest] = self.config.versions;
        let mut outgoing = vec![Message::Speaks { oldest, newest }];
        outgoing.push(Message::Hello {
            version: oldest,
            node: self.config.node,
            role: self.config.role,
            name: cut(&self.config.name, MAX_NAME).to_owned(),
            results: sent_results.as_ref().map(|sent_results| sent_results.known),
        });
        let own: Vec<Message> = self.own.values().filter_map(Own::announcement).collect();
        let of_neighbour = self.remote_maps.values().filter(|remote| Some(remote.publisher) == *node);
        let acknowledgements: Vec<Message> = of_neighbour.map(RemoteMap::acknowledgement).collect();
        for mut states in [own, acknowledgements] {
            let count = states.len().max(1);
            states.rotate_left(cycle.wrapping_mul(STATES) % count);
            outgoing.extend(states.into_iter().take(STATES));
        }
        outgoing.iter().for_each(|message| self.send(link, message));
    }

    /// Wants again what could not be had a while ago.
    fn ask_again(&mut self, now: Duration, link: LinkId) {
        let Some(node) = self.links.get(&link).and_then(|link| link.node) else { return };
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        let before = neighbour.later.len();
        neighbour.later.retain(|_, at| *at > now);
        if neighbour.later.len() < before {
            self.plan_fetch(node);
        }
    }

    /// Asks for what is wanted, unless too much of what came waits for the disk.
    pub(super) fn fetch(&mut self, now: Duration) {
        if self.store.unwritten() > UNWRITTEN {
            return;
        }
        for neighbour in self.neighbours.values_mut() {
            let Some(link) = neighbour.link else { continue };
            for message in neighbour.fetch.requests(now) {
                let (priority, bytes) = (message.priority(), message.to_bytes());
                self.actions.push(Action::Send { link, priority, bytes });
            }
        }
    }

    /// Ends the business with a neighbour, who is told why.
    pub(super) fn refuse(&mut self, link: LinkId, reason: String) {
        let Some(known) = self.links.get(&link) else { return };
        let of_peer = || known.peer.as_ref().map(|peer| peer.name.clone());
        let named = known.node.and_then(|node| self.neighbours.get(&node)).map(|n| n.name.clone());
        let named = named.or_else(of_peer).unwrap_or_else(|| known.address.clone());
        let text = format!("{named} is refused: {reason}");
        self.send(link, &Message::Refused { reason: cut(&reason, MAX_REASON).to_owned() });
        self.forget(link, "it is refused");
        self.actions.push(Action::Notify(Notice::Trouble(text.clone())));
        self.actions.push(Action::Close { link, reason: text });
    }

    /// A link is gone; `reason` says of whom it is the only one how that was noticed.
    pub(super) fn forget(&mut self, link: LinkId, reason: &str) {
        self.links.remove(&link);
        for neighbour in self.neighbours.values_mut().filter(|neighbour| neighbour.link == Some(link)) {
            (neighbour.link, neighbour.changed) = (None, self.now);
            neighbour.fetch.lost();
            let (name, reason) = (neighbour.name.clone(), reason.to_owned());
            self.actions.push(Action::Notify(Notice::Disconnected { name, reason }));
        }
    }

    pub(super) fn send(&mut self, link: LinkId, message: &Message) {
        let (priority, bytes) = (message.priority(), message.to_bytes());
        self.actions.push(Action::Send { link, priority, bytes });
    }
}
