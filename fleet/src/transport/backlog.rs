//! What came on a link and was not looked at yet: whoever sends more than that waits.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most bytes of it, and what a message counts for beside its own: what a small one costs is the time to look at it, and others' wait
/// meanwhile. So at most a thousand of one link wait, a millisecond or two.
const LARGEST: usize = 1 << 20;
const MESSAGE: usize = 1 << 10;

/// Counts it.
#[derive(Default)]
pub(super) struct Backlog {
    bytes: Mutex<usize>,
    less: Condvar,
}

impl Backlog {
    /// A message of so many bytes came.
    pub fn add(&self, bytes: usize) {
        *self.locked() += bytes + MESSAGE;
    }

    /// A message of so many bytes was looked at.
    pub fn remove(&self, bytes: usize) {
        let mut waiting = self.locked();
        *waiting = waiting.saturating_sub(bytes + MESSAGE);
        self.less.notify_one();
    }

    /// Whether there is room for more, at the latest after `patience`.
    pub fn has_room(&self, patience: Duration) -> bool {
        let waited = self.less.wait_timeout_while(self.locked(), patience, |bytes| *bytes > LARGEST);
        *waited.unwrap_or_else(PoisonError::into_inner).0 <= LARGEST
    }

    fn locked(&self) -> MutexGuard<'_, usize> {
        // Every section leaves it whole.
        self.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_small_messages_no_more_wait_than_others_can_wait_for() {
        let backlog = Backlog::default();
        let mut waiting = 0;
        while backlog.has_room(Duration::ZERO) {
            backlog.add(60);
            waiting += 1;
        }
        assert!((500..1500).contains(&waiting), "{waiting}");
        (0..waiting).for_each(|_| backlog.remove(60));
        assert!(backlog.has_room(Duration::ZERO) && *backlog.locked() == 0);
    }
}
