//! What one thread leaves for another. The first goes on at once; the second takes all that was left when it gets to it.

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Where it is left.
#[derive(Default)]
pub struct Slot<T> {
    pending: Mutex<Pending<T>>,
    left: Condvar,
}

#[derive(Default)]
struct Pending<T> {
    content: T,
    /// Whether something was left since the last time it was taken.
    is_fresh: bool,
}

impl<T: Default> Slot<T> {
    /// Leaves something and wakes the thread that waits for it.
    pub fn leave(&self, change: impl FnOnce(&mut T)) {
        // A panic elsewhere does not spoil what is pending: every section leaves it whole.
        let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut pending.content);
        pending.is_fresh = true;
        drop(pending);
        self.left.notify_one();
    }

    /// Takes what was left; waits for it, at most so long.
    pub fn take(&self, patience: Duration) -> T {
        self.take_by(patience, std::mem::take)
    }

    /// Takes what was left by `take`, which may leave a part of it; waits for it, at most so long.
    pub fn take_by(&self, patience: Duration, take: impl FnOnce(&mut T) -> T) -> T {
        let pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.left.wait_timeout_while(pending, patience, |pending| !pending.is_fresh);
        let mut pending = waited.unwrap_or_else(PoisonError::into_inner).0;
        pending.is_fresh = false;
        take(&mut pending.content)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_taken_once() {
        let slot = Slot::<u32>::default();
        slot.leave(|count| *count += 1);
        slot.leave(|count| *count += 1);
        assert_eq!(slot.take(Duration::ZERO), 2);
        assert_eq!(slot.take(Duration::ZERO), 0);
    }
}
