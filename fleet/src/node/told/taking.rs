//! What a node does about maps that others tell.

use super::Told;
use crate::assembling::read_page;
use crate::hash::ObjectHash;
use crate::keys::Signature;
use crate::link::Want;
use crate::manifest::{ENTRIES, Kind, Manifest, Page};
use crate::node::quota::Load;
use crate::node::{Action, LinkId, Lists, News, Node, Quota};
use crate::store::Head;
use crate::wire::Offer;
use map::{Identity, Uuid};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Pages of a manifest beside those that are full: one of what is not of keyframes, and one of what is.
const BESIDE_FULL: usize = 2;

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
                // Pages that came may be the next version's too.
                told.coming.manifest = None;
            }
        }
        self.want(node);
    }

    /// What is to be fetched from a neighbour by now.
    pub(in crate::node) fn want(&mut self, node: Uuid) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        let newer = neighbour.findings.filter(|findings| findings.revision > neighbour.findings_here);
        let mut wants: Vec<Want> =
            newer.iter().map(|findings| Want { hash: findings.hash, size: findings.size }).collect();
        for told in self.told.values_mut().filter(|told| told.teller == node) {
            wants.extend(told.wants(&*self.store, &self.of_told));
        }
        let mut seen = BTreeSet::new();
        wants.retain(|want| !neighbour.later.contains_key(&want.hash) && seen.insert(want.hash));
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
    pub(in crate::node) fn object(&mut self, link: LinkId, node: Uuid, hash: ObjectHash, bytes: Vec<u8>) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        if let Some(findings) = neighbour.findings.filter(|findings| findings.hash == hash) {
            neighbour.findings_here = findings.revision;
            self.arrivals += 1;
            let party = neighbour.party.as_ref().map(|party| party.id);
            return self.actions.push(Action::News(News::Findings { from: node, party, bytes }));
        }
        let bytes: Arc<[u8]> = bytes.into();
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
            let is_stand_in = told.stand_ins.contains(&hash);
            if told.missing.remove(&hash) || is_stand_in {
                if is_stand_in {
                    told.stand_ins_here.insert(hash);
                }
                told.came += 1;
                self.store.put(&hash, Arc::clone(&bytes));
                self.actions.extend(told.heard(true).map(|heard| Action::News(News::Map(heard))));
                self.complete(agent);
            } else if !told.is_newest() {
                lists_came |= self.list(link, agent, &hash, &bytes);
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

    /// Takes a list of a map's newest version, if the object is one; whether there is more to fetch now.
    fn list(&mut self, link: LinkId, agent: Identity, hash: &ObjectHash, bytes: &Arc<[u8]>) -> bool {
        let Some(told) = self.told.get_mut(&agent) else { return false };
        let is_page = |(manifest, _): &(Manifest, _)| manifest.pages.iter().any(|page| page.hash == *hash);
        let taken = if told.offer.hash == *hash {
            told.take_manifest(bytes, &self.config.quota)
        } else if told.coming.manifest.as_ref().is_some_and(is_page) {
            read_page(bytes).map(|page| drop(told.coming.pages.insert(*hash, (page, Arc::clone(bytes)))))
        } else {
            return false;
        };
        match taken.and_then(|()| self.take_lists(agent)) {
            Ok(()) => true,
            Err(reason) => {
                self.refuse(link, reason);
                false
            }
        }
    }

    /// Takes the lists of a map's newest version, once all of them are here.
    ///
    /// # Errors
    /// When they are none, or say more than may be told.
    fn take_lists(&mut self, agent: Identity) -> Result<(), String> {
        let Some(told) = self.told.get_mut(&agent) else { return Ok(()) };
        let Some((manifest, _)) = &told.coming.manifest else { return Ok(()) };
        let page = |hash: &ObjectHash| {
            let came = told.coming.pages.get(hash).map(|(page, _)| page);
            came.or_else(|| self.of_told.page(hash)).cloned()
        };
        let pages: Option<Vec<Page>> = manifest.pages.iter().map(|named| page(&named.hash)).collect();
        let Some(pages) = pages else { return Ok(()) };
        let lists = Arc::new(Lists::new(told.offer, manifest.clone(), pages)?);
        let (teller, party) = (told.teller, told.party);
        // Not more than one may tell, with all else that is of the same.
        let others = self.told.values().filter(|told| told.offer.agent != agent && told.is_of(teller, party));
        self.config.quota.check(Load::sum(others.map(Told::load).chain([lists.load])))?;
        let Some(told) = self.told.get_mut(&agent) else { return Ok(()) };
        let coming = std::mem::take(&mut told.coming);
        let bytes = coming.manifest.map(|(_, bytes)| (told.offer.hash, bytes));
        let pages = coming.pages.into_iter().map(|(hash, (_, bytes))| (hash, bytes));
        pages.chain(bytes).for_each(|(hash, bytes)| self.store.put(&hash, bytes));
        self.of_told.add(&lists);
        let before = told.lists.clone();
        told.set_lists(lists, &*self.store);
        self.actions.extend(told.heard(true).map(|heard| Action::News(News::Map(heard))));
        before.iter().for_each(|before| self.release_told(before));
        self.complete(agent);
        Ok(())
    }

    /// Has a map of which nothing is missing any more brought to the disk.
    fn complete(&mut self, agent: Identity) {
        let Some(told) = self.told.get_mut(&agent) else { return };
        let is_due = told.going.is_none() && told.is_unkept();
        let Some(lists) = told.lists.clone().filter(|_| is_due) else { return };
        let head = Head { manifest: lists.offer.hash, own: false, party: told.party };
        self.of_told.add(&lists);
        told.going = Some(lists);
        self.store.set_head(agent, head);
    }

    /// Acknowledges a map that is whole, and on the disk.
    pub(in crate::node) fn completed(&mut self, agent: Identity, manifest: ObjectHash) {
        let Some(told) = self.told.get_mut(&agent) else { return };
        let Some(lists) = told.going.take_if(|lists| lists.offer.hash == manifest) else { return };
        let is_whole = told.missing.is_empty() || !Arc::ptr_eq(&lists, told.lists.as_ref().unwrap_or(&lists));
        if is_whole {
            told.held = lists.offer.version();
        }
        let mut aside = BTreeSet::new();
        if is_whole && told.is_newest() && told.held == told.offer.version() {
            // What stood in for others is needed no more.
            aside = std::mem::take(&mut told.stand_ins_here);
        }
        let before = told.whole.replace(lists);
        let (held, teller) = (told.held(), told.teller);
        before.iter().for_each(|before| self.release_told(before));
        self.set_aside(aside);
        if let Some(link) = self.neighbours.get(&teller).and_then(|teller| teller.link) {
            self.send(link, &held);
        }
        // The next version may be whole by now.
        self.complete(agent);
    }
}

impl Told {
    /// Takes the manifest of the newest version, which came.
    fn take_manifest(&mut self, bytes: &Arc<[u8]>, quota: &Quota) -> Result<(), String> {
        let manifest = Manifest::from_bytes(bytes)
            .map_err(|what| format!("the list of its map's objects cannot be read: {what}"))?;
        if manifest.agent != self.offer.agent || (manifest.begun, manifest.revision) != self.offer.version() {
            return Err("it tells another map than it says".into());
        }
        let most = BESIDE_FULL + quota.objects() / ENTRIES;
        if manifest.pages.len() > most {
            return Err(format!("it lists objects on {} pages, more than {most}", manifest.pages.len()));
        }
        let named: BTreeSet<ObjectHash> = manifest.pages.iter().map(|page| page.hash).collect();
        self.coming.pages.retain(|hash, _| named.contains(hash));
        self.coming.manifest = Some((manifest, Arc::clone(bytes)));
        Ok(())
    }
}
