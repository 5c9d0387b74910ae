//! Watching a run: one description of what there is to see, shown by several sinks.
//!
//! The run's loop calls [`Watch`]: it leaves what is new in a slot (`feed`) and takes the user's commands. A thread
//! of low priority (`watcher`) keeps the `scene` up to date; each sink has its own thread and takes from the scene
//! what it has not seen: the page in the browser (`web`), Foxglove (`foxglove`). So no sink slows the tracker down, and
//! a slow one skips what it could not show anyway. A station has no run: what it collects is put into a scene by
//! `station`, and maps that are saved by [`saved`].

mod chunk;
mod feed;
#[cfg(feature = "foxglove-server")]
mod foxglove;
mod handle;
mod neighbourhood;
mod picture;
mod run_page;
pub mod saved;
mod scene;
mod station;
mod status;
mod watcher;
pub mod web;

pub use chunk::{Chunk, POINT_BYTES};
pub use handle::{Ended, Watch, WatchOptions};
pub use neighbourhood::{FleetCounts, Neighbour, Neighbourhood, PairLine, RemoteMap};
pub use picture::Picture;
pub use run_page::RunPage;
pub use scene::{Agent, Cursor, Placed, Scene, SceneUpdate, Step};
pub use station::{CommonMap, StationWatch};
pub use status::Status;

use crate::slot::Slot;
use feed::Pending;
use serde::Deserialize;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What the user wants of the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case", tag = "command", content = "on")]
pub enum Command {
    /// Take no more frames: a recording waits, a camera's are dropped.
    Pause,
    /// Take frames again.
    Resume,
    /// Write the results as they stand, and go on.
    Save,
    /// Write the results and begin a new map.
    Restart,
    /// Begin or end recording the frames.
    Record(bool),
}

/// What watcher and sinks share.
pub struct Shared {
    slot: Slot<Pending>,
    scene: Mutex<Scene>,
    /// Sinks that show images.
    audience: AtomicUsize,
    /// The run is over and the scene will not change any more.
    over: AtomicBool,
    commands: Option<SyncSender<Command>>,
}

impl Shared {
    /// Shares a scene; commands go to `commands`, where there is a run to obey them.
    pub fn new(scene: Scene, commands: Option<SyncSender<Command>>) -> Self {
        Self {
            slot: Slot::default(),
            scene: Mutex::new(scene),
            audience: AtomicUsize::new(0),
            over: AtomicBool::new(false),
            commands,
        }
    }

    /// The scene.
    pub fn scene(&self) -> MutexGuard<'_, Scene> {
        // Every section leaves it whole, so a panic elsewhere does not spoil it.
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the numbers of a scene that no watcher follows at the moment.
    fn change_status(&self, change: impl FnOnce(&mut Status)) {
        let mut scene = self.scene();
        let mut status = scene.status().clone();
        change(&mut status);
        scene.set_status(status);
    }

    /// Passes a command on; false when there is no run to obey it, or too many are waiting.
    pub fn command(&self, command: Command) -> bool {
        self.commands.as_ref().is_some_and(|commands| commands.try_send(command).is_ok())
    }

    /// Whether the run is over.
    pub fn is_over(&self) -> bool {
        self.over.load(Ordering::Acquire)
    }

    /// Counts a sink that shows images, as long as the guard lives.
    fn join(self: &Arc<Self>) -> Seat {
        self.audience.fetch_add(1, Ordering::Relaxed);
        Seat(Arc::clone(self))
    }
}

/// A sink's place in the audience.
struct Seat(Arc<Shared>);

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.audience.fetch_sub(1, Ordering::Relaxed);
    }
}
