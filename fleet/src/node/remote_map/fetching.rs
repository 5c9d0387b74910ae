//! What a node does about maps that others tell.

use super::RemoteMap;
use crate::assembling::read_page;
use crate::hash::ObjectHash;
use crate::link::ObjectRef;
use crate::manifest::{ENTRIES, Kind, Manifest, Page};
use crate::node::quota::Load;
use crate::node::{Action, LinkId, Lists, Node, Notice, Quota};
use crate::store::Head;
use crate::wire::{MapVersion, Signature};
use map::{Identity, Uuid};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Pages of a manifest beside those that are full: one of what is not of keyframes, and one of what is.
const PARTIAL_PAGES: usize = 2;

impl Node {
    /// A neighbour says which version of a map it has.
    pub(in crate::node) fn handle_version(
        &mut self,
        link: LinkId,
        node: Uuid,
        version: MapVersion,
        signature: Option<Signature>,
    ) {
        let Some(known) = self.links.get(&link) else { return };
        if let Err(reason) = self.authorise(known, &version, signature.as_ref()) {
            return self.refuse(link, reason);
        }
        let peer = known.peer.as_ref().map(|peer| peer.id);
        if self.own.contains_key(&version.agent) {
            let agent = version.agent;
            let reason = format!(
                "it tells the map of agent {agent}, which is told here: two runs of one recording are one agent"
            );
            return self.refuse(link, reason);
        }
        let is_linked = self.remote_maps.get(&version.agent).is_some_and(|remote| self.is_near(remote));
        match self.remote_maps.get_mut(&version.agent) {
            None => {
                let count = self.remote_maps.values().filter(|remote| remote.is_of(node, peer)).count();
                if count >= self.config.quota.maps {
                    return self.refuse(link, format!("it tells more than {count} maps, as many as one may"));
                }
                let remote = RemoteMap::new(node, peer, version, !self.config.waits);
                self.remote_maps.insert(version.agent, remote);
            }
            Some(remote) if remote.publisher != node && is_linked => {
                let agent = version.agent;
                return self
                    .refuse(link, format!("it tells the map of agent {agent}, which another one tells"));
            }
            Some(remote) => {
                if version.order() < remote.version.order() {
                    // An older one, that comes late or is told again by who must not: the newer stays.
                    return;
                }
                let is_new = version.order() > remote.version.order();
                if !is_new && version.hash != remote.version.hash {
                    let reason = "it tells two maps as the same version of one".into();
                    return self.refuse(link, reason);
                }
                let has_new_publisher = remote.publisher != node;
                (remote.publisher, remote.peer) = (node, peer.or(remote.peer));
                if !is_new && !has_new_publisher {
                    return;
                }
                remote.version = version;
                // Pages that came may be the next version's too.
                remote.coming.manifest = None;
            }
        }
        self.plan_fetch(node);
    }

