//! What a run knows, published to ROS 2 while it goes on: poses, points and frames, as the crate `ros2` encodes them.
//!
//! `following` is told by the run, which never waits: what is new of the map waits in one place, which is no larger than the
//! map, and of poses the newest. `saying` makes messages of it in a thread that gives way to all others.
//! `common` is what a station knows of several agents.

mod common;
mod following;
mod saying;
#[cfg(test)]
mod tests;

pub use common::Common;
pub use following::Follower;
pub use saying::Published;

use crate::run::lower_priority;
use anyhow::{Context, Result};
use following::Slot;
use ros2::Outlet;
use saying::Sayer;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

/// How long the thread waits for news before it looks whether there is something to say again.
const PATIENCE: Duration = Duration::from_millis(500);

/// A run that is being published.
pub struct Publishing {
    slot: Arc<Slot>,
    thread: JoinHandle<Published>,
}

impl Publishing {
    /// Begins to publish on `outlet` what the follower is told; the run is given the follower.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn start(mut outlet: impl Outlet + 'static) -> Result<(Follower, Self)> {
        let slot = Arc::new(Slot::default());
        let of_thread = Arc::clone(&slot);
        let work = move || {
            lower_priority();
            let mut sayer = Sayer::default();
            loop {
                let news = of_thread.take(PATIENCE);
                let ended = news.ended;
                sayer.say(news, &mut outlet);
                if ended {
                    return sayer.published();
                }
            }
        };
        let thread = std::thread::Builder::new().name("ros2".into()).spawn(work);
        let thread = thread.context("cannot start a thread")?;
        Ok((Follower::new(Arc::clone(&slot)), Self { slot, thread }))
    }

    /// Publishes what is left, and ends. What was published.
    ///
    /// # Errors
    /// When the thread broke down.
    pub fn finish(self) -> Result<Published> {
        self.slot.leave(|news| news.ended = true);
        self.thread
            .join()
            .map_err(|_| anyhow::anyhow!("internal error in publishing to ROS 2, please report it"))
    }
}
