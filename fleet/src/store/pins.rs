//! Who reads objects that may be needed no more meanwhile.

use super::locked;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

/// Counts readers: what is not needed any more is removed once those who read when that was found have ended.
#[derive(Default)]
pub struct Pins(Arc<Mutex<Readers>>);

#[derive(Default)]
struct Readers {
    next: u64,
    reading: BTreeSet<u64>,
}

/// Keeps what is there while it is held.
#[must_use = "what is there is kept only while this is held"]
pub struct Pin(u64, Arc<Mutex<Readers>>);

impl Pins {
    /// Keeps what is there.
    pub fn pin(&self) -> Pin {
        let mut readers = locked(&self.0);
        let number = readers.next;
        readers.next += 1;
        readers.reading.insert(number);
        Pin(number, Arc::clone(&self.0))
    }

    /// Stands for all who read by now.
    pub fn now(&self) -> u64 {
        locked(&self.0).next
    }

    /// Whether all who read at a moment have ended.
    pub fn have_ended(&self, moment: u64) -> bool {
        locked(&self.0).reading.first().is_none_or(|oldest| *oldest >= moment)
    }
}

impl Drop for Pin {
    fn drop(&mut self) {
        locked(&self.1).reading.remove(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_begins_to_read_later_keeps_nothing_that_was_not_needed_before() {
        let pins = Pins::default();
        assert!(pins.have_ended(pins.now()));
        let first = pins.pin();
        let moment = pins.now();
        let second = pins.pin();
        assert!(!pins.have_ended(moment));
        drop(first);
        assert!(pins.have_ended(moment) && !pins.have_ended(pins.now()));
        drop(second);
        assert!(pins.have_ended(pins.now()));
    }
}
