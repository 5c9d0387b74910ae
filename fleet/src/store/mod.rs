//! Where objects are kept: in a folder, where they outlast the program, or in memory for tests.
//!
//! Nothing here waits for a disk but [`Objects::get`]: what is put is there at once, from memory, and a thread of the store
//! brings it to the disk (`folder`, `writing`), through a layer (`disk`) that tests take away from under it.

mod disk;
mod folder;
mod pins;
mod shared;
#[cfg(test)]
mod tests;
mod writing;

#[cfg(test)]
pub(crate) use disk::cut::Cut;
pub use disk::{Disk, System};
pub use folder::FolderStore;
pub use pins::{Pin, Pins};

use crate::hash::ObjectHash;
use map::{Identity, Uuid};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Immutable objects by their hashes. All that is made of maps here knows nothing else of where they are.
pub trait Objects: Send + Sync {
    /// The size of an object that is here, bytes, by its file; what it holds is looked at by [`get`](Self::get).
    fn size(&self, hash: &ObjectHash) -> Option<u32>;

    /// Whether an object is here.
    fn has(&self, hash: &ObjectHash) -> bool {
        self.size(hash).is_some()
    }

    /// An object, once its content was found to be the one it is called by; `None` when it is not here, or damaged: then
    /// it is not here any more, and [`StoreEvent::Lost`] says so.
    fn get(&self, hash: &ObjectHash) -> Option<Arc<[u8]>>;

    /// Keeps an object, which is called by its content. Never waits; [`Store::set_head`] says when it is on the disk.
    fn put(&self, hash: &ObjectHash, bytes: Arc<[u8]>);

    /// Removes objects.
    fn remove(&self, objects: &[ObjectHash]);

    /// Has nothing removed that is here now, as long as what this returns is held.
    fn pin(&self) -> Pin {
        self.pins().pin()
    }

    /// Who reads.
    fn pins(&self) -> &Pins;
}

/// Objects, and of each agent which version of its map is whole.
pub trait Store: Objects {
    /// The maps that are whole here.
    fn heads(&self) -> BTreeMap<Identity, Head>;

    /// Has all that was put so far brought to the disk, and then noted that a map is whole by this. Never waits:
    /// [`StoreEvent::Head`] says when that is done.
    fn set_head(&self, agent: Identity, head: Head);

    /// What happened since this was asked last.
    fn events(&self) -> Vec<StoreEvent>;

    /// Bytes that are not on the disk yet, and in memory until they are.
    fn unwritten(&self) -> usize;

    /// Waits until all is on the disk that is to be: time in which that is done is none on a simulated network.
    #[cfg(test)]
    fn wait_until_written(&self) {}
}

/// What happened in a store.
#[derive(Debug)]
pub enum StoreEvent {
    /// A map is whole on the disk, whatever happens next.
    Head(Identity, Head),
    /// An object that was here is gone or damaged.
    Lost(ObjectHash),
    /// The disk refused, a full one say; it is tried again.
    Failed(String),
}

/// A map that is whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Its manifest.
    pub manifest: ObjectHash,
    /// Whether it is an agent's who works here: told to others, and not by others.
    pub own: bool,
    /// Whose agent told it, where peers have keys.
    pub peer: Option<Uuid>,
}

/// In memory: gone with the program.
#[derive(Default)]
pub struct MemoryStore {
    memory: Mutex<Memory>,
    pins: Pins,
}

#[derive(Default)]
struct Memory {
    objects: BTreeMap<ObjectHash, Arc<[u8]>>,
    heads: BTreeMap<Identity, Head>,
    events: Vec<StoreEvent>,
}

impl Objects for MemoryStore {
    fn size(&self, hash: &ObjectHash) -> Option<u32> {
        locked(&self.memory).objects.get(hash).map(|bytes| bytes.len() as u32)
    }

    fn get(&self, hash: &ObjectHash) -> Option<Arc<[u8]>> {
        locked(&self.memory).objects.get(hash).cloned()
    }

    fn put(&self, hash: &ObjectHash, bytes: Arc<[u8]>) {
        locked(&self.memory).objects.insert(*hash, bytes);
    }

    fn remove(&self, objects: &[ObjectHash]) {
        let mut memory = locked(&self.memory);
        objects.iter().for_each(|hash| drop(memory.objects.remove(hash)));
    }

    fn pins(&self) -> &Pins {
        &self.pins
    }
}

impl Store for MemoryStore {
    fn heads(&self) -> BTreeMap<Identity, Head> {
        locked(&self.memory).heads.clone()
    }

    fn set_head(&self, agent: Identity, head: Head) {
        let mut memory = locked(&self.memory);
        memory.heads.insert(agent, head);
        memory.events.push(StoreEvent::Head(agent, head));
    }

    fn events(&self) -> Vec<StoreEvent> {
        std::mem::take(&mut locked(&self.memory).events)
    }

    fn unwritten(&self) -> usize {
        0
    }
}

/// What is within; every section leaves it whole.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
