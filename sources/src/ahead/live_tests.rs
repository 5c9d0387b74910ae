//! A live source against a slow tracker.

use crate::ahead::{Ahead, Item, Pace, Preparation};
use crate::correction::{CameraOptions, correction};
use crate::notice::{Listener, Notice};
use crate::pictures::{Picture, RawPicture};
use crate::recording::Recorder;
use crate::{FoundCalibration, FrameSource, SourceFrame, SourceInfo, Stop};
use geometry::{Camera, Distortion, Pinhole};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

/// Gives `count` frames, the next whenever the one before was taken off it; then waits until it is stopped.
struct Fake {
    info: SourceInfo,
    count: u64,
    next: u64,
    given: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    listener: Option<Listener>,
    /// Panics after its last frame.
    breaks: bool,
    live: bool,
}

impl FrameSource for Fake {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if self.next == self.count {
            assert!(!self.breaks, "this is a test");
            let listener = self.listener.as_ref().expect("somebody listens");
            listener(Notice::Gone("away".into()));
            while !self.stop.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(1));
            }
            return None;
        }
        let index = self.next;
        self.next += 1;
        self.given.store(self.next, Ordering::Relaxed);
        let raw = RawPicture {
            width: WIDTH,
            height: HEIGHT,
            step: WIDTH,
            encoding: "mono8".into(),
            big_endian: false,
            data: vec![index as u8; WIDTH * HEIGHT],
        };
        let picture = Picture::Raw(raw);
        Some(SourceFrame { index, timestamp: index as f64, captured: Some(Instant::now()), picture })
    }

    fn is_live(&self) -> bool {
        self.live
    }

    fn missed(&self) -> u64 {
        self.next / 10
    }

    fn failure(&self) -> Option<String> {
        Some("unplugged".into())
    }

    fn stopper(&self) -> Option<Arc<AtomicBool>> {
        Some(Arc::clone(&self.stop))
    }

    fn listen(&mut self, listener: Listener) {
        self.listener = Some(listener);
    }
}

fn start(count: u64) -> (Ahead, Arc<AtomicU64>, Arc<AtomicBool>) {
    start_as(count, false, true)
}

/// A source of `count` frames that may break down after them, and may be live.
fn start_as(count: u64, breaks: bool, live: bool) -> (Ahead, Arc<AtomicU64>, Arc<AtomicBool>) {
    let pinhole = Pinhole { width: WIDTH, height: HEIGHT, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
    let camera = Box::new(Camera::new(pinhole, Distortion::None).unwrap());
    let calibration = Some(FoundCalibration::Inside { origin: "test".into(), camera });
    let info = SourceInfo { calibration, ..SourceInfo::new("fake", "fake") };
    let correction = correction(&CameraOptions::default(), &info).unwrap();
    let (given, stop) = (Arc::<AtomicU64>::default(), Arc::<AtomicBool>::default());
    let source =
        Fake { info, count, next: 0, given: given.clone(), stop: stop.clone(), listener: None, breaks, live };
    // A live source sets its own pace, whatever is asked for.
    let ahead = Ahead::start(
        Box::new(source),
        Preparation::new(correction, None, None),
        Pace::EveryFrame,
        Recorder::idle(),
    );
    (ahead.unwrap(), given, stop)
}

fn wait_for(given: &AtomicU64, count: u64) {
    while given.load(Ordering::Relaxed) < count {
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_late_tracker_gets_the_newest_frame_and_the_rest_is_counted() {
    const COUNT: u64 = 200;
    let (ahead, given, _) = start(COUNT);
    // Nobody takes anything: the source must go on all the same.
    wait_for(&given, COUNT);
    let (mut frames, mut notices) = (Vec::new(), 0);
    while frames.last() != Some(&(COUNT - 1)) || notices == 0 {
        match ahead.next_item(&Stop::default()).expect("the source goes on") {
            Item::Frame(frame, taken) => {
                assert!(taken.is_some());
                assert_eq!(frame.image.data()[0], frame.index as u8);
                frames.push(frame.index);
            }
            Item::Notice(notice) => notices += u64::from(notice == Notice::Gone("away".into())),
            Item::Nothing => {}
            item => panic!("{item:?}"),
        }
    }
    assert!(frames.len() <= 4, "{frames:?} were kept");
    assert!(frames.is_sorted());
    assert_eq!(ahead.dropped() + frames.len() as u64, COUNT);
    assert_eq!(ahead.missed(), COUNT / 10);
}

#[test]
fn a_tracker_that_has_enough_stops_the_source() {
    let (ahead, given, stop) = start(3);
    wait_for(&given, 3);
    ahead.end();
    assert!(stop.load(Ordering::Relaxed));
    drop(ahead);
}

#[test]
fn a_source_that_fails_says_why() {
    let (ahead, given, stop) = start(1);
    wait_for(&given, 1);
    stop.store(true, Ordering::Relaxed);
    let mut failed = None;
    while let Some(item) = ahead.next_item(&Stop::default()) {
        if let Item::Failed(reason) = item {
            failed = Some(reason);
        }
    }
    assert_eq!(failed.as_deref(), Some("unplugged"));
}

#[test]
fn a_source_that_breaks_down_does_not_pass_for_the_end_of_the_recording() {
    for live in [true, false] {
        let (ahead, ..) = start_as(2, true, live);
        let mut failed = None;
        while let Some(item) = ahead.next_item(&Stop::default()) {
            if let Item::Failed(reason) = item {
                failed = Some(reason);
            }
        }
        assert!(failed.is_some_and(|reason| reason.contains("internal error")), "live: {live}");
    }
}
