//! Keeps what is kept within the disk's budget, and recordings in files of a fair size: a thread beside the sessions.

use super::config::AgentConfig;
use super::room::{Plan, Room, plan};
use super::sessions::{Session, Sessions};
use super::vitals::{Vitals, Why};
use crate::swapping::free_bytes;
use crate::{Level, SwapFiles};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often it looks.
const INTERVAL: Duration = Duration::from_secs(2);
/// How soon it ends.
const LOOK: Duration = Duration::from_millis(20);
const MIB: u64 = 1 << 20;
const MAP: &str = "map.mcap";
/// What it is called until all of the map that it goes on in is there.
const LIVE_MAP: &str = "map.mcap.tmp";

/// Whoever keeps house.
pub struct Housekeeping {
    sessions: Arc<Sessions>,
    vitals: Arc<Vitals>,
    out: PathBuf,
    limit: u64,
    spare: u64,
    records: bool,
    file_bytes: u64,
    /// The folders in use: that of the session which runs, and that whose map it goes on in.
    in_use: Mutex<Vec<PathBuf>>,
    /// Where the session that runs keeps what is too much for memory.
    swap: Mutex<Weak<SwapFiles>>,
}

/// The thread; it ends when this is dropped.
pub struct Keeper {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Housekeeping {
    /// Keeps house for an agent.
    pub fn new(config: &AgentConfig, sessions: &Arc<Sessions>, vitals: &Arc<Vitals>) -> Arc<Self> {
        let limit = config.limits.disk_mib.saturating_mul(MIB);
        vitals.now().beat.disk_limit_bytes = limit;
        Arc::new(Self {
            sessions: Arc::clone(sessions),
            vitals: Arc::clone(vitals),
            out: config.out.clone(),
            limit,
            spare: config.limits.free_mib.saturating_mul(MIB),
            records: config.record.enabled,
            file_bytes: config.record.file_mib.saturating_mul(MIB),
            in_use: Mutex::default(),
            swap: Mutex::default(),
        })
    }

    /// Says which folders are in use from now on: that of the session first. That whose map it goes on in is in use until the
    /// session's own file holds all of it.
    pub fn use_only(&self, folders: impl IntoIterator<Item = PathBuf>) {
        *self.in_use.lock().unwrap_or_else(PoisonError::into_inner) = folders.into_iter().collect();
    }

    /// Where a session keeps keyframes that are too many for memory: it counts as what is kept.
    pub fn swap_for(&self, session: &Session) -> Arc<SwapFiles> {
        let swap = Arc::new(SwapFiles::new(session.folder.clone()));
        *self.swap.lock().unwrap_or_else(PoisonError::into_inner) = Arc::downgrade(&swap);
        swap
    }

    fn swapped(&self) -> u64 {
        let swap = self.swap.lock().unwrap_or_else(PoisonError::into_inner).upgrade();
        swap.map_or(0, |swap| swap.on_disk())
    }

    /// Makes room once, and says what there is.
    pub fn make_room(&self) {
        // Held to the end: a session that begins meanwhile makes its folder after this.
        let used = self.in_use.lock().unwrap_or_else(PoisonError::into_inner);
        let mut in_use = used.clone();
        let is_placed = in_use.first().is_some_and(|folder| folder.join(MAP).is_file());
        // What the live map lacks is at most the map that it goes on in: room for that is made before it is written.
        let lacking = match &in_use[..] {
            [own, before] if !is_placed => {
                bytes_of(&before.join(MAP)).saturating_sub(bytes_of(&own.join(LIVE_MAP)))
            }
            _ => 0,
        };
        if is_placed {
            in_use.truncate(1);
        }
        let recorded = self.vitals.now().button.as_ref().and_then(|button| button.path());
        let stays =
            |path: &Path| in_use.iter().any(|folder| folder == path) || recorded.as_deref() == Some(path);
        let others = self.sessions.other_bytes() + self.swapped();
        let room = Room {
            limit: self.limit.saturating_sub(others + lacking),
            free: free_bytes(&self.out),
            spare: self.spare + lacking,
        };
        let Plan { delete, kept, is_over, is_short } = plan(&self.sessions.kept(&stays), room);
        delete.iter().for_each(|path| self.delete(path));
        self.sessions.remove_empty(&stays);
        let free = free_bytes(&self.out);
        let mib = |bytes: u64| bytes / MIB;
        let trouble = if is_over {
            let (kept, limit) = (mib(kept + others), mib(self.limit));
            Some(format!("{kept} MiB are in use on the disk, limits.disk_mib allows {limit}"))
        } else if is_short {
            let (free, spare) = (mib(free.unwrap_or_default()), mib(self.spare));
            Some(format!(
                "{free} MiB are free on the disk, limits.free_mib asks for {spare}, and there is nothing to delete"
            ))
        } else {
            None
        };
        let is_recording = self.is_recording();
        {
            let mut now = self.vitals.now();
            (now.beat.disk_bytes, now.beat.free_bytes) = (kept + others, free);
            now.disk_trouble = trouble;
        }
        self.record(self.records && !is_over && !is_short);
        if is_over && is_placed && !is_recording {
            // Nothing but the map is left.
            self.vitals.end_session(Why::Disk);
        }
    }

    /// Deletes a folder or file for room, and says so.
    fn delete(&self, path: &Path) {
        let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        match removed {
            Ok(()) => {
                let text = format!("{}: deleted for room on the disk", path.display());
                self.vitals.report(Level::Info, &text);
            }
            Err(error) => self.vitals.trouble(&format!("{}: cannot be deleted: {error}", path.display())),
        }
    }

    fn is_recording(&self) -> bool {
        self.vitals.now().button.as_ref().is_some_and(|button| button.is_on())
    }

    /// Records, or does not; a file that is large enough is ended, and so is one that could not be written on.
    fn record(&self, wanted: bool) {
        let Some(mut button) = self.vitals.now().button.clone() else { return };
        let bytes = button.path().and_then(|path| fs::metadata(path).ok()).map_or(0, |about| about.len());
        if button.is_on() && (!wanted || bytes >= self.file_bytes || button.has_failed()) {
            match button.set(false) {
                Ok(text) => self.vitals.report(Level::Info, &text),
                Err(error) => self.vitals.trouble(&crate::explained(&error)),
            }
        }
        if wanted && !button.is_on() {
            match button.set(true) {
                Ok(text) => self.vitals.report(Level::Info, &text),
                Err(error) => self.vitals.trouble(&crate::explained(&error)),
            }
        }
    }

    /// Starts the thread that does it again and again.
    ///
    /// # Errors
    /// When the system refuses a thread.
    pub fn start(self: &Arc<Self>) -> std::io::Result<Keeper> {
        let ends = Arc::new(AtomicBool::new(false));
        let (own, ended) = (Arc::clone(self), Arc::clone(&ends));
        let work = move || {
            while !ended.load(Ordering::Acquire) {
                own.make_room();
                let began = Instant::now();
                while began.elapsed() < INTERVAL && !ended.load(Ordering::Acquire) {
                    std::thread::sleep(LOOK);
                }
            }
        };
        let thread = std::thread::Builder::new().name("housekeeping".into()).spawn(work)?;
        Ok(Keeper { ends, thread: Some(thread) })
    }
}

fn bytes_of(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |about| about.len())
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic of it was printed by itself.
            let _ = thread.join();
        }
    }
}
