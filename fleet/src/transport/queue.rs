//! What waits to be sent on a link.

use crate::wire::Priority;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most that waits, bytes: as much as a neighbour asks for at once, and some.
const LARGEST: usize = 6 << 20;
/// Most messages that wait, of the small ones.
const MOST: usize = 4096;

/// Messages to be sent, urgent ones first; those for which there is no room are dropped.
#[derive(Default)]
pub(super) struct Queue {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Default)]
struct Waiting {
    urgent: VecDeque<Vec<u8>>,
    objects: VecDeque<Vec<u8>>,
    bytes: usize,
    closing: bool,
}

impl Queue {
    /// Adds a message, unless there is no room or the link is closed.
    pub fn push(&self, priority: Priority, message: Vec<u8>) {
        let mut waiting = self.locked();
        let is_urgent = priority == Priority::State;
        let full = if is_urgent { waiting.urgent.len() >= MOST } else { waiting.bytes >= LARGEST };
        if waiting.closing || full {
            return;
        }
        if is_urgent {
            waiting.urgent.push_back(message);
        } else {
            waiting.bytes += message.len();
            waiting.objects.push_back(message);
        }
        self.changed.notify_one();
    }

    /// The next message, once there is one; `None` when the link is to be closed and nothing urgent waits.
    pub fn pop(&self) -> Option<Vec<u8>> {
        let mut waiting = self.locked();
        loop {
            if let Some(message) = waiting.urgent.pop_front() {
                return Some(message);
            }
            if waiting.closing {
                return None;
            }
            if let Some(message) = waiting.objects.pop_front() {
                waiting.bytes -= message.len();
                return Some(message);
            }
            let patience = Duration::from_secs(1);
            let waited = self.changed.wait_timeout(waiting, patience);
            waiting = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Takes no more messages.
    pub fn close(&self) {
        self.locked().closing = true;
        self.changed.notify_all();
    }

    /// Whether it is to be closed.
    pub fn is_closing(&self) -> bool {
        self.locked().closing
    }

    fn locked(&self) -> MutexGuard<'_, Waiting> {
        // Every section leaves it whole.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
