//! What a folder of objects and the thread that writes to it share.

use super::disk::Disk;
use super::{Head, Pins, StoreEvent, locked};
use crate::hash::ObjectHash;
use map::Identity;
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex};
use std::time::Instant;

/// The folder of the objects, that of the heads, and that of objects that are being written.
pub(super) const OBJECTS: &str = "objects";
pub(super) const HEADS: &str = "heads";
pub(super) const NEW: &str = "new";
/// This word follows the manifest of an agent who works here. Another agent's manifest is followed by its peer, if that is known.
pub(super) const OWN: &str = "own";

/// A job for the writing thread.
#[derive(Clone, Copy)]
pub(super) enum Job {
    /// Write an object that waits.
    Write(ObjectHash),
    /// Remove an object.
    Remove(ObjectHash),
    /// Write a head: the jobs before this one make its map whole.
    Head(Identity, Head),
}

/// What the store and its writing thread share.
pub(super) struct Inner {
    pub folder: PathBuf,
    pub disk: Box<dyn Disk>,
    pub state: Mutex<State>,
    pub changed: Condvar,
    pub pins: Pins,
}

/// What the store holds and what is still to be written.
#[derive(Default)]
pub(super) struct State {
    /// The sizes of the objects that the store has, bytes.
    pub sizes: HashMap<ObjectHash, u32>,
    /// The objects that are not on the disk yet, and their bytes in all.
    pub waiting: HashMap<ObjectHash, Arc<[u8]>>,
    pub waiting_bytes: usize,
    /// The objects whose content this program has checked.
    pub checked: HashSet<ObjectHash>,
    pub heads: BTreeMap<Identity, Head>,
    pub jobs: VecDeque<Job>,
    /// Since when jobs wait.
    pub since: Option<Instant>,
    pub events: Vec<StoreEvent>,
    /// Whether the store is being closed.
    pub ends: bool,
    /// Whether the thread is writing, and whether it must begin at once.
    pub is_at_work: bool,
    pub is_urgent: bool,
}

impl Inner {
    /// The file of an object.
    pub fn file(&self, hash: &ObjectHash) -> PathBuf {
        let name = hash.to_string();
        self.folder.join(OBJECTS).join(&name[..2]).join(name)
    }

    /// The file of an object until its content is on the disk.
    pub fn new_file(&self, hash: &ObjectHash) -> PathBuf {
        self.folder.join(NEW).join(hash.to_string())
    }

    /// The file of a head, and its text.
    pub fn head_file(&self, agent: Identity, head: Head) -> (PathBuf, String) {
        let path = self.folder.join(HEADS).join(format!("{}-{}", agent.uuid, agent.epoch));
        let peer = head.peer.map_or(String::new(), |peer| format!(" {peer}"));
        (path, format!("{} {}{peer}\n", head.manifest, if head.own { OWN } else { "told" }))
    }

    /// Forgets an object that is missing or damaged on the disk, and reports it.
    pub fn lose(&self, hash: &ObjectHash) {
        let mut state = locked(&self.state);
        state.forget(hash);
        state.events.push(StoreEvent::Lost(*hash));
        self.changed.notify_all();
    }
}

impl State {
    /// Adds a job for the writing thread.
    pub fn add(&mut self, job: Job) {
        self.jobs.push_back(job);
        self.since.get_or_insert_with(Instant::now);
    }

    /// Frees the memory of an object that is written.
    pub fn written(&mut self, hash: &ObjectHash) {
        if let Some(bytes) = self.waiting.remove(hash) {
            self.waiting_bytes -= bytes.len();
        }
    }

    /// Removes an object.
    pub fn forget(&mut self, hash: &ObjectHash) {
        if self.sizes.remove(hash).is_some() {
            self.written(hash);
            self.checked.remove(hash);
            self.add(Job::Remove(*hash));
        }
    }
}
