//! Own maps: told once they are on the disk.

use super::{Action, Lists, Node, Notice};
use crate::hash::ObjectHash;
use crate::publishing::Publication;
use crate::store::Head;
use crate::wire::{MapVersion, Message, Signature};
use map::Identity;
use std::sync::Arc;

/// Most bytes of own maps that wait for the disk: what comes then is not kept.
const UNWRITTEN: usize = 256 << 20;

/// A map of one's own.
#[derive(Default)]
pub(super) struct Own {
    /// As it is told; nothing before its first version is on the disk.
    current: Option<Published>,
    /// What the version before had: somebody may be fetching it.
    before: Option<Arc<Lists>>,
    /// The version that goes to the disk, and the one that does so next.
    writing: Option<Arc<Lists>>,
    next: Option<Arc<Lists>>,
}

struct Published {
    lists: Arc<Lists>,
    /// The peer's under it, if peers have keys.
    signature: Option<Signature>,
}

impl Own {
    /// One that is on the disk.
    pub fn new(lists: Arc<Lists>, signature: Option<Signature>) -> Self {
        Self { current: Some(Published { lists, signature }), ..Self::default() }
    }

    /// The version that is told.
    pub fn lists(&self) -> Option<&Lists> {
        self.current.as_ref().map(|current| &*current.lists)
    }

    /// What is said of it.
    pub fn version(&self) -> Option<MapVersion> {
        self.lists().map(|lists| lists.map_version)
    }

    /// The same as a message.
    pub fn announcement(&self) -> Option<Message> {
        let Published { lists, signature } = self.current.as_ref()?;
        Some(Message::State { version: lists.map_version, signature: *signature })
    }

    /// Whether its newest version is told.
    pub fn is_published(&self) -> bool {
        self.current.is_some() && self.writing.is_none()
    }
}

impl Node {
    /// An agent who works here has a new version of its map.
    pub(super) fn publish(&mut self, publication: Publication) {
        let Publication { version, objects, manifest, pages } = publication;
        let lists = Lists::new(version, manifest, pages);
        let (Ok(lists), false) = (lists, self.store.unwritten() > UNWRITTEN) else {
            // The version before stays.
            let text = "what is new of the map cannot be kept and is not told yet: the disk does not take it";
            return self.actions.extend([Notice::Trouble(text.into()), Notice::Unkept].map(Action::Notify));
        };
        objects.into_iter().for_each(|(hash, bytes)| self.store.put(&hash, bytes));
        let lists = Arc::new(lists);
        self.of_own.add(&lists);
        if let Some(remote) = self.remote_maps.remove(&version.agent) {
            remote.in_use().for_each(|lists| self.release_remote(lists));
        }
        let own = self.own.entry(version.agent).or_default();
        let skipped = match own.writing {
            Some(_) => own.next.replace(lists),
            None => {
                let head = Head { manifest: version.hash, own: true, peer: None };
                self.store.set_head(version.agent, head);
                own.writing.replace(lists)
            }
        };
        self.release_own(skipped);
    }

    /// A version of an own map is on the disk.
    pub(super) fn published(&mut self, agent: Identity, manifest: ObjectHash) {
        let Some(own) = self.own.get_mut(&agent) else { return };
        let Some(lists) = own.writing.take_if(|lists| lists.map_version.hash == manifest) else { return };
        if let Some(next) = own.next.take() {
            let head = Head { manifest: next.map_version.hash, own: true, peer: None };
            self.store.set_head(agent, head);
            own.writing = Some(next);
        }
        let signature = self.config.signer.as_ref().map(|signer| signer.sign(&lists.map_version));
        let version = lists.map_version.order();
        let current = own.current.replace(Published { lists, signature });
        let earlier = std::mem::replace(&mut own.before, current.map(|current| current.lists));
        self.release_own(earlier);
        self.links.values_mut().for_each(|link| link.beat = None);
        self.actions.push(Action::Notify(Notice::Published { agent, version }));
    }

    fn release_own(&mut self, lists: Option<Arc<Lists>>) {
        let unused = lists.map(|lists| self.of_own.remove(&lists));
        self.set_aside(unused.into_iter().flatten());
    }
}
