//! A proxy between two processes whose faults are drawn from a seed, and that carries no more than a link would. What TCP
//! carries is never lost: a lost packet shows as a pause, in which it is sent again.

use geometry::Random;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// The pause of a lost packet: the least time after which Linux sends again.
const PAUSE: Duration = Duration::from_millis(200);
/// Bytes that are carried at a time: as many as some packets hold.
const CHUNK: usize = 16 << 10;
/// Time that what is carried at a time takes at the most, where the link is slow.
const CHUNK_TIME: f64 = 0.02;

/// How a link is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Link {
    /// One packet in so many is lost; none for 0.
    pub lost: u64,
    /// Bytes a second that it carries in each direction; nothing where that is not bounded.
    pub rate: Option<f64>,
}

/// Carries what comes to where it was made for.
pub struct Proxy {
    address: String,
    state: Arc<State>,
}

struct State {
    link: Link,
    is_cut: AtomicBool,
    ends: AtomicBool,
    random: Mutex<Random>,
    carried: AtomicU64,
    opened: OnceLock<Instant>,
}

impl Proxy {
    /// To `target`, `tcp/HOST:PORT`.
    ///
    /// # Errors
    /// When the target is no such address, or no port is free.
    pub fn start(target: &str, link: Link, seed: u64) -> std::io::Result<Self> {
        let target = target.strip_prefix("tcp/").ok_or(ErrorKind::InvalidInput)?.to_owned();
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = format!("tcp/{}", listener.local_addr()?);
        let state = Arc::new(State {
            link,
            is_cut: AtomicBool::new(false),
            ends: AtomicBool::new(false),
            random: Mutex::new(Random::new(seed)),
            carried: AtomicU64::new(0),
            opened: OnceLock::new(),
        });
        let of_thread = Arc::clone(&state);
        listener.set_nonblocking(true)?;
        thread::spawn(move || {
            while !of_thread.ends.load(Ordering::Relaxed) {
                match listener.accept() {
                    Ok((near, _)) => {
                        if let Ok(far) = TcpStream::connect(&target) {
                            of_thread.opened.get_or_init(Instant::now);
                            // One that is gone at once carries nothing.
                            let _ = of_thread.carry(&near, &far).and_then(|()| of_thread.carry(&far, &near));
                        }
                    }
                    Err(_) => thread::sleep(Duration::from_millis(20)),
                }
            }
        });
        Ok(Self { address, state })
    }

    /// Where it is to be dialled.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Lets nothing through, or everything again.
    pub fn cut(&self, is_cut: bool) {
        self.state.is_cut.store(is_cut, Ordering::Relaxed);
    }

    /// When somebody was linked with the target for the first time.
    pub fn opened(&self) -> Option<Instant> {
        self.state.opened.get().copied()
    }

    /// Bytes that were carried in both directions so far.
    pub fn carried(&self) -> u64 {
        self.state.carried.load(Ordering::Relaxed)
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.state.ends.store(true, Ordering::Relaxed);
    }
}

impl State {
    /// Carries one direction in a thread of its own until it ends.
    fn carry(self: &Arc<Self>, from: &TcpStream, to: &TcpStream) -> std::io::Result<()> {
        let (mut from, mut to) = (from.try_clone()?, to.try_clone()?);
        from.set_nonblocking(false)?;
        from.set_read_timeout(Some(Duration::from_millis(50)))?;
        to.set_nodelay(true)?;
        let state = Arc::clone(self);
        thread::spawn(move || {
            let at_once =
                state.link.rate.map_or(CHUNK, |rate| ((rate * CHUNK_TIME) as usize).clamp(1, CHUNK));
            let mut bytes = vec![0; at_once];
            // When the link is free again.
            let mut free = Instant::now();
            while !state.ends.load(Ordering::Relaxed) {
                match from.read(&mut bytes) {
                    Ok(0) => break,
                    Ok(count) => {
                        state.delay();
                        if let Some(rate) = state.link.rate {
                            free = free.max(Instant::now()) + Duration::from_secs_f64(count as f64 / rate);
                            thread::sleep(free.saturating_duration_since(Instant::now()));
                        }
                        if to.write_all(&bytes[..count]).is_err() {
                            break;
                        }
                        state.carried.fetch_add(count as u64, Ordering::Relaxed);
                    }
                    Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                    Err(_) => break,
                }
            }
            let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
        });
        Ok(())
    }

    /// Waits for what was lost to be sent again, and for the link to work.
    fn delay(&self) {
        let drawn = self.random.lock().unwrap_or_else(PoisonError::into_inner).below(self.link.lost);
        if self.link.lost > 0 && drawn == 0 {
            thread::sleep(PAUSE);
        }
        while self.is_cut.load(Ordering::Relaxed) && !self.ends.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(20));
        }
    }
}
