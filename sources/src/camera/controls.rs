//! Locks exposure, gain, white balance and focus at fixed values.

use super::args::Lockable;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

/// The controls of a camera.
pub trait Controls: Send + Sync {
    /// The value of a control; `None` when the camera has none such that can be set.
    ///
    /// # Errors
    /// When the device is gone.
    fn get(&self, id: u32) -> io::Result<Option<i32>>;

    /// Sets a control.
    ///
    /// # Errors
    /// When the device refuses or is gone.
    fn set(&self, id: u32, value: i32) -> io::Result<()>;
}

/// A control that moves others by itself, and those it moves. Numbers are those of `linux/v4l2-controls.h`.
struct Automatic {
    what: Lockable,
    /// The control that is to be off.
    id: u32,
    /// Its value when off.
    off: i32,
    /// What it moves when on.
    moves: &'static [u32],
}

const USER: u32 = 0x0098_0900;
const LENS: u32 = 0x009a_0900;
const GAIN: u32 = USER + 19;
const EXPOSURE_TIME: u32 = LENS + 2;

const AUTOMATICS: [Automatic; 5] = [
    // EXPOSURE_AUTO (1: manual); EXPOSURE_ABSOLUTE. Automatic exposure moves the gain of many cameras too.
    Automatic { what: Lockable::Exposure, id: LENS + 1, off: 1, moves: &[EXPOSURE_TIME, GAIN] },
    // EXPOSURE_AUTO_PRIORITY: whether the rate may sink for the exposure.
    Automatic { what: Lockable::Exposure, id: LENS + 3, off: 0, moves: &[] },
    // AUTOGAIN; GAIN.
    Automatic { what: Lockable::Gain, id: USER + 18, off: 0, moves: &[GAIN] },
    // AUTO_WHITE_BALANCE; RED_BALANCE, BLUE_BALANCE, WHITE_BALANCE_TEMPERATURE.
    Automatic {
        what: Lockable::WhiteBalance,
        id: USER + 12,
        off: 0,
        moves: &[USER + 14, USER + 15, USER + 26],
    },
    // FOCUS_AUTO; FOCUS_ABSOLUTE.
    Automatic { what: Lockable::Focus, id: LENS + 12, off: 0, moves: &[LENS + 10] },
];

/// The original and the locked values of a camera's controls. They are kept while the camera is unplugged.
#[derive(Clone, Default)]
pub struct Memory(Arc<Mutex<Remembered>>);

#[derive(Default)]
struct Remembered {
    /// What automatics were set to before.
    before: BTreeMap<u32, i32>,
    /// The controls that are locked, and their values.
    locked: BTreeMap<u32, i32>,
}

/// Locked controls; dropping it puts the automatics back as they were.
pub struct Locked {
    controls: Arc<dyn Controls>,
    /// What to put back, in this order.
    restore: Vec<(u32, i32)>,
}

/// Whether an automatic of `what` is on, so that locking would change something.
pub fn any_automatic(controls: &dyn Controls, what: &[Lockable]) -> bool {
    let on = |a: &Automatic| controls.get(a.id).ok().flatten().is_some_and(|value| value != a.off);
    AUTOMATICS.iter().any(|automatic| what.contains(&automatic.what) && on(automatic))
}

impl Memory {
    /// Whether values to lock at are known from before.
    pub fn knows_values(&self) -> bool {
        !self.lock().locked.is_empty()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Remembered> {
        // Every section leaves it whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Locked {
    /// Turns the automatics of `what` off, keeping the values they have found, or those in `memory`. Gives with it
    /// what could not be locked, for people.
    pub fn new(controls: Arc<dyn Controls>, what: &[Lockable], memory: &Memory) -> (Self, Vec<String>) {
        let (mut locked, mut complaints) = (Self { controls, restore: Vec::new() }, Vec::new());
        for &each in what {
            let automatics = AUTOMATICS.iter().filter(|automatic| automatic.what == each);
            let results: Vec<_> = automatics.map(|automatic| locked.disable(automatic, memory)).collect();
            for error in results.iter().filter_map(|result| result.as_ref().err()) {
                complaints.push(format!("the camera's {} could not be locked: {error}", each.name()));
            }
            if results.iter().all(|result| matches!(result, Ok(false))) {
                complaints.push(format!("the camera has no automatic {} to lock", each.name()));
            }
        }
        (locked, complaints)
    }

    /// False when the camera has no such automatic.
    fn disable(&mut self, automatic: &Automatic, memory: &Memory) -> io::Result<bool> {
        let Some(present) = self.controls.get(automatic.id)? else { return Ok(false) };
        let mut memory = memory.lock();
        let before = *memory.before.entry(automatic.id).or_insert(present);
        if before == automatic.off && present == automatic.off {
            return Ok(true);
        }
        let mut values = Vec::new();
        for &id in automatic.moves {
            if let Some(value) = self.controls.get(id)? {
                values.push((id, *memory.locked.entry(id).or_insert(value)));
            }
        }
        // Remembered before it is done: what follows may fail half-way.
        self.restore.push((automatic.id, before));
        self.controls.set(automatic.id, automatic.off)?;
        for (id, value) in values {
            // Some cameras list controls that another automatic still moves, and refuse to set them.
            let _ = self.controls.set(id, value);
        }
        Ok(true)
    }
}

impl Drop for Locked {
    fn drop(&mut self) {
        for &(id, value) in self.restore.iter().rev() {
            // A camera that was unplugged cannot take it, and forgets its settings anyway.
            let _ = self.controls.set(id, value);
        }
    }
}

#[cfg(test)]
#[path = "controls_tests.rs"]
mod tests;
