//! Where objects are kept: on disk, where they outlast the program, or in memory for tests.

use crate::hash::ObjectHash;
use crate::manifest::{MAX_OBJECT, Manifest};
use map::{Identity, Uuid};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Keeps objects by their hashes, and of each agent which map is whole.
pub trait Store: Send + Sync {
    /// Whether an object is there.
    fn has(&self, hash: &ObjectHash) -> bool;

    /// An object, once its content was found to be the one it is called by; `None` when it is not there, or damaged,
    /// in which case it is not there any more.
    fn get(&self, hash: &ObjectHash) -> Option<Vec<u8>>;

    /// A part of an object, of at most `length` bytes, without looking whether it is damaged: who asked will.
    fn part(&self, hash: &ObjectHash, offset: u32, length: u32) -> Option<Vec<u8>>;

    /// Keeps an object. It is sure to be on the disk after the next [`set_head`](Self::set_head).
    ///
    /// # Errors
    /// When the system refuses, on a full disk say.
    fn put(&self, hash: &ObjectHash, bytes: &[u8]) -> io::Result<()>;

    /// The maps that are whole here.
    fn heads(&self) -> BTreeMap<Identity, Head>;

    /// Says that all of a map is here: what was put so far is on the disk when this returns.
    ///
    /// # Errors
    /// When the system refuses.
    fn set_head(&self, agent: Identity, head: Head) -> io::Result<()>;

    /// Removes objects.
    fn remove(&self, objects: &BTreeSet<ObjectHash>);
}

/// A map that is whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Its manifest.
    pub manifest: ObjectHash,
    /// Whether it is an agent's who works here: told to others, and not by others.
    pub own: bool,
    /// Whose agent told it, where parties have keys.
    pub party: Option<Uuid>,
}

/// In memory: gone with the program.
#[derive(Default)]
pub struct MemoryStore(Mutex<Memory>);

#[derive(Default)]
struct Memory {
    objects: BTreeMap<ObjectHash, Vec<u8>>,
    heads: BTreeMap<Identity, Head>,
}

impl Store for MemoryStore {
    fn has(&self, hash: &ObjectHash) -> bool {
        locked(&self.0).objects.contains_key(hash)
    }

    fn get(&self, hash: &ObjectHash) -> Option<Vec<u8>> {
        locked(&self.0).objects.get(hash).cloned()
    }

    fn part(&self, hash: &ObjectHash, offset: u32, length: u32) -> Option<Vec<u8>> {
        let memory = locked(&self.0);
        let rest = memory.objects.get(hash)?.get(offset as usize..)?;
        Some(rest[..rest.len().min(length as usize)].to_vec())
    }

    fn put(&self, hash: &ObjectHash, bytes: &[u8]) -> io::Result<()> {
        locked(&self.0).objects.insert(*hash, bytes.to_vec());
        Ok(())
    }

    fn heads(&self) -> BTreeMap<Identity, Head> {
        locked(&self.0).heads.clone()
    }

    fn set_head(&self, agent: Identity, head: Head) -> io::Result<()> {
        locked(&self.0).heads.insert(agent, head);
        Ok(())
    }

    fn remove(&self, objects: &BTreeSet<ObjectHash>) {
        locked(&self.0).objects.retain(|hash, _| !objects.contains(hash));
    }
}

/// In a folder: `objects/ab/abcd…`, a file each, and `heads/UUID-EPOCH` with the manifest of each map that is whole.
///
/// A file appears when it is whole. Whatever ends the program, what [`set_head`](Store::set_head) was told is there.
pub struct FolderStore {
    folder: PathBuf,
    state: Mutex<State>,
    /// Keeps other programs out; the system lets go of it when this one is killed.
    _lock: File,
}

#[derive(Default)]
struct State {
    objects: BTreeSet<ObjectHash>,
    heads: BTreeMap<Identity, Head>,
    /// Written, and perhaps not on the disk.
    unsynced: Vec<PathBuf>,
}

