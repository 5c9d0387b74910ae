//! What a node says by itself: signs of life, what it has, what it wants, and why it has nothing more to do with somebody.

use super::{Action, BEAT, Link, LinkId, News, Node, Own, SILENCE, STATES, Told};
use crate::bytes::cut;
use crate::wire::{MAX_NAME, MAX_REASON, Message, VERSION};
use std::time::Duration;

impl Own {
    /// What is said of it.
    fn said(&self) -> Message {
        Message::State { offer: self.offer, signature: self.signature }
    }
}

impl Node {
    /// Signs of life, and the end of links that give none.
    pub(super) fn beat(&mut self, now: Duration) {
        let silent = |link: &Link| now.saturating_sub(link.heard) > SILENCE;
        let dead: Vec<LinkId> =
            self.links.iter().filter(|(_, link)| silent(link)).map(|(id, _)| *id).collect();
        for link in dead {
            self.forget(link);
            let reason = format!("nothing was heard for {} s", SILENCE.as_secs());
            self.actions.push(Action::Close { link, reason });
        }
        let due: Vec<LinkId> = self
            .links
            .iter_mut()
            .filter(|(_, link)| link.beat.is_none_or(|beat| now.saturating_sub(beat) >= BEAT))
            .map(|(id, link)| {
                (link.beat, link.turn) = (Some(now), link.turn.wrapping_add(1));
                *id
            })
            .collect();
        if !due.is_empty() && now >= self.paused_until {
            self.complete_all();
        }
        for link in due {
            self.tell(link);
        }
    }

    /// Says on a link who one is and what one has.
    pub(super) fn tell(&mut self, link: LinkId) {
        let Some(Link { turn, node, .. }) = self.links.get(&link) else { return };
        let mut said = vec![Message::Hello {
            version: VERSION,
            node: self.config.node,
            role: self.config.role,
            name: cut(&self.config.name, MAX_NAME).to_owned(),
            findings: self.findings.as_ref().map(|(known, _)| *known),
        }];
        let own: Vec<Message> = self.own.values().map(Own::said).collect();
        let of_neighbour = self.told.values().filter(|told| Some(told.teller) == *node);
        let held: Vec<Message> = of_neighbour.map(Told::held).collect();
        for mut states in [own, held] {
            let count = states.len().max(1);
            states.rotate_left(turn.wrapping_mul(STATES) % count);
            said.extend(states.into_iter().take(STATES));
        }
        said.iter().for_each(|message| self.send(link, message));
    }

    /// Asks for what is wanted.
    pub(super) fn fetch(&mut self, now: Duration) {
        if now < self.paused_until {
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
        let of_party = || known.party.as_ref().map(|party| party.name.clone());
        let named = known.node.and_then(|node| self.neighbours.get(&node)).map(|n| n.name.clone());
        let named = named.or_else(of_party).unwrap_or_else(|| known.address.clone());
        let text = format!("{named} is refused: {reason}");
        self.send(link, &Message::Refused { reason: cut(&reason, MAX_REASON).to_owned() });
        self.forget(link);
        self.actions.push(Action::News(News::Trouble(text.clone())));
        self.actions.push(Action::Close { link, reason: text });
    }

    pub(super) fn forget(&mut self, link: LinkId) {
        self.links.remove(&link);
        for neighbour in self.neighbours.values_mut().filter(|neighbour| neighbour.link == Some(link)) {
            neighbour.link = None;
            neighbour.fetch.lost();
        }
    }

    pub(super) fn send(&mut self, link: LinkId, message: &Message) {
        let (priority, bytes) = (message.priority(), message.to_bytes());
        self.actions.push(Action::Send { link, priority, bytes });
    }
}
