//! What a node does about maps that others tell.

use super::Told;
use crate::assembling::entries_of;
use crate::hash::ObjectHash;
use crate::keys::Signature;
use crate::link::Want;
use crate::manifest::{Entry, Kind, Manifest};
use crate::node::quota::Load;
use crate::node::{Action, DISK_PAUSE, LinkId, News, Node};
use crate::store::Head;
use crate::wire::Offer;
use map::{Identity, Uuid};
use std::collections::BTreeSet;
use std::time::Duration;

impl Node {
    /// A neighbour says which version of a map it has.
    pub(in crate::node) fn offered(
        &mut self,
        link: LinkId,
        node: Uuid,
        offer: Offer,
        signature: Option<Signature>,
    ) {
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
        let is_linked = self.told.get(&offer.agent).is_some_and(|told| self.is_near(told));
        match self.told.get_mut(&offer.agent) {
            None => {
                let told = self.told.values().filter(|told| told.is_of(node, party)).count();
                if told >= self.config.quota.maps {
                    return self.refuse(link, format!("it tells more than {told} maps, as many as one may"));
                }
                let told = Told::new(node, party, offer, !self.config.waits);
                self.told.insert(offer.agent, told);
            }
            Some(told) if told.teller != node && is_linked => {
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
    pub(in crate::node) fn want(&mut self, node: Uuid) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        let newer = neighbour.findings.filter(|findings| findings.revision > neighbour.findings_here);
        let mut wants: Vec<Want> =
            newer.iter().map(|findings| Want { hash: findings.hash, size: findings.size }).collect();
        for told in self.told.values_mut().filter(|told| told.teller == node) {
            wants.extend(told.wants(&*self.store));
        }
        let mut seen = BTreeSet::new();
        wants.retain(|want| seen.insert(want.hash));
        neighbour.fetch.want(wants);
    }

    /// Fetches some objects before others, or others too.
    pub(in crate::node) fn prefer(&mut self, agent: Identity, objects: Vec<(Kind, u32)>, rest: bool) {
        let Some(told) = self.told.get_mut(&agent) else { return };
        if told.preferred == objects && told.rest == rest {
            return;
        }
        (told.preferred, told.rest) = (objects, rest);
        let teller = told.teller;
        self.want(teller);
    }

    /// An object came.
    pub(in crate::node) fn object(
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
            self.arrivals += 1;
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
        let mut awaited = Vec::new();
        for agent in agents {
            let Some(told) = self.told.get_mut(&agent) else { continue };
            let is_last = told.missing.len() == 1 && told.missing.contains(&hash);
            if told.awaited.remove(&hash) || is_last {
                awaited.push((agent, is_last));
            }
            if told.missing.remove(&hash) || told.stand_ins.contains(&hash) {
                told.came += 1;
                self.actions.extend(told.heard(true).map(|heard| Action::News(News::Map(heard))));
                self.complete(link, agent);
            } else if !told.all.contains(&hash) {
                lists_came |= self.lists(link, agent);
            }
        }
        if lists_came {
            self.want(node);
        }
        // Lists that came say what is awaited then.
        let is_next = |agent: &Identity| self.told.get(agent).is_some_and(|told| told.awaited.is_empty());
        let arrived = awaited.iter().filter(|(agent, is_last)| *is_last || is_next(agent));
        self.arrivals += arrived.count() as u64;
    }

    /// Takes the lists of a map's newest version, as far as they are here; whether there is more to fetch now.
    fn lists(&mut self, link: LinkId, agent: Identity) -> bool {
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
        let (teller, party) = (told.teller, told.party);
        let checked = match entries_of(&manifest, &*self.store) {
            // Pages are missing, which are known now.
            Ok(None) => return true,
            Ok(Some(entries)) => self.check_quota(agent, (teller, party), &entries).map(|()| entries),
            Err(reason) => Err(reason),
        };
        let entries = match checked {
            Ok(entries) => entries,
            Err(reason) => {
                self.refuse(link, reason);
                return false;
            }
        };
        let Some(told) = self.told.get_mut(&agent) else { return false };
        told.set_lists(manifest, entries, &*self.store);
        self.actions.extend(told.heard(true).map(|heard| Action::News(News::Map(heard))));
        self.complete(link, agent);
        true
    }

    /// Whether whoever tells a map of these objects tells no more than one may, with all else that is of the same.
    fn check_quota(
        &self,
        agent: Identity,
        (teller, party): (Uuid, Option<Uuid>),
        entries: &[Entry],
    ) -> Result<(), String> {
        let others = self.told.values().filter(|told| told.offer.agent != agent && told.is_of(teller, party));
        let others = others.flat_map(|told| told.entries.iter().flat_map(|entries| entries.iter()));
        self.config.quota.check(Load::of(others.chain(entries)))
    }

    /// Tries again what the disk refused before.
    pub(in crate::node) fn complete_all(&mut self) {
        let agents: Vec<_> = self.told.keys().copied().collect();
        for agent in agents {
            let teller = self.told.get(&agent).and_then(|told| self.neighbours.get(&told.teller));
            if let Some(link) = teller.and_then(|neighbour| neighbour.link) {
                self.complete(link, agent);
            }
        }
    }

    /// Acknowledges a map of which nothing is missing any more, once it is on the disk.
    fn complete(&mut self, link: LinkId, agent: Identity) {
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
