//! The user's request to stop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often a waiting source is told of the wish to stop.
const INTERVAL: Duration = Duration::from_millis(20);

/// The user's request to stop; all clones are one.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Requests it, and returns whether it was requested before.
    pub fn request(&self) -> bool {
        self.0.swap(true, Ordering::Relaxed)
    }

    /// Whether it was requested.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Does `work`; meanwhile the request also ends a source's own waiting, through its `stopper`.
    pub fn while_waiting<T>(&self, stopper: Option<Arc<AtomicBool>>, work: impl FnOnce() -> T) -> T {
        let Some(stopper) = stopper else { return work() };
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    stopper.fetch_or(self.requested(), Ordering::Relaxed);
                    std::thread::sleep(INTERVAL);
                }
            });
            let result = work();
            done.store(true, Ordering::Relaxed);
            result
        })
    }
}
