//! Frames of a live source: captured in a thread of their own, so that decoding never makes them wait.

use super::Decoding;
use super::queue::Queue;
use crate::{FrameSource, SourceFrame, time};
use std::sync::atomic::Ordering;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// The newest frame that waits to be decoded: one, so that memory stays bounded and nothing is old.
struct Slot<'a> {
    state: Mutex<State>,
    changed: Condvar,
    /// Where frames that nobody took are counted.
    queue: &'a Queue,
}

#[derive(Default)]
struct State {
    frame: Option<SourceFrame>,
    closed: bool,
}

impl<'a> Slot<'a> {
    fn new(queue: &'a Queue) -> Self {
        Self { state: Mutex::default(), changed: Condvar::new(), queue }
    }

    /// Puts a frame in, in place of the one that is there; false once nobody wants any.
    fn put(&self, frame: SourceFrame) -> bool {
        let mut state = self.lock();
        let forgotten = if state.closed { Some(frame) } else { state.frame.replace(frame) };
        if let Some(forgotten) = forgotten {
            self.queue.forget(forgotten.index);
        }
        self.changed.notify_all();
        !state.closed
    }

    /// Takes the frame; waits for one until the slot is closed.
    fn take(&self) -> Option<SourceFrame> {
        let mut state = self.lock();
        loop {
            if let Some(frame) = state.frame.take() {
                return Some(frame);
            }
            if state.closed {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every section leaves it whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Closes the slot however its user ends.
struct CloseOnDrop<'a>(&'a Slot<'a>);

impl Drop for CloseOnDrop<'_> {
    fn drop(&mut self) {
        self.0.lock().closed = true;
        self.0.changed.notify_all();
    }
}

/// Captures until the source ends or no more frames are wanted.
pub fn produce(source: &mut dyn FrameSource, decoding: &mut Decoding<'_>) {
    let (slot, tap) = (Slot::new(decoding.queue), decoding.tap);
    let stopper = source.stopper();
    std::thread::scope(|scope| {
        let slot = &slot;
        scope.spawn(move || {
            let _closes = CloseOnDrop(slot);
            while let Some(mut frame) = source.next_frame() {
                slot.queue.set_missed(source.missed());
                frame.timestamp = time::on_grid(frame.timestamp);
                tap.captured(&frame);
                if !slot.put(frame) {
                    return;
                }
            }
            slot.queue.set_missed(source.missed());
        });
        let _closes = CloseOnDrop(slot);
        while slot.take().is_some_and(|frame| decoding.take(frame)) {}
        if let Some(stopper) = stopper {
            stopper.store(true, Ordering::Relaxed);
        }
    });
}

#[cfg(test)]
#[path = "live_tests.rs"]
mod tests;
