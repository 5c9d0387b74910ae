//! Peers that have keys and say all that they may, as fast as they can.

use anyhow::Result;
use fleet::hash::ObjectHash;
use fleet::keys::Keys;
use fleet::node::Event;
use fleet::transport::tcp::Tcp;
use fleet::transport::{Endpoint, Transport};
use fleet::wire::{MAX_PART, Message, ResultsRef, Role, VERSIONS};
use map::{Identity, Uuid};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What is said of oneself, and how often: a neighbour that says it less is silent.
const BEAT: Duration = Duration::from_secs(1);
/// Of pushes, which a station bounds at 200 a second, and of all else, a millisecond.
const PUSHES: Duration = Duration::from_micros(5200);
const AT_ONCE: usize = 64;

#[derive(Default)]
struct Counts {
    sent: AtomicU64,
    opened: AtomicU64,
    closed: AtomicU64,
    ends: AtomicBool,
}

/// Peers that flood a station until this ends.
pub struct Flood {
    counts: Arc<Counts>,
    threads: Vec<JoinHandle<()>>,
}

impl Flood {
    /// So many of them; `keys` makes those of a name.
    pub fn start(count: usize, station: &Endpoint, keys: impl Fn(&str) -> Result<PathBuf>) -> Result<Self> {
        let counts = Arc::<Counts>::default();
        let mut threads = Vec::new();
        for number in 0..count {
            let own = Keys::open(&keys(&format!("hostile-{number}"))?)?;
            let (sender, events) = channel();
            let tcp = Tcp::start(None, std::slice::from_ref(station), Some(&own), sender)?;
            let of_thread = Arc::clone(&counts);
            threads.push(std::thread::spawn(move || say_all(&tcp, &events, number as u128, &of_thread)));
        }
        Ok(Self { counts, threads })
    }

    /// Ends it; what was said.
    pub fn end(self) -> String {
        self.counts.ends.store(true, Ordering::Relaxed);
        for thread in self.threads {
            // One that broke down says no more.
            let _ = thread.join();
        }
        let [sent, opened, closed] = [&self.counts.sent, &self.counts.opened, &self.counts.closed]
            .map(|count| count.load(Ordering::Relaxed));
        format!("{sent} messages sent, {opened} links opened and {closed} closed")
    }
}

/// Says all that a peer may, on whatever link there is.
fn say_all(tcp: &Tcp, events: &Receiver<Event>, peer: u128, counts: &Counts) {
    let (mut link, mut number, mut beat, mut pushed) = (None, 0, None::<Instant>, Instant::now());
    while !counts.ends.load(Ordering::Relaxed) {
        let pause = if link.is_some() { Duration::from_millis(1) } else { Duration::from_millis(50) };
        for event in events.recv_timeout(pause).into_iter().chain(events.try_iter()) {
            match event {
                Event::Up { link: new, .. } => {
                    (link, beat) = (Some(new), None);
                    counts.opened.fetch_add(1, Ordering::Relaxed);
                }
                Event::Down { .. } => {
                    link = None;
                    counts.closed.fetch_add(1, Ordering::Relaxed);
                }
                Event::Received { link, bytes } => tcp.looked_at(link, bytes.len()),
                _ => {}
            }
        }
        let Some(link) = link else { continue };
        let mut messages = Vec::new();
        if beat.is_none_or(|beat| beat.elapsed() >= BEAT) {
            beat = Some(Instant::now());
            messages.push(greeting(peer, number));
        }
        if pushed.elapsed() >= PUSHES {
            pushed = Instant::now();
            let agent = Identity { uuid: Uuid::from_u128(number << 32 | peer), epoch: 0 };
            messages.push(Message::Stored { agent, begun: 1, revision: number as u64, missing: 1 });
        }
        for _ in 0..AT_ONCE {
            number += 1;
            let hash = ObjectHash::of(&number.to_le_bytes());
            messages.push(match number % 4 {
                0 => Message::Part { hash, offset: 0, bytes: vec![7; MAX_PART / 8] },
                _ => Message::Get { hash, offset: 0, length: MAX_PART as u32 },
            });
        }
        counts.sent.fetch_add(messages.len() as u64, Ordering::Relaxed);
        messages.iter().for_each(|message| tcp.send(link, message.priority(), message.to_bytes()));
    }
}

/// Who it says that it is, with findings that it never gives.
fn greeting(peer: u128, number: u128) -> Message {
    let hash = ObjectHash::of(&number.to_le_bytes());
    let results = Some(ResultsRef { revision: number as u64, size: 1 << 20, hash });
    Message::Hello {
        version: VERSIONS[0],
        node: Uuid::from_u128(peer),
        role: Role::Agent,
        name: "hostile".into(),
        results,
    }
}
