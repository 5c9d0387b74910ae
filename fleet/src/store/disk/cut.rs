//! A disk in memory that forgets at a power cut what was not synced, and refuses or stands still when it is told to.

use super::Disk;
use crate::store::locked;
use std::collections::BTreeMap;
use std::io::{self, Error, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};

/// The disk; clones are the same one.
#[derive(Clone, Default)]
pub(crate) struct Cut(Arc<(Mutex<Files>, Condvar)>);

#[derive(Default)]
struct Files {
    /// Names as programs see them, and as they are on the disk.
    names: BTreeMap<PathBuf, usize>,
    synced: BTreeMap<PathBuf, usize>,
    contents: Vec<Content>,
    /// The sync that is refused, by how many come before it.
    refused: Option<usize>,
    /// Whether whatever is written waits.
    stands_still: bool,
}

#[derive(Clone, Default)]
struct Content {
    seen: Vec<u8>,
    on_disk: Vec<u8>,
    /// Whether the system remembers that it is to be written: after an error it does not (as Linux).
    is_dirty: bool,
}

impl Cut {
    /// The disk after a power cut.
    pub fn cut(&self) -> Self {
        let files = locked(&self.0.0);
        let contents = files.contents.iter().map(|content| Content {
            seen: content.on_disk.clone(),
            on_disk: content.on_disk.clone(),
            is_dirty: false,
        });
        let contents = contents.collect();
        let (names, synced) = (files.synced.clone(), files.synced.clone());
        let files = Files { names, synced, contents, ..Files::default() };
        Self(Arc::new((Mutex::new(files), Condvar::new())))
    }

    /// Has a sync refused after so many others, and what it was to bring to the disk forgotten.
    pub fn refuse_after(&self, count: usize) {
        locked(&self.0.0).refused = Some(count);
    }

    /// Has whatever is written wait, or go on.
    pub fn set_stalled(&self, stands_still: bool) {
        locked(&self.0.0).stands_still = stands_still;
        self.0.1.notify_all();
    }

    /// Changes a bit of a file.
    pub fn rot(&self, name: &str) {
        let mut files = locked(&self.0.0);
        let path = files.names.keys().find(|path| path.ends_with(name)).cloned().expect("it is there");
        let content = files.names[&path];
        files.contents[content].seen[7] ^= 1;
    }

    /// The files, once they may be changed.
    fn writable(&self) -> std::sync::MutexGuard<'_, Files> {
        let files = locked(&self.0.0);
        self.0.1.wait_while(files, |files| files.stands_still).expect("no thread broke down")
    }
}

impl Disk for Cut {
    fn files(&self, folder: &Path) -> io::Result<Vec<(PathBuf, u64)>> {
        let files = locked(&self.0.0);
        let within = files.names.iter().filter(|(path, _)| path.starts_with(folder));
        Ok(within.map(|(path, at)| (path.clone(), files.contents[*at].seen.len() as u64)).collect())
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let files = locked(&self.0.0);
        let at = files.names.get(path).ok_or(ErrorKind::NotFound)?;
        Ok(files.contents[*at].seen.clone())
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let mut files = self.writable();
        let next = files.contents.len();
        let at = *files.names.entry(path.to_owned()).or_insert(next);
        files.contents.resize_with(next.max(at + 1), Content::default);
        (files.contents[at].seen, files.contents[at].is_dirty) = (bytes.to_vec(), true);
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut files = self.writable();
        let at = files.names.remove(from).ok_or(ErrorKind::NotFound)?;
        files.names.insert(to.to_owned(), at);
        Ok(())
    }

    fn remove(&self, path: &Path) {
        self.writable().names.remove(path);
    }

    fn sync(&self, paths: &[PathBuf]) -> io::Result<()> {
        let mut files = self.writable();
        let is_refused = files.refused == Some(0);
        files.refused = files.refused.and_then(|count| count.checked_sub(1));
        for path in paths {
            if let Some(&at) = files.names.get(path) {
                let content = &mut files.contents[at];
                if std::mem::take(&mut content.is_dirty) && !is_refused {
                    content.on_disk.clone_from(&content.seen);
                }
            } else if !is_refused {
                let files = &mut *files;
                let within = |name: &PathBuf| name.parent() == Some(path);
                files.synced.retain(|name, _| !within(name));
                let names = files.names.iter().filter(|(name, _)| within(name));
                files.synced.extend(names.map(|(name, at)| (name.clone(), *at)));
            }
        }
        if is_refused { Err(Error::other("the disk does not take it")) } else { Ok(()) }
    }
}
