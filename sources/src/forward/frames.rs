//! Frames whose time goes forward, and whose grey levels are of one range.

use super::{Clock, LOOKED_AHEAD, StampVerdict};
use crate::notice::{Listener, Notice};
use crate::pictures::{Levels, Picture, StatedFocal};
use crate::{FrameSource, SourceFrame, SourceInfo};
use geometry::Camera;
use std::collections::VecDeque;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

/// A recording whose time grows. A frame whose stamp is not of the recording's clock becomes a [`Picture::Mistimed`];
/// frames after the clock was set get the time of the continued clock. Pictures of more than eight bits get the range
/// of the first ones ([`Picture::Ranged`]). Frames are delayed only where a stamp needs a second look, and the first
/// ones of more than eight bits. The clock of a live source is the kernel's and is not changed.
pub struct Forward {
    inner: Box<dyn FrameSource>,
    clock: Clock,
    levels: Option<Levels>,
    ahead: VecDeque<SourceFrame>,
    ended: bool,
    listener: Option<Arc<Mutex<Listener>>>,
}

impl Forward {
    /// The recording from here on.
    pub fn new(inner: Box<dyn FrameSource>) -> Self {
        let (clock, ahead) = (Clock::default(), VecDeque::new());
        Self { inner, clock, levels: None, ahead, ended: false, listener: None }
    }

    /// Finds the range of the pictures, before the first one is handed out.
    fn look_at_levels(&mut self) {
        self.read_ahead(1);
        while !self.ended && Levels::needs_more(self.ahead.iter().map(|frame| &frame.picture)) {
            self.read_ahead(self.ahead.len() + 1);
        }
        self.levels = Some(Levels::of(self.ahead.iter().map(|frame| &frame.picture)));
    }

    /// Reads on until so many frames are in memory, or there are no more.
    fn read_ahead(&mut self, count: usize) {
        while self.ahead.len() < count && !self.ended {
            match self.inner.next_frame() {
                Some(frame) => self.ahead.push_back(frame),
                None => self.ended = true,
            }
        }
    }

    fn judge(&mut self, mut frame: SourceFrame) -> SourceFrame {
        let mut following = Vec::new();
        if !self.clock.is_plain(frame.timestamp) {
            self.read_ahead(LOOKED_AHEAD);
            following.extend(self.ahead.iter().filter_map(stamp));
        }
        let sets = self.clock.faults().sets;
        match self.clock.judge(frame.timestamp, &following) {
            StampVerdict::At(time) => frame.timestamp = time,
            // Who takes frames has words for these.
            StampVerdict::Repeats | StampVerdict::NoTime => {}
            StampVerdict::Off => frame.picture = Picture::mistimed(frame.timestamp),
        }
        if self.clock.faults().sets > sets && sets == 0 {
            let text = self.clock.faults().of_set().unwrap_or_default();
            self.notify(Notice::Warning(format!("{}: {text}", self.inner.info().path.display())));
        }
        frame
    }

    fn notify(&self, notice: Notice) {
        if let Some(listener) = &self.listener {
            listener.lock().unwrap_or_else(PoisonError::into_inner)(notice);
        }
    }
}

/// The stamp of a frame that may be one of the clock's.
fn stamp(frame: &SourceFrame) -> Option<f64> {
    (!matches!(frame.picture, Picture::Mistimed(_))).then_some(frame.timestamp)
}

impl FrameSource for Forward {
    fn info(&self) -> &SourceInfo {
        self.inner.info()
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if self.levels.is_none() {
            self.look_at_levels();
        }
        self.read_ahead(1);
        let mut frame = self.ahead.pop_front()?;
        if let Some(levels) = &self.levels {
            frame.picture = levels.of_picture(frame.picture);
        }
        let is_checked = stamp(&frame).is_some() && !self.inner.is_live();
        Some(if is_checked { self.judge(frame) } else { frame })
    }

    fn warning(&self) -> Option<String> {
        // Who listens was told when it was set, and counts the frames that are left out.
        let faults = if self.listener.is_some() { Vec::new() } else { self.clock.faults().texts() };
        let of_clock = faults.into_iter().map(|fault| format!("{}: {fault}", self.info().path.display()));
        let all: Vec<String> = self.inner.warning().into_iter().chain(of_clock).collect();
        (!all.is_empty()).then(|| all.join("\n"))
    }

    fn skip_to(&mut self, start: f64) -> Option<f64> {
        self.inner.skip_to(start)
    }

    fn expect_camera(&mut self, camera: &Camera) {
        self.inner.expect_camera(camera);
    }

    fn problems(&self) -> Vec<String> {
        self.inner.problems()
    }

    fn stated_focal(&self, size: (usize, usize)) -> Option<StatedFocal> {
        self.inner.stated_focal(size)
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let mut facts = self.inner.facts();
        let range = self.levels.as_ref().and_then(Levels::range);
        facts.extend(range.map(|range| ("bits", range.text())));
        facts
    }

    fn decodes(&self) -> bool {
        self.inner.decodes()
    }

    fn is_live(&self) -> bool {
        self.inner.is_live()
    }

    fn missed(&self) -> u64 {
        self.inner.missed()
    }

    fn failure(&self) -> Option<String> {
        self.inner.failure()
    }

    fn stopper(&self) -> Option<Arc<AtomicBool>> {
        self.inner.stopper()
    }

    fn listen(&mut self, listener: Listener) {
        let shared = Arc::new(Mutex::new(listener));
        let of_inner = Arc::clone(&shared);
        self.inner.listen(Box::new(move |notice| {
            of_inner.lock().unwrap_or_else(PoisonError::into_inner)(notice);
        }));
        self.listener = Some(shared);
    }
}
