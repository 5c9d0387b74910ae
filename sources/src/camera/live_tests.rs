use super::super::format::{PixelFormat, Size};
use super::*;
use std::collections::VecDeque;
use std::io;
use std::sync::Mutex;

/// A camera that does what a script says.
struct Scripted {
    view: View,
    script: VecDeque<Step>,
    /// The bytes of each frame.
    data: Vec<u8>,
}

#[derive(Clone, Copy)]
enum Step {
    /// A frame with this sequence number.
    Frame(u32),
    /// The same, captured a minute ago.
    Old(u32),
    /// A frame that the driver marks.
    Damaged(u32),
    /// An error.
    Fails(i32),
}
use Step::{Damaged, Fails, Frame, Old};

impl Device for Scripted {
    fn view(&self) -> View {
        self.view
    }

    fn next(&mut self, wait: Duration) -> io::Result<Option<Captured>> {
        let frame = |sequence, damaged| Captured {
            data: self.data.clone(),
            sequence,
            timestamp: sequence as f64,
            captured: Instant::now(),
            damaged,
        };
        match self.script.pop_front() {
            Some(Frame(sequence)) => Ok(Some(frame(sequence, false))),
            Some(Old(sequence)) => {
                let captured = Instant::now().checked_sub(Duration::from_secs(60)).unwrap();
                Ok(Some(Captured { captured, ..frame(sequence, false) }))
            }
            Some(Damaged(sequence)) => Ok(Some(frame(sequence, true))),
            Some(Fails(code)) => Err(io::Error::from_raw_os_error(code)),
            None => {
                std::thread::sleep(wait);
                Ok(None)
            }
        }
    }
}

const SMALL: Size = Size { width: 2, height: 2 };

fn opened(script: &[Step], size: Size) -> Opened {
    let view = View { format: PixelFormat::Grey, size, step: size.width, rate: None };
    let script = script.iter().copied().collect();
    let device = Box::new(Scripted { view, script, data: vec![7; 4] });
    Opened { device, description: "Fake".into(), warnings: vec!["no focus".into()] }
}

/// A camera that comes back as each of `again` in turn, after as many failed looks as there are `None`.
fn camera(script: &[Step], again: Option<Vec<Option<Opened>>>) -> (Live, Arc<Mutex<Vec<Notice>>>) {
    let reopen = again.map(|again| {
        let mut again = VecDeque::from(again);
        let reopen: Reopen =
            Box::new(move || again.pop_front().flatten().ok_or_else(|| anyhow::anyhow!("not there")));
        reopen
    });
    let mut live = Live::new("/dev/fake".into(), opened(script, SMALL), reopen, None);
    (live.silence, live.search) = (Duration::from_millis(20), Duration::from_millis(1));
    let text = Arc::new(Mutex::new(Vec::new()));
    let hears = Arc::clone(&text);
    live.listen(Box::new(move |notice| hears.lock().unwrap().push(notice)));
    (live, text)
}

#[test]
fn gaps_in_the_drivers_count_are_missed_frames() {
    let mut gaps = Gaps::default();
    [5, 6, 9, 10].into_iter().for_each(|sequence| gaps.see(sequence));
    assert_eq!(gaps.missed, 2);
    // The count goes around.
    [u32::MAX, 1].into_iter().for_each(|sequence| gaps.see(sequence));
    assert_eq!(gaps.missed, 2 + 1, "the step to the end is too long to be one");
    gaps.see(0);
    assert_eq!(gaps.missed, 3, "a count begun anew");
    gaps.restart();
    gaps.see(100);
    assert_eq!(gaps.missed, 3);
}

