//! Objects in a folder: `objects/ab/abcd…`, a file each, and `heads/UUID-EPOCH` with the manifest of each map that is whole.
//!
//! A file gets its name under `objects` once its content is on the disk. So after a power cut each name there is that of a
//! whole file, unless the disk itself is at fault. Until then an object is in memory, and its file in `new`.

use super::disk::{Disk, System};
use super::shared::{HEADS, Inner, Job, NEW, OBJECTS, OWN, State};
use super::writing::Writer;
use super::{Head, Objects, Pins, Store, StoreEvent, locked};
use crate::hash::ObjectHash;
use crate::manifest::Manifest;
use map::{Identity, Uuid};
use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;

/// What the system says where a disk cannot read what it wrote.
const EIO: i32 = 5;

/// In a folder. Whatever ends the program or the machine, what [`StoreEvent::Head`] was said of is there.
pub struct FolderStore {
    inner: Arc<Inner>,
    thread: Option<JoinHandle<()>>,
    /// Keeps other programs out; the system lets go of it when this one is killed.
    _lock: Option<File>,
}

impl FolderStore {
    /// Opens a folder, which is made if it is not there.
    ///
    /// # Errors
    /// When it cannot be made, read or written to, or another program uses it.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let lock = File::create(folder.join("lock"))?;
        if let Err(fs::TryLockError::WouldBlock) = lock.try_lock() {
            let what = format!("{}: another program keeps its objects there", folder.display());
            return Err(io::Error::new(ErrorKind::ResourceBusy, what));
        }
        let mut store = Self::on(Box::new(System), folder)?;
        store._lock = Some(lock);
        Ok(store)
    }

    /// Opens a folder on this disk.
    pub(crate) fn on(disk: Box<dyn Disk>, folder: &Path) -> io::Result<Self> {
        let mut sizes = HashMap::new();
        for (path, length) in disk.files(&folder.join(OBJECTS))? {
            match hash_of(&path) {
                Some(hash) => drop(sizes.insert(hash, u32::try_from(length).unwrap_or(u32::MAX))),
                None => disk.remove(&path),
            }
        }
        let state = Mutex::new(State { sizes, ..State::default() });
        let (folder, changed, pins) = (folder.to_owned(), Condvar::new(), Pins::default());
        let inner = Arc::new(Inner { folder, disk, state, changed, pins });
        let of_thread = Arc::clone(&inner);
        let work = move || Writer(of_thread).work();
        let thread = std::thread::Builder::new().name("fleet-store".into()).spawn(work)?;
        let store = Self { inner, thread: Some(thread), _lock: None };
        store.recover_new()?;
        store.read_heads()?;
        Ok(store)
    }

    /// Takes in what a program that was killed was writing, as far as it is right.
    fn recover_new(&self) -> io::Result<()> {
        for (path, _) in self.inner.disk.files(&self.inner.folder.join(NEW))? {
            let bytes = self.inner.disk.read(&path).unwrap_or_default();
            match hash_of(&path).filter(|hash| ObjectHash::of(&bytes) == *hash) {
                Some(hash) => self.put(&hash, bytes.into()),
                None => self.inner.disk.remove(&path),
            }
        }
        Ok(())
    }

    fn read_heads(&self) -> io::Result<()> {
        for (path, _) in self.inner.disk.files(&self.inner.folder.join(HEADS))? {
            let text = self.inner.disk.read(&path).unwrap_or_default();
            let text = String::from_utf8_lossy(&text);
            let mut words = text.split_whitespace();
            let hash = words.next().and_then(ObjectHash::parse);
            let Some(hash) = hash.filter(|_| path.extension().is_none()) else { continue };
            let own = words.next() == Some(OWN);
            let peer = words.next().and_then(|peer| Uuid::try_parse(peer).ok());
            // Whose it is its manifest says.
            if let Some(manifest) = self.get(&hash).and_then(|bytes| Manifest::from_bytes(&bytes).ok()) {
                let head = Head { manifest: hash, own, peer };
                locked(&self.inner.state).heads.insert(manifest.agent, head);
            }
        }
        Ok(())
    }
}

/// What an object is called whose file this is.
fn hash_of(path: &Path) -> Option<ObjectHash> {
    path.file_name().and_then(|name| ObjectHash::parse(name.to_str()?))
}

impl Objects for FolderStore {
    fn size(&self, hash: &ObjectHash) -> Option<u32> {
        locked(&self.inner.state).sizes.get(hash).copied()
    }

    fn get(&self, hash: &ObjectHash) -> Option<Arc<[u8]>> {
        let waiting = || {
            let state = locked(&self.inner.state);
            state.sizes.contains_key(hash).then(|| state.waiting.get(hash).cloned())
        };
        if let Some(bytes) = waiting()? {
            return Some(bytes);
        }
        let read = self.inner.disk.read(&self.inner.file(hash));
        let is_right = |bytes: &Vec<u8>| ObjectHash::of(bytes) == *hash;
        match read {
            Ok(bytes) if is_right(&bytes) => {
                locked(&self.inner.state).checked.insert(*hash);
                return Some(bytes.into());
            }
            // That there are too many open files, say, is no fault of this one.
            Err(error) if error.kind() != ErrorKind::NotFound && error.raw_os_error() != Some(EIO) => {
                return None;
            }
            _ => {}
        }
        // It may have been removed or put again meanwhile.
        let again = waiting()?;
        if again.is_none() {
            self.inner.lose(hash);
        }
        again
    }

    fn put(&self, hash: &ObjectHash, bytes: Arc<[u8]>) {
        let mut state = locked(&self.inner.state);
        // A file that was there before may be rotten: it is compared.
        if state.waiting.contains_key(hash) || !state.checked.insert(*hash) {
            return;
        }
        state.sizes.insert(*hash, bytes.len() as u32);
        state.waiting_bytes += bytes.len();
        state.waiting.insert(*hash, bytes);
        state.add(Job::Write(*hash));
        self.inner.changed.notify_all();
    }

    fn remove(&self, objects: &[ObjectHash]) {
        let mut state = locked(&self.inner.state);
        objects.iter().for_each(|hash| state.forget(hash));
        self.inner.changed.notify_all();
    }

    fn pins(&self) -> &Pins {
        &self.inner.pins
    }
}

impl Store for FolderStore {
    fn heads(&self) -> BTreeMap<Identity, Head> {
        locked(&self.inner.state).heads.clone()
    }

    fn set_head(&self, agent: Identity, head: Head) {
        locked(&self.inner.state).add(Job::Head(agent, head));
        self.inner.changed.notify_all();
    }

    fn events(&self) -> Vec<StoreEvent> {
        std::mem::take(&mut locked(&self.inner.state).events)
    }

    fn unwritten(&self) -> usize {
        locked(&self.inner.state).waiting_bytes
    }

    #[cfg(test)]
    fn wait_until_written(&self) {
        let mut state = locked(&self.inner.state);
        state.is_urgent = true;
        self.inner.changed.notify_all();
        let waits = |state: &mut State| state.is_at_work || !state.jobs.is_empty();
        let settled = self.inner.changed.wait_while(state, waits);
        settled.expect("no thread broke down").is_urgent = false;
    }
}

impl Drop for FolderStore {
    fn drop(&mut self) {
        locked(&self.inner.state).ends = true;
        self.inner.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // One that broke down writes no more.
            let _ = thread.join();
        }
    }
}
