//! The agent's pulse: a thread that writes the heartbeat, feeds the service manager's watchdog, watches the memory and
//! passes on the wish to stop.

use super::heartbeat::{self, INTERVAL};
use super::manager::Manager;
use super::vitals::{Vitals, Why};
use crate::Level;
use sources::Stop;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How soon the wish to stop is passed on.
const LOOK: Duration = Duration::from_millis(20);
/// Frames a second are those of so many beats.
const RATE_BEATS: usize = 5;

/// The thread; it ends when this is dropped, with a last heartbeat.
pub struct Pulse {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// What the thread needs.
struct Beating {
    vitals: Arc<Vitals>,
    path: PathBuf,
    stop: Stop,
    memory_limit: u64,
    manager: Manager,
    /// Frames at the last beats.
    frames: VecDeque<(Instant, u64)>,
    is_stopping: bool,
    /// The heartbeat could not be written; said once.
    is_dumb: bool,
}

impl Pulse {
    /// Starts it: beats go to the file at `path`, and a session ends where the memory reaches `memory_limit` bytes or
    /// `stop` is wished.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn start(
        vitals: &Arc<Vitals>,
        path: PathBuf,
        memory_limit: u64,
        stop: &Stop,
    ) -> std::io::Result<Self> {
        let ends = Arc::new(AtomicBool::new(false));
        let mut beating = Beating {
            vitals: Arc::clone(vitals),
            path,
            stop: stop.clone(),
            memory_limit,
            manager: Manager::of_environment(),
            frames: VecDeque::new(),
            is_stopping: false,
            is_dumb: false,
        };
        beating.manager.notify("READY=1");
        let ended = Arc::clone(&ends);
        let work = move || {
            while !ended.load(Ordering::Acquire) {
                beating.beat();
                let began = Instant::now();
                while began.elapsed() < INTERVAL && !ended.load(Ordering::Acquire) {
                    beating.pass_on_stop();
                    std::thread::sleep(LOOK);
                }
            }
            beating.beat();
        };
        let thread = std::thread::Builder::new().name("heartbeat".into()).spawn(work)?;
        Ok(Self { ends, thread: Some(thread) })
    }
}

impl Drop for Pulse {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic of it was printed by itself.
            let _ = thread.join();
        }
    }
}

impl Beating {
    fn pass_on_stop(&mut self) {
        if self.stop.requested() {
            // Whichever session there is by now.
            self.vitals.end_session(Why::Stop);
            if !std::mem::replace(&mut self.is_stopping, true) {
                self.manager.notify("STOPPING=1");
            }
        }
    }

    fn beat(&mut self) {
        let memory = view::process::memory_bytes();
        let (rate, is_alive) = {
            let mut now = self.vitals.now();
            self.frames.push_back((Instant::now(), now.beat.frames));
            if self.frames.len() > RATE_BEATS + 1 {
                self.frames.pop_front();
            }
            now.beat.frames_per_s = rate(&self.frames);
            (now.beat.memory_bytes, now.beat.memory_limit_bytes) = (memory, self.memory_limit);
            (now.beat.frames_per_s, now.beat.state.is_alive_after(now.last_activity.elapsed()))
        };
        if memory.is_some_and(|memory| memory >= self.memory_limit) {
            self.vitals.end_session(Why::Memory);
        }
        let beat = self.vitals.heartbeat();
        let written = beat.text().map_err(Into::into).and_then(|text| heartbeat::write(&self.path, &text));
        match written {
            Err(error) if !self.is_dumb => {
                self.is_dumb = true;
                self.vitals.report(
                    Level::Warn,
                    &format!("{}: the heartbeat cannot be written: {error}", self.path.display()),
                );
            }
            written => self.is_dumb = written.is_err(),
        }
        if is_alive {
            let (state, keyframes) = (beat.state.name(), beat.keyframes);
            self.manager
                .notify(&format!("WATCHDOG=1\nSTATUS={state}, {rate:.0} frames/s, {keyframes} keyframes"));
        }
    }
}

/// Frames a second between the first and the last beat.
fn rate(frames: &VecDeque<(Instant, u64)>) -> f64 {
    let (Some(first), Some(last)) = (frames.front(), frames.back()) else { return 0.0 };
    let seconds = (last.0 - first.0).as_secs_f64();
    if seconds > 0.0 { (last.1 - first.1) as f64 / seconds } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn vitals() -> Arc<Vitals> {
        Vitals::new("one".into(), Arc::new(|_, _| {}))
    }

    #[test]
    fn it_beats_forwards_the_request_to_stop_and_ends() {
        let room = tempfile::tempdir().expect("a folder");
        let path = room.path().join("heartbeat.json");
        let (vitals, stop) = (vitals(), Stop::default());
        let session = vitals.begin(1, Path::new("000001"), None);
        let pulse = Pulse::start(&vitals, path.clone(), u64::MAX, &stop).expect("a thread");
        stop.request();
        let began = Instant::now();
        while !session.requested() {
            assert!(began.elapsed() < Duration::from_secs(5), "the wish is not passed on");
            std::thread::sleep(Duration::from_millis(5));
        }
        vitals.enter(heartbeat::State::Ended);
        drop(pulse);
        let last = heartbeat::read(&path).expect("it was written");
        assert_eq!((last.state, last.healthy, last.session), (heartbeat::State::Ended, false, 1));
    }

    #[test]
    fn a_session_ends_where_memory_does() {
        let room = tempfile::tempdir().expect("a folder");
        let (vitals, stop) = (vitals(), Stop::default());
        let session = vitals.begin(1, Path::new("000001"), None);
        let _pulse = Pulse::start(&vitals, room.path().join("h.json"), 1, &stop).expect("a thread");
        let began = Instant::now();
        while !session.requested() {
            assert!(began.elapsed() < Duration::from_secs(5), "the limit is not seen");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(vitals.now().why, Some(Why::Memory));
    }

    #[test]
    fn the_rate_is_that_of_the_last_beats() {
        let now = Instant::now();
        let at = |s: u64, frames| (now + Duration::from_secs(s), frames);
        assert_eq!(rate(&VecDeque::from([at(0, 10), at(1, 40), at(2, 70)])), 30.0);
        assert_eq!(rate(&VecDeque::from([at(0, 10)])), 0.0);
    }
}