#[test]
fn a_camera_unplugged_ends_the_source_with_a_reason() {
    let (mut live, text) = camera(&[Frame(0), Frame(3), Damaged(4), Fails(libc::ENODEV)], None);
    let frames: Vec<SourceFrame> = std::iter::from_fn(|| live.next_frame()).collect();
    assert_eq!(frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(frames.iter().all(|frame| frame.captured.is_some()));
    assert!(frames.into_iter().next_back().unwrap().picture.into_grey().unwrap_err().contains("damaged"));
    assert_eq!(live.missed(), 2);
    let failure = live.failure().unwrap();
    assert!(
        failure.contains("/dev/fake: the camera was unplugged\nhint:") && failure.contains("--reconnect")
    );
    let text = text.lock().unwrap();
    assert_eq!(*text, [Notice::Note("Fake".into()), Notice::Warning("no focus".into())]);
    assert!(live.next_frame().is_none(), "it stays ended");
}

#[test]
fn frames_from_before_the_start_are_no_gap() {
    let (mut live, _) = camera(&[Old(0), Old(1), Frame(30), Frame(31), Old(32)], None);
    let stamps: Vec<f64> = (0..3).map(|_| live.next_frame().unwrap().timestamp).collect();
    assert_eq!(stamps, [30.0, 31.0, 32.0], "a clock that is off costs no more than the first frames");
    assert_eq!(live.missed(), 0);
}

#[test]
fn a_silent_camera_is_given_up() {
    let (mut live, _) = camera(&[Frame(0)], None);
    assert!(live.next_frame().is_some());
    assert!(live.next_frame().is_none());
    assert!(live.failure().unwrap().contains("no image for"));
}

#[test]
fn a_camera_that_comes_back_continues() {
    let back = opened(&[Frame(0), Frame(1), Fails(libc::EIO)], SMALL);
    let again = vec![None, None, Some(back), None, Some(opened(&[Frame(7)], SMALL))];
    let (mut live, text) = camera(&[Frame(40), Frame(41), Fails(libc::ENODEV)], Some(again));
    let indices: Vec<u64> = (0..5).map(|_| live.next_frame().unwrap().index).collect();
    assert_eq!(indices, [0, 1, 2, 3, 4]);
    assert_eq!(live.missed(), 0, "a new count is no gap");
    let kinds: Vec<char> =
        text.lock().unwrap().iter().map(|n| format!("{n:?}").chars().next().unwrap()).collect();
    assert_eq!(kinds.iter().collect::<String>(), "NWGBGB");
    // It is silent now, and nothing comes back any more: a wish to stop ends the wait.
    live.stopper().unwrap().store(true, Ordering::Relaxed);
    assert!(live.next_frame().is_none());
    assert_eq!(live.failure(), None);
}

#[test]
fn stopping_ends_the_wait_for_a_camera() {
    let (mut live, _) = camera(&[Fails(libc::ENODEV)], Some(vec![]));
    let stop = live.stopper().unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(20));
            stop.store(true, Ordering::Relaxed);
        });
        assert!(live.next_frame().is_none());
    });
    assert_eq!(live.failure(), None);
}

#[test]
fn a_camera_that_comes_back_different_ends_the_run() {
    let other = opened(&[Frame(0)], Size { width: 4, height: 1 });
    let (mut live, _) = camera(&[Fails(libc::ENODEV)], Some(vec![Some(other)]));
    assert!(live.next_frame().is_none());
    assert!(live.failure().unwrap().contains("other images"));
}

#[test]
fn the_duration_counts_from_the_first_frame() {
    let (mut live, _) = camera(&[Frame(0)], Some(vec![]));
    live.duration = Some(Duration::from_millis(5));
    assert!(live.next_frame().is_some());
    assert!(live.next_frame().is_none());
    assert_eq!(live.failure(), None);
}

#[test]
fn ten_bits_keep_their_contrast() {
    let view = View { format: PixelFormat::Y16, size: Size { width: 2, height: 1 }, step: 4, rate: None };
    // 500 and 600 of 1023, which have the same high byte but for one.
    let data = [500u16, 600].iter().flat_map(|sample| sample.to_le_bytes()).collect();
    let device = Box::new(Scripted { view, script: (0..40).map(Frame).collect(), data });
    let opened = Opened { device, description: "Fake".into(), warnings: vec![] };
    let mut live = Live::new("/dev/fake".into(), opened, None, None);
    live.silence = Duration::from_millis(20);
    let mut source = source(live);
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame() {
        assert!(source.is_live() && frame.captured.is_some());
        frames.push(frame.picture.into_grey().unwrap().data().to_vec());
    }
    assert_eq!(frames.len(), 40);
    assert!(frames.iter().all(|grey| *grey == frames[0] && grey[1] - grey[0] > 100), "{:?}", frames[0]);
}
