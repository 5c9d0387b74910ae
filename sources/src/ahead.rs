//! Decoding ahead: a thread turns a source's pictures into frames for the agent.

mod live;
mod prepare;
mod queue;

pub use prepare::{Preparation, Skip, SkipReason};

use crate::Stop;
use crate::notice::Notice;
use crate::recording::Recorder;
use crate::{FrameSource, SourceFrame, time};
use anyhow::{Context, Result};
use queue::Queue;
use slam_direct::Frame;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Frames held decoded before tracking waits for none: enough to hide a slow one, few enough to bound memory.
const FRAMES_AHEAD: usize = 4;

/// How long the next item is waited for at a time: who watches a run whose camera is unplugged can still steer it.
const PATIENCE: Duration = Duration::from_millis(100);

/// An item from the decoding thread.
#[derive(Debug)]
pub enum Item {
    /// A frame to track, and when it was taken or, in a replay by time stamps, due.
    Frame(Frame, Option<Instant>),
    /// A frame of the source that cannot be tracked.
    Skipped(Skip),
    /// Something about the recording as a whole that the user should know.
    Warning(String),
    /// A notice of a live source.
    Notice(Notice),
    /// Why there are no more frames, though the user did not stop the source.
    Failed(String),
    /// No item came for a while; the caller can do other work.
    Nothing,
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
    /// As they arrive from a live source; a frame not taken when the next arrives is dropped.
    Live,
}

/// The running thread and its queue.
pub struct Ahead {
    queue: Arc<Queue>,
    recorder: Recorder,
    /// Ends the source's own waiting.
    stopper: Option<Arc<AtomicBool>>,
    thread: Option<JoinHandle<()>>,
}

impl Ahead {
    /// Starts decoding, and gives what is captured to `recorder`.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(
        mut source: Box<dyn FrameSource>,
        preparation: Preparation,
        pace: Pace,
        recorder: Recorder,
    ) -> Result<Self> {
        let pace = if source.is_live() { Pace::Live } else { pace };
        let queue = Arc::new(match pace {
            Pace::EveryFrame => Queue::waiting(FRAMES_AHEAD),
            Pace::RealTime { .. } | Pace::Live => Queue::newest_only(),
        });
        let (of_thread, of_notices) = (Arc::clone(&queue), Arc::clone(&queue));
        source.listen(Box::new(move |notice| {
            of_notices.push(Item::Notice(notice));
        }));
        let stopper = source.stopper();
        let tap = Tap { recorder: recorder.clone(), pace };
        let thread = std::thread::Builder::new()
            .name("decode".into())
            .spawn(move || {
                let _closes = CloseOnDrop(&of_thread);
                produce(source, preparation, pace, &of_thread, &tap);
            })
            .context("cannot start the decoding thread")?;
        Ok(Self { queue, recorder, stopper, thread: Some(thread) })
    }

    /// The next item. It waits for one, and returns [`Item::Nothing`] when that takes long. `None` when the recording
    /// has ended or `stop` is set.
    pub fn next_item(&self, stop: &Stop) -> Option<Item> {
        self.queue.pop(stop, PATIENCE)
    }

    /// Frames dropped because tracking was late.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
    }

    /// Frames that a live source's driver could not deliver.
    pub fn missed(&self) -> u64 {
        self.queue.missed()
    }

    /// No more frames are wanted: lets go of the source, so that a camera is put back as it was while the run still
    /// has other work.
    pub fn end(&self) {
        if let Some(stopper) = &self.stopper {
            stopper.store(true, Ordering::Relaxed);
        }
        self.queue.close();
    }
}

impl Drop for Ahead {
    fn drop(&mut self) {
        self.end();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was told through the queue.
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
        if std::thread::panicking() {
            // How it broke down, the thread has printed itself.
            self.0.push(Item::Failed("internal error in reading and decoding, please report it".into()));
        }
        self.0.close();
    }
}

/// Gives the recorder what is captured: of a live source all of it at once, else what is to be processed.
struct Tap {
    recorder: Recorder,
    pace: Pace,
}

impl Tap {
    /// A live source has a frame.
    fn captured(&self, frame: &SourceFrame) {
        self.recorder.frame(frame);
    }

    /// A frame lies in the part that is to be processed.
    fn admitted(&self, frame: &SourceFrame, queue: &Queue) {
        match self.pace {
            Pace::EveryFrame => self.recorder.frame_waiting(frame),
            Pace::RealTime { .. } => self.recorder.frame(frame),
            Pace::Live => {}
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
    preparation.skip_in(source.as_mut());
    let mut decoding = Decoding { preparation, clock: Clock::new(pace), queue, tap };
    if pace == Pace::Live {
        live::produce(&mut *source, &mut decoding);
    } else {
        while source.next_frame().is_some_and(|frame| decoding.take(frame)) {}
    }
    if let Some(warning) = source.warning() {
        queue.push(Item::Warning(warning));
    }
    if let Some(failure) = source.failure() {
        queue.push(Item::Failed(failure));
    }
}

/// From a source's frame to the queue.
struct Decoding<'a> {
    preparation: Preparation,
    clock: Clock,
    queue: &'a Queue,
    tap: &'a Tap,
}

impl Decoding<'_> {
    /// Whether more frames are wanted.
    fn take(&mut self, mut frame: SourceFrame) -> bool {
        frame.timestamp = time::on_grid(frame.timestamp);
        let (index, timestamp) = (frame.index, frame.timestamp);
        match self.preparation.admit(&frame) {
            Ok(prepare::Admission::Wanted) => {}
            Ok(prepare::Admission::Before) => return true,
            Ok(prepare::Admission::After) => return false,
            Err(skip) => {
                self.tap.admitted(&frame, self.queue);
                // In a replay, time may look different without the frames before.
                self.tap.recorder.dropped(index);
                return self.queue.push(Item::Skipped(skip));
            }
        }
        self.tap.admitted(&frame, self.queue);
        let mut item = self.preparation.prepare(frame);
        let due = self.clock.wait_until(timestamp, self.queue);
        if let Item::Frame(_, moment) = &mut item {
            *moment = moment.or(due);
        }
        let continues = !matches!(item, Item::Failed(_));
        let open = self.queue.push(item);
        self.tap.forgotten(self.queue);
        open && continues
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

    /// Sleeps until the moment of `timestamp` and gives it; the first call sets the clock.
    fn wait_until(&mut self, timestamp: f64, queue: &Queue) -> Option<Instant> {
        let Pace::RealTime { speed } = self.pace else { return None };
        let &mut (first, started) = self.start.get_or_insert_with(|| (timestamp, Instant::now()));
        let due = Duration::try_from_secs_f64((timestamp - first) / speed).unwrap_or(Duration::ZERO);
        // In slices, so that closing the queue ends the thread within one even across a gap in the recording.
        while !queue.is_closed() {
            let Some(left) = due.checked_sub(started.elapsed()).filter(|left| !left.is_zero()) else {
                break;
            };
            std::thread::sleep(left.min(Duration::from_millis(100)));
        }
        started.checked_add(due)
    }
}
