//! What a station has in common with a store: the maps of runs that have ended and the verdicts on their pairs go there, and verdicts that
//! workers found come from there into the station's own folder. All of that is done in a thread beside, so that a store that is slow or
//! gone holds nobody up: the station judges its pairs as without one, and takes those that are judged elsewhere.

use super::Store;
use crate::blobs::{Blobs, FolderBlobs};
use crate::merging::verdicts::is_camera_verdict;
use crate::verdicts::{MapDigest, VerdictKey};
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often it is looked for verdicts that others found.
const LOOK: Duration = Duration::from_secs(1);
/// How long it is rested after the store could not be used.
const RETRY: Duration = Duration::from_secs(5);

/// A thread that exchanges maps and verdicts with a store.
pub(crate) struct Sharing {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changes: Condvar,
}

/// What the thread and the station tell each other.
#[derive(Default)]
struct State {
    /// Maps that are to be put, the first one first.
    maps: Vec<PathBuf>,
    /// Those that were ever to be.
    offered: BTreeSet<MapDigest>,
    /// The verdicts that are wanted, and how often that was said.
    wanted: Vec<VerdictKey>,
    asked: u64,
    /// What was wanted when all that was there had come.
    answered: u64,
    /// Whether verdicts came that nobody has taken up.
    has_come: bool,
    /// Whether it ends once all is put.
    ends: bool,
    /// Whether all is put.
    is_put: bool,
    /// Whether it ends now.
    leaves: bool,
}

impl Sharing {
    /// With this store; verdicts are taken from `verdicts` and brought there. `warn` is told what goes wrong.
    ///
    /// # Errors
    /// When the store or the folder cannot be used, or a thread not be started.
    pub fn start(store: Store, verdicts: &Path, warn: impl Fn(&str) + Send + 'static) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let exchange = Exchange {
            store,
            here: FolderBlobs::at(verdicts)?,
            known: BTreeSet::new(),
            refused: BTreeSet::new(),
            shared: Arc::clone(&shared),
        };
        let work = move || exchange.until_the_end(&warn);
        let thread = std::thread::Builder::new().name("fleet-store".into()).spawn(work);
        Ok(Self { shared, thread: Some(thread.context("cannot start a thread")?) })
    }

    /// Has these maps put, each once.
    pub fn offer<'a>(&self, maps: impl Iterator<Item = (&'a Path, &'a MapDigest)>) {
        let mut state = self.shared.state();
        for (path, digest) in maps {
            if state.offered.insert(digest.clone()) {
                state.maps.push(path.to_owned());
                self.shared.changes.notify_all();
            }
        }
    }

    /// Has these verdicts brought whenever they are there, in place of those that were wanted before, and waits until those that are there
    /// now have come, no longer than `patience`.
    pub fn want(&self, verdicts: Vec<VerdictKey>, patience: Duration) {
        let mut state = self.shared.state();
        state.wanted = verdicts;
        state.asked += 1;
        self.shared.changes.notify_all();
        let asked = state.asked;
        let lacks = |state: &mut State| state.answered < asked && !state.ends;
        // What comes later is taken up later.
        drop(self.shared.changes.wait_timeout_while(state, patience, lacks));
    }

    /// Whether verdicts came since it was asked last.
    pub fn take_come(&self) -> bool {
        std::mem::take(&mut self.shared.state().has_come)
    }

    /// Whether verdicts came that nobody has taken up.
    pub fn has_come(&self) -> bool {
        self.shared.state().has_come
    }

    /// Puts what is left, for no longer than `patience`, and ends. Whether all is there.
    pub fn finish(&mut self, patience: Duration) -> bool {
        let mut state = self.shared.state();
        (state.ends, state.is_put) = (true, false);
        self.shared.changes.notify_all();
        let waited = self.shared.changes.wait_timeout_while(state, patience, |state| !state.is_put);
        let is_put = waited.unwrap_or_else(PoisonError::into_inner).0.is_put;
        if let Some(thread) = self.thread.take().filter(|_| is_put) {
            // It has put all.
            let _ = thread.join();
        }
        is_put
    }
}

