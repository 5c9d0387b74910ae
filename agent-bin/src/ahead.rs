//! Decoding ahead: a thread turns a source's pictures into frames for the agent.

mod prepare;
mod queue;

pub use prepare::{Preparation, Skip, SkipReason};

use crate::sources::FrameSource;
use anyhow::{Context, Result};
use queue::Queue;
use slam_direct::Frame;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Frames held decoded before tracking waits for none: enough to hide a slow one, few enough to bound memory.
const FRAMES_AHEAD: usize = 4;

/// What comes out of the thread.
#[derive(Debug)]
pub enum Item {
    /// A frame to track.
    Frame(Frame),
    /// A frame of the source that cannot be tracked.
    Skipped(Skip),
    /// Something about the recording as a whole that the user should know.
    Warning(String),
}

/// When frames are handed on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// Each frame, as soon as it is wanted.
    EveryFrame,
    /// By the time stamps, `speed` times as fast; a frame not taken when the next comes is dropped.
    RealTime {
        /// 1 for the speed of the recording.
        speed: f64,
    },
}

/// The running thread and its queue.
pub struct Ahead {
    queue: Arc<Queue>,
    thread: Option<JoinHandle<()>>,
}

impl Ahead {
    /// Starts decoding.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(source: Box<dyn FrameSource>, preparation: Preparation, pace: Pace) -> Result<Self> {
        let queue = Arc::new(match pace {
            Pace::EveryFrame => Queue::waiting(FRAMES_AHEAD),
            Pace::RealTime { .. } => Queue::newest_only(),
        });
        let of_thread = Arc::clone(&queue);
        let thread = std::thread::Builder::new()
            .name("decode".into())
            .spawn(move || {
                let _closes = CloseOnDrop(&of_thread);
                produce(source, preparation, pace, &of_thread);
            })
            .context("cannot start the decoding thread")?;
        Ok(Self { queue, thread: Some(thread) })
    }

    /// The next item; waits for it. `None` when the recording has ended or `stop` is set.
    pub fn next_item(&self, stop: &AtomicBool) -> Option<Item> {
        self.queue.pop(stop)
    }

    /// Frames dropped because tracking was late.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }
}

impl Drop for Ahead {
    fn drop(&mut self) {
        self.queue.close();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was printed by itself; there is nobody left to tell.
            let _ = thread.join();
        }
    }
}

/// Ends the consumer's wait however the producer ends.
struct CloseOnDrop<'a>(&'a Queue);

impl Drop for CloseOnDrop<'_> {
    fn drop(&mut self) {
        self.0.close();
    }
}

fn produce(mut source: Box<dyn FrameSource>, mut preparation: Preparation, pace: Pace, queue: &Queue) {
    let mut clock = Clock::new(pace);
    while let Some(frame) = source.next_frame() {
        let wanted = match preparation.admit(&frame) {
            Ok(prepare::Admission::Wanted) => true,
            Ok(prepare::Admission::Before) => continue,
            Ok(prepare::Admission::After) => break,
            Err(skip) => {
                if !queue.push(Item::Skipped(skip)) {
                    return;
                }
                false
            }
        };
        if wanted {
            let timestamp = frame.timestamp;
            let item = preparation.prepare(frame);
            clock.wait_until(timestamp, queue);
            if !queue.push(item) {
                return;
            }
        }
    }
    if let Some(warning) = source.warning() {
        queue.push(Item::Warning(warning));
    }
}

/// Turns time stamps into moments.
struct Clock {
    pace: Pace,
    start: Option<(f64, Instant)>,
}

impl Clock {
    fn new(pace: Pace) -> Self {
        Self { pace, start: None }
    }

    /// Sleeps until the moment of `timestamp`; the first call sets the clock.
    fn wait_until(&mut self, timestamp: f64, queue: &Queue) {
        let Pace::RealTime { speed } = self.pace else { return };
        let &mut (first, started) = self.start.get_or_insert_with(|| (timestamp, Instant::now()));
        let due = Duration::try_from_secs_f64((timestamp - first) / speed).unwrap_or(Duration::ZERO);
        // In slices, so that closing the queue ends the thread within one even across a gap in the recording.
        while !queue.is_closed() {
            let Some(left) = due.checked_sub(started.elapsed()).filter(|left| !left.is_zero()) else {
                return;
            };
            std::thread::sleep(left.min(Duration::from_millis(100)));
        }
    }
}
