//! Decoding ahead: a thread turns a source's pictures into frames for the agent.

mod prepare;
mod queue;

pub use prepare::{Preparation, Skip, SkipReason};

use crate::recording::Recorder;
use crate::sources::{FrameSource, SourceFrame, time};
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
    recorder: Recorder,
    thread: Option<JoinHandle<()>>,
}

impl Ahead {
    /// Starts decoding; what is captured goes to `recorder` on the way.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(
        source: Box<dyn FrameSource>,
        preparation: Preparation,
        pace: Pace,
        recorder: Recorder,
    ) -> Result<Self> {
        let queue = Arc::new(match pace {
            Pace::EveryFrame => Queue::waiting(FRAMES_AHEAD),
            Pace::RealTime { .. } => Queue::newest_only(),
        });
        let of_thread = Arc::clone(&queue);
        let tap = Tap { recorder: recorder.clone(), may_wait: pace == Pace::EveryFrame };
        let thread = std::thread::Builder::new()
            .name("decode".into())
            .spawn(move || {
                let _closes = CloseOnDrop(&of_thread);
                produce(source, preparation, pace, &of_thread, &tap);
            })
            .context("cannot start the decoding thread")?;
        Ok(Self { queue, recorder, thread: Some(thread) })
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
        // A replay is to end where this run did.
        self.queue.forget_all();
        self.queue.take_forgotten().into_iter().for_each(|index| self.recorder.dropped(index));
    }
}

/// Ends the consumer's wait however the producer ends.
struct CloseOnDrop<'a>(&'a Queue);

impl Drop for CloseOnDrop<'_> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// Gives the recorder what is captured.
struct Tap {
    recorder: Recorder,
    /// Whether the source can wait for the disk.
    may_wait: bool,
}

impl Tap {
    fn frame(&self, frame: &SourceFrame, queue: &Queue) {
        if self.may_wait {
            self.recorder.frame_waiting(frame);
        } else {
            self.recorder.frame(frame);
        }
        if let Some(warning) = self.recorder.take_warning() {
            queue.push(Item::Warning(warning));
        }
    }

    /// Passes on what the queue has forgotten.
    fn forgotten(&self, queue: &Queue) {
        queue.take_forgotten().into_iter().for_each(|index| self.recorder.dropped(index));
    }
}

fn produce(
    mut source: Box<dyn FrameSource>,
    mut preparation: Preparation,
    pace: Pace,
    queue: &Queue,
    tap: &Tap,
) {
    let mut clock = Clock::new(pace);
    preparation.skip_in(source.as_mut());
    while let Some(mut frame) = source.next_frame() {
        frame.timestamp = time::on_grid(frame.timestamp);
        let wanted = match preparation.admit(&frame) {
            Ok(prepare::Admission::Wanted) => {
                tap.frame(&frame, queue);
                true
            }
            Ok(prepare::Admission::Before) => continue,
            Ok(prepare::Admission::After) => break,
            Err(skip) => {
                tap.frame(&frame, queue);
                // In a replay, time may look different without the frames before.
                tap.recorder.dropped(frame.index);
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
            let open = queue.push(item);
            tap.forgotten(queue);
            if !open {
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
