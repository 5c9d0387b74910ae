//! A proxy between two processes whose faults are drawn from a seed. What TCP carries is never lost: a lost packet shows as
//! a pause, in which it is sent again.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// The pause of a lost packet: the least time after which Linux sends again.
const PAUSE: Duration = Duration::from_millis(200);
/// One packet in so many is lost.
const LOST: u64 = 50;
/// Bytes that are carried at a time: as many as some packets hold.
const CHUNK: usize = 16 << 10;

/// Carries what comes to where it was made for.
pub struct Proxy {
    address: String,
    faults: Arc<Faults>,
}

struct Faults {
    is_cut: AtomicBool,
    ends: AtomicBool,
    random: AtomicU64,
}

impl Proxy {
    /// To `target`, `tcp/HOST:PORT`.
    pub fn start(target: &str, seed: u64) -> Self {
        let target = target.strip_prefix("tcp/").expect("it is of that kind").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
        let address = format!("tcp/{}", listener.local_addr().expect("it has one"));
        let faults = Arc::new(Faults {
            is_cut: AtomicBool::new(false),
            ends: AtomicBool::new(false),
            random: AtomicU64::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
        });
        let of_thread = Arc::clone(&faults);
        listener.set_nonblocking(true).expect("it can");
        thread::spawn(move || {
            while !of_thread.ends.load(Ordering::Relaxed) {
                match listener.accept() {
                    Ok((near, _)) => {
                        if let Ok(far) = TcpStream::connect(&target) {
                            of_thread.carry(&near, &far);
                            of_thread.carry(&far, &near);
                        }
                    }
                    Err(_) => thread::sleep(Duration::from_millis(20)),
                }
            }
        });
        Self { address, faults }
    }

    /// Where it is to be dialled.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Lets nothing through, or everything again.
    pub fn cut(&self, is_cut: bool) {
        self.faults.is_cut.store(is_cut, Ordering::Relaxed);
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.faults.ends.store(true, Ordering::Relaxed);
    }
}

impl Faults {
    /// Carries one direction in a thread of its own until it ends.
    fn carry(self: &Arc<Self>, from: &TcpStream, to: &TcpStream) {
        let (mut from, mut to) = (from.try_clone().expect("it can"), to.try_clone().expect("it can"));
        from.set_nonblocking(false).expect("it can");
        from.set_read_timeout(Some(Duration::from_millis(50))).expect("it can");
        let faults = Arc::clone(self);
        thread::spawn(move || {
            let mut bytes = [0; CHUNK];
            while !faults.ends.load(Ordering::Relaxed) {
                match from.read(&mut bytes) {
                    Ok(0) => break,
                    Ok(count) => {
                        faults.delay();
                        if to.write_all(&bytes[..count]).is_err() {
                            break;
                        }
                    }
                    Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                    Err(_) => break,
                }
            }
            let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
        });
    }

    /// Waits for what was lost to be sent again, and for the link to work.
    fn delay(&self) {
        let step = |x: u64| {
            let x = x ^ (x << 13);
            let x = x ^ (x >> 7);
            Some(x ^ (x << 17))
        };
        let drawn = self.random.fetch_update(Ordering::Relaxed, Ordering::Relaxed, step);
        if drawn.unwrap_or_default().is_multiple_of(LOST) {
            thread::sleep(PAUSE);
        }
        while self.is_cut.load(Ordering::Relaxed) && !self.ends.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(20));
        }
    }
}