impl Drop for Sharing {
    fn drop(&mut self) {
        self.shared.state().leaves = true;
        self.shared.changes.notify_all();
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        // Every section leaves it whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What the thread works with.
struct Exchange {
    store: Store,
    /// The station's verdicts.
    here: FolderBlobs,
    /// Verdicts that are known to be in the store.
    known: BTreeSet<String>,
    /// Objects that are no verdicts, which was told.
    refused: BTreeSet<String>,
    shared: Arc<Shared>,
}

impl Exchange {
    fn until_the_end(mut self, warn: &dyn Fn(&str)) {
        let mut trouble = String::new();
        loop {
            let State { ends, leaves, .. } = *self.shared.state();
            if leaves {
                return;
            }
            let rest = match self.exchange(warn) {
                Ok(()) => {
                    trouble.clear();
                    LOOK
                }
                Err(error) => {
                    let text = crate::explained(&error);
                    if std::mem::replace(&mut trouble, text.clone()) != text {
                        warn(&format!(
                            "{text}\nthe store is tried again; all pairs are judged here meanwhile"
                        ));
                    }
                    RETRY
                }
            };
            let mut state = self.shared.state();
            if ends && trouble.is_empty() && state.maps.is_empty() {
                state.is_put = true;
                self.shared.changes.notify_all();
                return;
            }
            let (asked, is_well) = (state.asked, trouble.is_empty());
            let is_idle = |state: &mut State| {
                let has_news = state.asked != asked || state.ends != ends || !state.maps.is_empty();
                !(state.leaves || is_well && has_news)
            };
            drop(self.shared.changes.wait_timeout_while(state, rest, is_idle));
        }
    }

    /// Brings what is wanted, then puts what lacks there: a map at a time, so that what is wanted does not wait for all of them.
    ///
    /// # Errors
    /// When the store cannot be used, or the folder of verdicts.
    fn exchange(&mut self, warn: &dyn Fn(&str)) -> Result<()> {
        let (wanted, asked) = {
            let state = self.shared.state();
            (state.wanted.clone(), state.asked)
        };
        let mut here: BTreeSet<String> = self.here.list("")?.into_iter().collect();
        let is_lacking = wanted.iter().any(|key| !here.contains(&key.object()));
        if is_lacking || here.iter().any(|name| !self.known.contains(name)) {
            self.known = self.store.verdicts()?;
        }
        for key in &wanted {
            let name = key.object();
            if self.known.contains(&name) && !self.refused.contains(&name) && here.insert(name.clone()) {
                self.bring(key, &name, warn)?;
            }
        }
        {
            let mut state = self.shared.state();
            state.answered = asked;
            self.shared.changes.notify_all();
        }
        for name in self.here.list("")? {
            if !self.known.contains(&name)
                && let Some(bytes) = self.here.get(&name)?
            {
                self.store.put_verdict(&name, &bytes)?;
                self.known.insert(name);
            }
        }
        let first = self.shared.state().maps.first().cloned();
        if let Some(map) = first {
            self.store.put_map(&map)?;
            self.shared.state().maps.remove(0);
        }
        Ok(())
    }

    /// Brings a verdict.
    fn bring(&mut self, key: &VerdictKey, name: &str, warn: &dyn Fn(&str)) -> Result<()> {
        let Some(bytes) = self.store.verdict(name)? else { return Ok(()) };
        if is_camera_verdict(key, &bytes) {
            self.here.put(name, &bytes)?;
            self.shared.state().has_come = true;
        } else {
            self.refused.insert(name.to_owned());
            let address = self.store.blobs.address(&format!("{}{name}", super::VERDICTS));
            warn(&format!("{address}: is no verdict on these maps; delete it, and it is found again"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merging::MergingParams;
    use crate::merging::verdicts::camera_key;
    use std::fs;
    use std::sync::mpsc::{Receiver, channel};
    use std::time::Instant;

    const PATIENCE: Duration = Duration::from_secs(60);

    struct Room {
        folder: tempfile::TempDir,
        warnings: Receiver<String>,
        sharing: Sharing,
    }

    impl Room {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let (tell, warnings) = channel();
            let store = Store::at(&folder.path().join("store")).unwrap();
            let warn = move |text: &str| drop(tell.send(text.to_owned()));
            let sharing = Sharing::start(store, &folder.path().join("here"), warn).unwrap();
            Self { folder, warnings, sharing }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        /// A file that is taken for a map.
        fn map(&self, name: &str) -> (PathBuf, MapDigest) {
            fs::write(self.path(name), name).unwrap();
            (self.path(name), MapDigest::of(&self.path(name)).unwrap())
        }

        fn key(&self, maps: [&str; 2]) -> VerdictKey {
            let [a, b] = maps.map(|name| self.map(name).1);
            camera_key([&a, &b], &MergingParams::default())
        }
    }

    fn write(file: PathBuf, bytes: &[u8]) {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, bytes).unwrap();
    }

    #[test]
    fn maps_and_verdicts_go_there_and_what_is_wanted_comes() {
        let mut room = Room::new();
        let [wanted, own, other, odd] =
            [["a", "b"], ["a", "c"], ["c", "d"], ["b", "c"]].map(|maps| room.key(maps));
        let sound = crate::merging::verdicts::refused_camera_verdict(&wanted);
        let [there, here] = [room.path("store/verdicts"), room.path("here")];
        let there = |key: &VerdictKey| there.join(key.object());
        let here = |key: &VerdictKey| here.join(key.object());
        write(there(&wanted), &sound);
        write(there(&other), &sound);
        write(there(&odd), &sound);
        write(here(&own), b"own");
        room.sharing.want(vec![wanted.clone(), own.clone(), odd.clone()], PATIENCE);
        assert_eq!(fs::read(here(&wanted)).unwrap(), sound);
        assert!(room.sharing.has_come() && room.sharing.take_come() && !room.sharing.has_come());
        assert!(!here(&other).exists(), "nobody wants it");
        // What is on other maps than its name says is not taken.
        let said = room.warnings.recv_timeout(PATIENCE).unwrap();
        assert!(!here(&odd).exists() && said.contains(&odd.object()) && said.contains("delete it"), "{said}");
        let (path, digest) = room.map("a");
        room.sharing.offer([(&*path, &digest), (&*path, &digest)].into_iter());
        assert!(room.sharing.finish(PATIENCE));
        assert_eq!(fs::read(there(&own)).unwrap(), b"own");
        let maps: Vec<_> =
            fs::read_dir(room.path("store/maps")).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(maps, [format!("{}.mcap", digest.as_str()).as_str()]);
    }

    #[test]
    fn a_store_that_fails_is_reported_and_retried_and_holds_nobody_up() {
        let mut room = Room::new();
        let key = room.key(["a", "b"]);
        write(room.path("store/verdicts"), b"in the way");
        let begun = Instant::now();
        room.sharing.want(vec![key.clone()], Duration::from_millis(50));
        assert!(begun.elapsed() < PATIENCE / 2);
        let said = room.warnings.recv_timeout(PATIENCE).unwrap();
        assert!(said.contains("verdicts") && said.contains("judged here meanwhile"), "{said}");
        write(room.path("here").join(key.object()), b"own");
        assert!(!room.sharing.finish(Duration::from_millis(50)));
        fs::remove_file(room.path("store/verdicts")).unwrap();
        assert!(room.sharing.finish(PATIENCE));
        assert!(room.path("store/verdicts").join(key.object()).is_file());
    }
}
