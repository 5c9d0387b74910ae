//! A camera as a source of frames. It counts frames that the driver did not deliver, detects silence and unplugging,
//! and reconnects on request.

use super::device::{Captured, Device, View};
use super::open::Opened;
use super::stream::BUFFERS;
use crate::forward::Forward;
use crate::notice::{Listener, Notice};
use crate::{FrameSource, SourceFrame, SourceInfo};
use anyhow::Result;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a camera may be silent.
const SILENCE: Duration = Duration::from_secs(2);
/// How often a camera that went away is looked for.
const SEARCH: Duration = Duration::from_millis(500);
/// How long a wish to stop may go unnoticed.
const SLICE: Duration = Duration::from_millis(100);

/// Opens the camera again; fails while it is not back.
pub type Reopen = Box<dyn FnMut() -> Result<Opened> + Send>;

/// A live camera.
pub struct Live {
    info: SourceInfo,
    view: View,
    /// `None` while the camera is away.
    device: Option<Box<dyn Device>>,
    /// With `--reconnect`.
    reopen: Option<Reopen>,
    next_index: u64,
    gaps: Gaps,
    /// When frames were first asked for.
    begun: Option<Instant>,
    /// Frames that may still lie in the driver from before that.
    stale: u32,
    /// When the camera last gave a frame.
    last_frame: Instant,
    duration: Option<Duration>,
    ends: Option<Instant>,
    stop: Arc<AtomicBool>,
    failure: Option<String>,
    listener: Option<Listener>,
    /// What there is to say before the first frame.
    pending: Vec<Notice>,
    silence: Duration,
    search: Duration,
}

/// Counts the frames that a driver could not deliver.
#[derive(Debug, Default)]
struct Gaps {
    last: Option<u32>,
    missed: u64,
}

impl Gaps {
    fn see(&mut self, sequence: u32) {
        if let Some(last) = self.last {
            let step = sequence.wrapping_sub(last);
            // A step of more than half the circle is one back: the driver has begun to count anew.
            if step < u32::MAX / 2 {
                self.missed += step.saturating_sub(1) as u64;
            }
        }
        self.last = Some(sequence);
    }

    /// The camera was started anew, and with it its count.
    fn restart(&mut self) {
        self.last = None;
    }
}

/// A camera as a source, whose images of more than eight bits have the range of the first ones.
pub fn source(live: Live) -> Box<dyn FrameSource> {
    Box::new(Forward::new(Box::new(live)))
}

impl Live {
    /// Frames from a camera just opened; `reopen` makes it wait when the camera is unplugged.
    pub fn new(path: PathBuf, opened: Opened, reopen: Option<Reopen>, duration: Option<Duration>) -> Self {
        let info = SourceInfo::new("camera", path);
        let mut pending = vec![Notice::Note(opened.description)];
        pending.extend(opened.warnings.into_iter().map(Notice::Warning));
        Self {
            info,
            view: opened.device.view(),
            device: Some(opened.device),
            reopen,
            next_index: 0,
            gaps: Gaps::default(),
            begun: None,
            stale: BUFFERS,
            last_frame: Instant::now(),
            duration,
            ends: None,
            stop: Arc::default(),
            failure: None,
            listener: None,
            pending,
            silence: SILENCE,
            search: SEARCH,
        }
    }

    fn notify(&self, notice: Notice) {
        if let Some(listener) = &self.listener {
            listener(notice);
        }
    }

    fn ended(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.ends.is_some_and(|ends| Instant::now() >= ends)
    }

    /// Whether the frame is from before frames were asked for: the driver kept it while others were not kept, so it
    /// is old, and what is missing behind it was not wanted.
    fn is_stale(&mut self, captured: &Captured) -> bool {
        let stale = self.stale > 0 && self.begun.is_some_and(|begun| captured.captured < begun);
        self.stale = if stale { self.stale - 1 } else { 0 };
        stale
    }

    fn frame(&mut self, captured: Captured) -> SourceFrame {
        self.last_frame = Instant::now();
        if let (None, Some(duration)) = (self.ends, self.duration) {
            self.ends = self.last_frame.checked_add(duration);
        }
        self.gaps.see(captured.sequence);
        let index = self.next_index;
        self.next_index += 1;
        SourceFrame {
            index,
            timestamp: captured.timestamp,
            captured: Some(captured.captured),
            picture: self.view.picture(captured),
        }
    }

    /// The camera is away: lets go of it, and either waits or ends.
    fn lose(&mut self, reason: &str) {
        // What is left of it must be closed, or it cannot come back under the same name.
        self.device = None;
        let name = self.info.path.display();
        if self.reopen.is_some() {
            self.notify(Notice::Gone(format!("{name}: {reason}; waiting for it to come back (Ctrl-C ends)")));
        } else {
            self.failure = Some(format!(
                "{name}: {reason}\nhint: plug it in and run again; with --reconnect the run waits for it and goes on"
            ));
        }
    }

    /// Looks once whether the camera is back.
    fn look(&mut self) {
        let Some(Ok(opened)) = self.reopen.as_mut().map(|reopen| reopen()) else {
            self.sleep();
            return;
        };
        let view = opened.device.view();
        if (view.format, view.size) != (self.view.format, self.view.size) {
            self.failure = Some(format!(
                "{}: the camera came back with other images: {}\nhint: run again",
                self.info.path.display(),
                opened.description
            ));
            return;
        }
        self.view = view;
        self.device = Some(opened.device);
        self.gaps.restart();
        self.last_frame = Instant::now();
        self.notify(Notice::Back(format!("the camera is back: {}", opened.description)));
    }

    fn sleep(&self) {
        let until = Instant::now() + self.search;
        while !self.ended() {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(SLICE));
        }
    }
}

impl FrameSource for Live {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if self.begun.is_none() {
            self.last_frame = Instant::now();
            self.begun = Some(self.last_frame);
        }
        for notice in std::mem::take(&mut self.pending) {
            self.notify(notice);
        }
        while !self.ended() && self.failure.is_none() {
            let Some(device) = &mut self.device else {
                self.look();
                continue;
            };
            match device.next(SLICE.min(self.silence)) {
                Ok(Some(captured)) if self.is_stale(&captured) => {}
                Ok(Some(captured)) => return Some(self.frame(captured)),
                Ok(None) if self.last_frame.elapsed() > self.silence => self.lose(&format!(
                    "no image for {} s (is there a signal, and is the cable sound?)",
                    self.silence.as_secs()
                )),
                Ok(None) => {}
                Err(error) => self.lose(&reason(&error)),
            }
        }
        self.device = None;
        None
    }

    fn is_live(&self) -> bool {
        true
    }

    fn missed(&self) -> u64 {
        self.gaps.missed
    }

    fn failure(&self) -> Option<String> {
        self.failure.clone()
    }

    fn stopper(&self) -> Option<Arc<AtomicBool>> {
        Some(Arc::clone(&self.stop))
    }

    fn listen(&mut self, listener: Listener) {
        self.listener = Some(listener);
    }
}

fn reason(error: &std::io::Error) -> String {
    match error.raw_os_error() {
        Some(libc::ENODEV | libc::ENXIO | libc::EIO | libc::EPIPE) => "the camera was unplugged".into(),
        _ => format!("the camera fails: {error}"),
    }
}

#[cfg(test)]
#[path = "live_tests.rs"]
mod tests;
