//! The bounded queue between decoding and tracking.

use super::Item;
use crate::Stop;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A bounded queue of items. Only frames count against its bound: the rest is small.
pub struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    capacity: usize,
    /// Whether a full queue forgets its frame instead of letting the producer wait.
    newest_only: bool,
    missed: AtomicU64,
}

#[derive(Default)]
struct State {
    items: VecDeque<Item>,
    dropped: u64,
    /// Indices of frames that nobody will take.
    forgotten: Vec<u64>,
    closed: bool,
}

impl State {
    fn frames(&self) -> usize {
        self.items.iter().filter(|item| matches!(item, Item::Frame(..))).count()
    }

    /// Forgets all frames; how many there were.
    fn forget_frames(&mut self) -> u64 {
        let before = self.forgotten.len();
        self.forgotten.extend(self.items.iter().filter_map(index_of));
        self.items.retain(|item| !matches!(item, Item::Frame(..)));
        (self.forgotten.len() - before) as u64
    }
}

fn index_of(item: &Item) -> Option<u64> {
    match item {
        Item::Frame(frame, _) => Some(frame.index),
        _ => None,
    }
}

impl Queue {
    /// A queue whose producer waits while `capacity` frames are in it.
    pub fn waiting(capacity: usize) -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            capacity,
            newest_only: false,
            missed: AtomicU64::new(0),
        }
    }

    /// A queue that holds the newest frame and counts those it drops for it.
    pub fn newest_only() -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            capacity: 1,
            newest_only: true,
            missed: AtomicU64::new(0),
        }
    }

    /// Adds an item; false when the queue is closed.
    pub fn push(&self, item: Item) -> bool {
        let mut state = self.lock();
        if matches!(item, Item::Frame(..)) {
            if self.newest_only && !state.closed {
                state.dropped += state.forget_frames();
            }
            while !state.closed && state.frames() >= self.capacity {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
        if state.closed {
            state.forgotten.extend(index_of(&item));
            return false;
        }
        state.items.push_back(item);
        self.changed.notify_all();
        true
    }

    /// Takes the oldest item; waits for one until the queue is closed and empty, or `stop` is set. After `patience`
    /// it is [`Item::Nothing`].
    pub fn pop(&self, stop: &Stop, patience: Duration) -> Option<Item> {
        let began = Instant::now();
        let mut state = self.lock();
        while !stop.requested() {
            if let Some(item) = state.items.pop_front() {
                self.changed.notify_all();
                return Some(item);
            }
            if state.closed {
                return None;
            }
            let left = patience.saturating_sub(began.elapsed());
            if left.is_zero() {
                return Some(Item::Nothing);
            }
            // A signal handler sets `stop` and can notify nobody.
            let waited = self.changed.wait_timeout(state, left.min(Duration::from_millis(100)));
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        None
    }

    /// Drops the frames that were not taken.
    pub fn forget_all(&self) {
        self.lock().forget_frames();
    }

    /// Indices of the frames that were forgotten since this was called last.
    pub fn take_forgotten(&self) -> Vec<u64> {
        std::mem::take(&mut self.lock().forgotten)
    }

    /// No more items are taken; those in the queue can still be popped.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Whether it was closed.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Counts a frame that was dropped on its way here.
    pub fn forget(&self, index: u64) {
        let mut state = self.lock();
        state.dropped += 1;
        state.forgotten.push(index);
    }

    /// Sets the number of frames that the source could not deliver so far.
    pub fn set_missed(&self, missed: u64) {
        self.missed.store(missed, Ordering::Relaxed);
    }

    /// Frames that the source could not deliver.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }

    /// Frames dropped for newer ones.
    pub fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every section leaves the state whole, so a panic elsewhere does not spoil it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::GrayImage;
    use slam_direct::Frame;

    const LONG: Duration = Duration::from_secs(600);

    fn frame(index: u64) -> Item {
        Item::Frame(
            Frame { index, timestamp: index as f64, image: GrayImage::filled(1, 1, 0), color: None },
            None,
        )
    }

    fn index(item: Option<Item>) -> Option<u64> {
        match item {
            Some(Item::Frame(frame, _)) => Some(frame.index),
            _ => None,
        }
    }

    #[test]
    fn a_late_consumer_gets_the_newest_frame_and_every_message() {
        let queue = Queue::newest_only();
        queue.push(frame(0));
        queue.push(Item::Warning("w".into()));
        queue.push(frame(1));
        queue.push(frame(2));
        assert!(matches!(queue.pop(&Stop::default(), LONG), Some(Item::Warning(_))));
        assert_eq!(index(queue.pop(&Stop::default(), LONG)), Some(2));
        assert_eq!(queue.dropped(), 2);
        queue.push(frame(3));
        queue.close();
        queue.push(frame(4));
        queue.forget_all();
        assert_eq!(queue.take_forgotten(), [0, 1, 4, 3]);
        assert!(queue.pop(&Stop::default(), LONG).is_none());
    }

    #[test]
    fn a_waiting_queue_keeps_all_frames_in_order_within_its_bound() {
        let queue = Queue::waiting(2);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for i in 0..50 {
                    assert!(queue.push(frame(i)));
                }
                queue.close();
            });
            for i in 0..50 {
                assert!(queue.lock().frames() <= 2);
                assert_eq!(index(queue.pop(&Stop::default(), LONG)), Some(i));
            }
            assert!(queue.pop(&Stop::default(), LONG).is_none());
        });
        assert_eq!(queue.dropped(), 0);
    }

    #[test]
    fn patience_ends_and_the_queue_continues() {
        let queue = Queue::newest_only();
        assert!(matches!(queue.pop(&Stop::default(), Duration::from_millis(1)), Some(Item::Nothing)));
        queue.push(frame(7));
        assert_eq!(index(queue.pop(&Stop::default(), Duration::ZERO)), Some(7));
        queue.close();
        assert!(queue.pop(&Stop::default(), Duration::ZERO).is_none());
    }

    #[test]
    fn closing_frees_a_waiting_producer() {
        let queue = Queue::waiting(1);
        queue.push(frame(0));
        std::thread::scope(|scope| {
            let producer = scope.spawn(|| queue.push(frame(1)));
            std::thread::sleep(Duration::from_millis(10));
            queue.close();
            assert!(!producer.join().unwrap());
        });
    }
}
