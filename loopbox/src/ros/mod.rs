//! What a run knows, published to ROS 2 while it goes on: poses, points and frames, as the crate `ros2` encodes them.
//!
//! `following` is told by the run, which never waits: what is new of the map waits in one place, which is no larger than the
//! map, and of poses the newest; `health` is how the tracking goes. `publisher` makes messages of it in a thread that gives way to all others.
//! `common` is what a station knows of several agents.

mod common;
mod following;
mod health;
mod publisher;
#[cfg(test)]
mod tests;

pub use common::Common;
pub use following::Follower;
pub use publisher::Published;

use crate::describing::lower_priority;
use anyhow::{Context, Result};
use following::Pending;
use publisher::RunPublisher;
use ros2::Outlet;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use view::slot::Slot;

/// How long the thread waits for something new before it looks whether something is to be published again.
const PATIENCE: Duration = Duration::from_millis(500);

/// A run that is being published.
pub struct Publishing {
    slot: Arc<Slot<Pending>>,
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
            let mut publisher = RunPublisher::default();
            loop {
                let pending = of_thread.take_by(PATIENCE, Pending::taken);
                let ended = pending.ended;
                publisher.publish(pending, &mut outlet);
                if ended {
                    return publisher.published();
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
        self.slot.leave(|pending| pending.ended = true);
        self.thread
            .join()
            .map_err(|_| anyhow::anyhow!("internal error in publishing to ROS 2, please report it"))
    }
}
