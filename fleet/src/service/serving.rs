//! Reads what neighbours ask for, one part of each in turn: who asks for much waits longer, and nobody else does.

use crate::hash::ObjectHash;
use crate::node::{LinkId, part_of};
use crate::store::{Objects, Store};
use crate::transport::Transport;
use crate::wire::Message;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Parts that a neighbour may have asked for and not got: as many of the smallest as it asks for at once. Those beyond are
/// forgotten, and asked for again.
const MOST: usize = 1024;
/// Bytes of objects that are kept in memory, the last that were asked for: of each is asked part by part.
const KEPT: usize = 32 << 20;

/// A part: of which object, from which byte, and how many.
type Part = (ObjectHash, u32, u32);

/// The thread that reads.
pub(super) struct Serving {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    asked: Mutex<Asked>,
    changed: Condvar,
}

#[derive(Default)]
struct Asked {
    parts: BTreeMap<LinkId, VecDeque<Part>>,
    /// Whose turn was last.
    last: LinkId,
    ends: bool,
}

impl Serving {
    pub fn start(store: Arc<dyn Store>, transport: Arc<dyn Transport>) -> io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let of_thread = Arc::clone(&shared);
        let work = move || {
            let mut recent = Recent::default();
            while let Some((link, (hash, offset, length))) = of_thread.next() {
                let message = match recent.get(&*store, &hash) {
                    Some(bytes) => Message::Part { hash, offset, bytes: part_of(&bytes, offset, length) },
                    None => Message::Missing { hash },
                };
                transport.send(link, message.priority(), message.to_bytes());
            }
        };
        let thread = Some(std::thread::Builder::new().name("fleet-serve".into()).spawn(work)?);
        Ok(Self { shared, thread })
    }

    /// A neighbour asks for a part.
    pub fn ask(&self, link: LinkId, part: Part) {
        self.shared.asked().push(link, part);
        self.shared.changed.notify_all();
    }

    /// A link is gone.
    pub fn forget(&self, link: LinkId) {
        self.shared.asked().parts.remove(&link);
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.shared.asked().ends = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // One that broke down reads no more.
            let _ = thread.join();
        }
    }
}

impl Shared {
    /// What is to be read next, once there is something; `None` at the end.
    fn next(&self) -> Option<(LinkId, Part)> {
        let mut asked = self.asked();
        loop {
            if asked.ends {
                return None;
            }
            if let Some(next) = asked.next() {
                return Some(next);
            }
            asked = self.changed.wait(asked).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn asked(&self) -> MutexGuard<'_, Asked> {
        // Every section leaves it whole.
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Asked {
    fn push(&mut self, link: LinkId, part: Part) {
        let parts = self.parts.entry(link).or_default();
        if parts.len() < MOST {
            parts.push_back(part);
        }
    }

    fn next(&mut self) -> Option<(LinkId, Part)> {
        let after = self.parts.range((Excluded(self.last), Unbounded)).next();
        let link = *after.or_else(|| self.parts.first_key_value())?.0;
        let parts = self.parts.get_mut(&link)?;
        let part = parts.pop_front();
        if parts.is_empty() {
            self.parts.remove(&link);
        }
        self.last = link;
        Some((link, part?))
    }
}

/// The objects that were asked for last: each is read once, and seen to be what it is called.
#[derive(Default)]
struct Recent {
    objects: VecDeque<(ObjectHash, Arc<[u8]>)>,
    bytes: usize,
}

impl Recent {
    fn get(&mut self, store: &dyn Objects, hash: &ObjectHash) -> Option<Arc<[u8]>> {
        if let Some(at) = self.objects.iter().position(|(known, _)| known == hash) {
            let known = self.objects.remove(at)?;
            self.objects.push_front(known.clone());
            return Some(known.1);
        }
        let bytes = store.get(hash)?;
        self.bytes += bytes.len();
        self.objects.push_front((*hash, Arc::clone(&bytes)));
        while self.bytes > KEPT && self.objects.len() > 1 {
            self.bytes -= self.objects.pop_back().map_or(0, |(_, bytes)| bytes.len());
        }
        Some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_asks_for_little_is_next_however_much_others_ask_for() {
        let mut asked = Asked::default();
        let part = |number: u32| (ObjectHash::of(b"it"), number, 9);
        for (link, count) in [(1, 10 * MOST as u32), (2, 2), (7, 3)] {
            (0..count).for_each(|number| asked.push(link, part(number)));
        }
        let order: Vec<(LinkId, u32)> =
            std::iter::from_fn(|| asked.next()).map(|(link, (_, offset, _))| (link, offset)).collect();
        let first = [(1, 0), (2, 0), (7, 0), (1, 1), (2, 1), (7, 1), (1, 2), (7, 2), (1, 3)];
        assert_eq!(order[..9], first);
        assert_eq!(order.len(), MOST + 5);
    }
}