const OBJECTS: &str = "objects";
const HEADS: &str = "heads";
/// What stands behind the manifest of an agent who works here. Of another's its party follows, if it is known.
const OWN: &str = "own";

impl FolderStore {
    /// Opens a folder, which is made if it is not there.
    ///
    /// # Errors
    /// When it cannot be made, read or written to, or another program uses it.
    pub fn open(folder: &Path) -> io::Result<Self> {
        for part in [OBJECTS, HEADS] {
            fs::create_dir_all(folder.join(part))?;
        }
        let lock = File::create(folder.join("lock"))?;
        if let Err(fs::TryLockError::WouldBlock) = lock.try_lock() {
            let what = format!("{}: another program keeps its objects there", folder.display());
            return Err(io::Error::new(io::ErrorKind::ResourceBusy, what));
        }
        let mut state = State::default();
        for group in fs::read_dir(folder.join(OBJECTS))? {
            for file in fs::read_dir(group?.path())? {
                let path = file?.path();
                match path.file_name().and_then(|name| ObjectHash::parse(name.to_str()?)) {
                    Some(hash) => drop(state.objects.insert(hash)),
                    // What a killed program was writing.
                    None => drop(fs::remove_file(&path)),
                }
            }
        }
        let store = Self { folder: folder.to_owned(), state: Mutex::new(state), _lock: lock };
        for file in fs::read_dir(folder.join(HEADS))? {
            let Ok(text) = fs::read_to_string(file?.path()) else { continue };
            let mut words = text.split_whitespace();
            let Some(hash) = words.next().and_then(ObjectHash::parse) else { continue };
            let own = words.next() == Some(OWN);
            let party = words.next().and_then(|party| Uuid::try_parse(party).ok());
            // Whose it is its manifest says.
            if let Some(manifest) = store.get(&hash).and_then(|bytes| Manifest::from_bytes(&bytes).ok()) {
                let head = Head { manifest: hash, own, party };
                locked(&store.state).heads.insert(manifest.agent, head);
            }
        }
        Ok(store)
    }

    fn path(&self, hash: &ObjectHash) -> PathBuf {
        let name = hash.to_string();
        self.folder.join(OBJECTS).join(&name[..2]).join(name)
    }

    fn forget(&self, hash: &ObjectHash) {
        locked(&self.state).objects.remove(hash);
        // It may be gone already.
        let _ = fs::remove_file(self.path(hash));
    }
}

impl Store for FolderStore {
    fn has(&self, hash: &ObjectHash) -> bool {
        locked(&self.state).objects.contains(hash)
    }

    fn get(&self, hash: &ObjectHash) -> Option<Vec<u8>> {
        if !self.has(hash) {
            return None;
        }
        let bytes = fs::read(self.path(hash)).ok().filter(|bytes| ObjectHash::of(bytes) == *hash);
        if bytes.is_none() {
            self.forget(hash);
        }
        bytes
    }