    /// What is to be fetched from a neighbour by now.
    pub(in crate::node) fn plan_fetch(&mut self, node: Uuid) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        let newer = neighbour.results.filter(|results| results.revision > neighbour.results_here);
        let mut wanted: Vec<ObjectRef> =
            newer.iter().map(|results| ObjectRef { hash: results.hash, size: results.size }).collect();
        for remote in self.remote_maps.values_mut().filter(|remote| remote.publisher == node) {
            wanted.extend(remote.objects_to_fetch(&*self.store, &self.of_remote));
        }
        let mut seen = BTreeSet::new();
        wanted.retain(|want| !neighbour.later.contains_key(&want.hash) && seen.insert(want.hash));
        neighbour.fetch.set_queue(wanted);
    }

    /// Fetches some objects before others, or others too.
    pub(in crate::node) fn prefer(&mut self, agent: Identity, objects: Vec<(Kind, u32)>, rest: bool) {
        let Some(remote) = self.remote_maps.get_mut(&agent) else { return };
        if remote.preferred == objects && remote.rest == rest {
            return;
        }
        (remote.preferred, remote.rest) = (objects, rest);
        let publisher = remote.publisher;
        self.plan_fetch(publisher);
    }

    /// An object came.
    pub(in crate::node) fn handle_object(
        &mut self,
        link: LinkId,
        node: Uuid,
        hash: ObjectHash,
        bytes: Vec<u8>,
    ) {
        let Some(neighbour) = self.neighbours.get_mut(&node) else { return };
        if let Some(results) = neighbour.results.filter(|results| results.hash == hash) {
            neighbour.results_here = results.revision;
            self.arrivals += 1;
            let peer = neighbour.peer.as_ref().map(|peer| peer.id);
            return self.actions.push(Action::Notify(Notice::Results { from: node, peer, bytes }));
        }
        let bytes: Arc<[u8]> = bytes.into();
        let agents: Vec<_> = self
            .remote_maps
            .iter()
            .filter(|(_, remote)| remote.publisher == node)
            .map(|(agent, _)| *agent)
            .collect();
        let mut lists_came = false;
        let mut awaited = Vec::new();
        for agent in agents {
            let Some(remote) = self.remote_maps.get_mut(&agent) else { continue };
            let is_last = remote.missing.len() == 1 && remote.missing.contains(&hash);
            if remote.awaited.remove(&hash) || is_last {
                awaited.push((agent, is_last));
            }
            let is_preview = remote.previews.contains(&hash);
            if remote.missing.remove(&hash) || is_preview {
                if is_preview {
                    remote.previews_here.insert(hash);
                }
                remote.came += 1;
                self.store.put(&hash, Arc::clone(&bytes));
                self.actions
                    .extend(remote.snapshot(true).map(|snapshot| Action::Notify(Notice::Map(snapshot))));
                self.complete(agent);
            } else if !remote.is_newest() {
                lists_came |= self.handle_list(link, agent, &hash, &bytes);
            }
        }
        if lists_came {
            self.plan_fetch(node);
        }
        // Lists that came say what is awaited then.
        let is_next =
            |agent: &Identity| self.remote_maps.get(agent).is_some_and(|remote| remote.awaited.is_empty());
        let arrived = awaited.iter().filter(|(agent, is_last)| *is_last || is_next(agent));
        self.arrivals += arrived.count() as u64;
    }

    /// Takes a list of a map's newest version, if the object is one; whether there is more to fetch now.
    fn handle_list(&mut self, link: LinkId, agent: Identity, hash: &ObjectHash, bytes: &Arc<[u8]>) -> bool {
        let Some(remote) = self.remote_maps.get_mut(&agent) else { return false };
        let is_page = |(manifest, _): &(Manifest, _)| manifest.pages.iter().any(|page| page.hash == *hash);
        let taken = if remote.version.hash == *hash {
            remote.adopt_manifest(bytes, &self.config.quota)
        } else if remote.coming.manifest.as_ref().is_some_and(is_page) {
            read_page(bytes).map(|page| drop(remote.coming.pages.insert(*hash, (page, Arc::clone(bytes)))))
        } else {
            return false;
        };
        match taken.and_then(|()| self.adopt_lists(agent)) {
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
    fn adopt_lists(&mut self, agent: Identity) -> Result<(), String> {
        let Some(remote) = self.remote_maps.get_mut(&agent) else { return Ok(()) };
        let Some((manifest, _)) = &remote.coming.manifest else { return Ok(()) };
        let page = |hash: &ObjectHash| {
            let came = remote.coming.pages.get(hash).map(|(page, _)| page);
            came.or_else(|| self.of_remote.page(hash)).cloned()
        };
        let pages: Option<Vec<Page>> = manifest.pages.iter().map(|named| page(&named.hash)).collect();
        let Some(pages) = pages else { return Ok(()) };
        let lists = Arc::new(Lists::new(remote.version, manifest.clone(), pages)?);
        let (publisher, peer) = (remote.publisher, remote.peer);
        // Not more than one may tell, with all else that is of the same.
        let others = self
            .remote_maps
            .values()
            .filter(|remote| remote.version.agent != agent && remote.is_of(publisher, peer));
        self.config.quota.check(Load::sum(others.map(RemoteMap::load).chain([lists.load])))?;
        let Some(remote) = self.remote_maps.get_mut(&agent) else { return Ok(()) };
        let coming = std::mem::take(&mut remote.coming);
        let bytes = coming.manifest.map(|(_, bytes)| (remote.version.hash, bytes));
        let pages = coming.pages.into_iter().map(|(hash, (_, bytes))| (hash, bytes));
        pages.chain(bytes).for_each(|(hash, bytes)| self.store.put(&hash, bytes));
        self.of_remote.add(&lists);
        let before = remote.lists.clone();
        remote.set_lists(lists, &*self.store);
        self.actions.extend(remote.snapshot(true).map(|snapshot| Action::Notify(Notice::Map(snapshot))));
        before.iter().for_each(|before| self.release_remote(before));
        self.complete(agent);
        Ok(())
    }

    /// Has a map of which nothing is missing any more brought to the disk.
    fn complete(&mut self, agent: Identity) {
        let Some(remote) = self.remote_maps.get_mut(&agent) else { return };
        let is_due = remote.writing.is_none() && remote.is_unkept();
        let Some(lists) = remote.lists.clone().filter(|_| is_due) else { return };
        let head = Head { manifest: lists.map_version.hash, own: false, peer: remote.peer };
        self.of_remote.add(&lists);
        remote.writing = Some(lists);
        self.store.set_head(agent, head);
    }

    /// Acknowledges a map that is whole, and on the disk.
    pub(in crate::node) fn completed(&mut self, agent: Identity, manifest: ObjectHash) {
        let Some(remote) = self.remote_maps.get_mut(&agent) else { return };
        let Some(lists) = remote.writing.take_if(|lists| lists.map_version.hash == manifest) else { return };
        let is_whole =
            remote.missing.is_empty() || !Arc::ptr_eq(&lists, remote.lists.as_ref().unwrap_or(&lists));
        if is_whole {
            remote.stored_version = lists.map_version.order();
        }
        let mut aside = BTreeSet::new();
        if is_whole && remote.is_newest() && remote.stored_version == remote.version.order() {
            // What stood in for others is needed no more.
            aside = std::mem::take(&mut remote.previews_here);
        }
        let before = remote.whole.replace(lists);
        let (acknowledgement, publisher) = (remote.acknowledgement(), remote.publisher);
        before.iter().for_each(|before| self.release_remote(before));
        self.set_aside(aside);
        if let Some(link) = self.neighbours.get(&publisher).and_then(|publisher| publisher.link) {
            self.send(link, &acknowledgement);
        }
        // The next version may be whole by now.
        self.complete(agent);
    }
}

impl RemoteMap {
    /// Takes the manifest of the newest version, which came.
    fn adopt_manifest(&mut self, bytes: &Arc<[u8]>, quota: &Quota) -> Result<(), String> {
        let manifest = Manifest::from_bytes(bytes)
            .map_err(|what| format!("the list of its map's objects cannot be read: {what}"))?;
        if manifest.agent != self.version.agent || (manifest.begun, manifest.revision) != self.version.order()
        {
            return Err("it tells another map than it says".into());
        }
        let most = PARTIAL_PAGES + quota.objects() / ENTRIES;
        if manifest.pages.len() > most {
            return Err(format!("it lists objects on {} pages, more than {most}", manifest.pages.len()));
        }
        let named: BTreeSet<ObjectHash> = manifest.pages.iter().map(|page| page.hash).collect();
        self.coming.pages.retain(|hash, _| named.contains(hash));
        self.coming.manifest = Some((manifest, Arc::clone(bytes)));
        Ok(())
    }
}
