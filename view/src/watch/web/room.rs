//! How many are served at a time. Who may look has a seat; who has not said yet who he is waits at the door, where the newest
//! is let in before the oldest. So strangers that never end their requests keep nobody out.

use std::collections::BTreeMap;
use std::net::{IpAddr, Shutdown, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Those who may look, at a time.
const MAX_SEATED: usize = 12;
/// Connections whose request is not there yet, or is refused.
const MAX_WAITING: usize = 16;
/// Threads in all: one that is shown out needs a moment to leave.
const MAX_THREADS: usize = 64;

/// Who is here.
#[derive(Default)]
pub struct Room {
    door: Mutex<Door>,
    seated: AtomicUsize,
    threads: AtomicUsize,
}

/// Connections that wait, in the order in which they came.
#[derive(Default)]
struct Door {
    came: u64,
    waiting: BTreeMap<u64, (IpAddr, TcpStream)>,
}

impl Room {
    /// Lets a connection wait for its request to be read; `None` where there are too many to care. Where too many wait, the oldest
    /// is shown out of the address that most have come from.
    pub fn wait(self: &Arc<Self>, stream: &TcpStream) -> Option<Waiting> {
        let (from, held) = (stream.peer_addr().ok()?.ip(), stream.try_clone().ok()?);
        if self.threads.load(Ordering::Acquire) >= MAX_THREADS {
            return None;
        }
        self.threads.fetch_add(1, Ordering::AcqRel);
        let mut door = self.door();
        if door.waiting.len() >= MAX_WAITING {
            door.show_one_out();
        }
        door.came += 1;
        let number = door.came;
        door.waiting.insert(number, (from, held));
        Some(Waiting { room: Arc::clone(self), number })
    }

    /// How many may look and do.
    pub fn seated(&self) -> usize {
        self.seated.load(Ordering::Acquire)
    }

    fn door(&self) -> MutexGuard<'_, Door> {
        // Every section leaves it whole.
        self.door.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Door {
    fn show_one_out(&mut self) {
        let mut from: BTreeMap<IpAddr, (usize, u64)> = BTreeMap::new();
        for (number, (address, _)) in &self.waiting {
            from.entry(*address).or_insert((0, *number)).0 += 1;
        }
        let oldest = from.into_values().max_by_key(|(count, oldest)| (*count, u64::MAX - oldest));
        if let Some((_, stream)) = oldest.and_then(|(_, oldest)| self.waiting.remove(&oldest)) {
            // Its thread ends by that. What is closed already needs no closing.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

/// A connection that waits at the door, as long as this lives.
pub struct Waiting {
    room: Arc<Room>,
    number: u64,
}

impl Waiting {
    /// Gives a seat to one who may look, while there is one.
    pub fn sit(&self) -> Option<Seat> {
        let free = |seated: usize| (seated < MAX_SEATED).then_some(seated + 1);
        self.room.seated.fetch_update(Ordering::AcqRel, Ordering::Acquire, free).ok()?;
        self.room.door().waiting.remove(&self.number);
        Some(Seat(Arc::clone(&self.room)))
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.room.door().waiting.remove(&self.number);
        self.room.threads.fetch_sub(1, Ordering::AcqRel);
    }
}

/// A seat, taken as long as this lives.
pub struct Seat(Arc<Room>);

impl Drop for Seat {
    fn drop(&mut self) {
        self.0.seated.fetch_sub(1, Ordering::AcqRel);
    }
}