    fn part(&self, hash: &ObjectHash, offset: u32, length: u32) -> Option<Vec<u8>> {
        if !self.has(hash) {
            return None;
        }
        let read = || -> io::Result<Vec<u8>> {
            let mut file = File::open(self.path(hash))?;
            file.seek(SeekFrom::Start(offset.into()))?;
            let mut bytes = Vec::new();
            file.take(length.min(MAX_OBJECT).into()).read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        read().ok()
    }

    fn put(&self, hash: &ObjectHash, bytes: &[u8]) -> io::Result<()> {
        if self.has(hash) {
            return Ok(());
        }
        let path = self.path(hash);
        let temporary = path.with_extension("tmp");
        fs::create_dir_all(path.parent().unwrap_or(&self.folder))?;
        let written = fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, &path));
        if let Err(error) = written {
            let _ = fs::remove_file(&temporary);
            return Err(error);
        }
        let mut state = locked(&self.state);
        state.objects.insert(*hash);
        state.unsynced.push(path);
        Ok(())
    }

    fn heads(&self) -> BTreeMap<Identity, Head> {
        locked(&self.state).heads.clone()
    }

    fn set_head(&self, agent: Identity, head: Head) -> io::Result<()> {
        let unsynced = std::mem::take(&mut locked(&self.state).unsynced);
        let mut folders = BTreeSet::new();
        for path in &unsynced {
            match File::open(path) {
                Ok(file) => file.sync_all()?,
                // Removed meanwhile: nobody wants it any more.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
            folders.extend(path.parent().map(Path::to_owned));
        }
        for folder in folders {
            File::open(folder)?.sync_all()?;
        }
        let path = self.folder.join(HEADS).join(format!("{}-{}", agent.uuid, agent.epoch));
        let temporary = path.with_extension("tmp");
        let mut file = File::create(&temporary)?;
        let party = head.party.map_or(String::new(), |party| format!(" {party}"));
        writeln!(file, "{} {}{party}", head.manifest, if head.own { OWN } else { "told" })?;
        file.sync_all()?;
        fs::rename(&temporary, &path)?;
        File::open(self.folder.join(HEADS))?.sync_all()?;
        locked(&self.state).heads.insert(agent, head);
        Ok(())
    }

    fn remove(&self, objects: &BTreeSet<ObjectHash>) {
        objects.iter().for_each(|hash| self.forget(hash));
    }
}

/// What is within; every section leaves it whole.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    const AGENT: Identity = Identity { uuid: Uuid::from_u128(7), epoch: 2 };

    fn manifest() -> Vec<u8> {
        Manifest { agent: AGENT, begun: 1, revision: 1, finished: false, pages: Vec::new() }.to_bytes()
    }

    #[test]
    fn what_a_folder_was_given_is_there_when_it_is_opened_again() {
        let room = tempfile::tempdir().unwrap();
        let (bytes, list) = (vec![5; 9000], manifest());
        let (hash, head) = (ObjectHash::of(&bytes), ObjectHash::of(&list));
        {
            let store = FolderStore::open(room.path()).unwrap();
            store.put(&hash, &bytes).unwrap();
            store.put(&head, &list).unwrap();
            store.set_head(AGENT, Head { manifest: head, own: true, party: Some(AGENT.uuid) }).unwrap();
            assert!(FolderStore::open(room.path()).is_err(), "another one keeps out");
        }
        // What a killed program leaves.
        fs::write(store_path(room.path(), &hash).with_extension("tmp"), b"half").unwrap();
        let store = FolderStore::open(room.path()).unwrap();
        assert_eq!(store.get(&hash).unwrap(), bytes);
        assert_eq!(store.part(&hash, 8000, 4096).unwrap(), bytes[8000..]);
        assert_eq!(
            store.heads(),
            [(AGENT, Head { manifest: head, own: true, party: Some(AGENT.uuid) })].into()
        );
        store.remove(&[hash].into());
        assert!(!store.has(&hash) && store.has(&head) && store.get(&hash).is_none());
    }

    #[test]
    fn a_damaged_object_is_not_there() {
        let room = tempfile::tempdir().unwrap();
        let bytes = vec![5; 9000];
        let hash = ObjectHash::of(&bytes);
        let store = FolderStore::open(room.path()).unwrap();
        store.put(&hash, &bytes).unwrap();
        let mut damaged = bytes.clone();
        damaged[77] ^= 1;
        fs::write(store_path(room.path(), &hash), damaged).unwrap();
        assert!(store.has(&hash) && store.get(&hash).is_none() && !store.has(&hash));
        store.put(&hash, &bytes).unwrap();
        assert_eq!(store.get(&hash).unwrap(), bytes);
    }

    fn store_path(folder: &Path, hash: &ObjectHash) -> PathBuf {
        let name = hash.to_string();
        folder.join(OBJECTS).join(&name[..2]).join(name)
    }
}
