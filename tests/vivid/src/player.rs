//! Plays pictures into the driver's output.

use crate::driver::{self, Mode, OUTPUT};
use crate::layout;
use crate::stream::Stream;
use anyhow::{Context, Result, anyhow};
use image::GrayImage;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Pictures that are being played. The last one stays until the player is stopped.
pub struct Player {
    stop: Arc<AtomicBool>,
    shown: Arc<AtomicUsize>,
    /// Why playing ended early.
    failure: Arc<Mutex<Option<String>>>,
    thread: JoinHandle<Vec<f64>>,
}

impl Player {
    /// Connects output and input and plays so many pictures per second.
    ///
    /// # Errors
    /// When the driver refuses.
    pub fn start(pictures: &[GrayImage], mode: &Mode, pace: f64) -> Result<Self> {
        driver::connect(mode)?;
        let frames = pictures.iter().map(|p| layout::bytes(p, mode.format)).collect::<Result<Vec<_>>>()?;
        let stop = Arc::new(AtomicBool::new(false));
        let shown = Arc::new(AtomicUsize::new(0));
        let failure = Arc::new(Mutex::new(None));
        let thread = thread::spawn({
            let (stop, shown, failure) = (stop.clone(), shown.clone(), failure.clone());
            move || {
                let mut times = Vec::new();
                let played = play(&frames, Duration::from_secs_f64(1.0 / pace), &stop, &shown, &mut times);
                if let (Err(error), Ok(mut failure)) = (played, failure.lock()) {
                    *failure = Some(format!("{error:#}"));
                }
                times
            }
        });
        let player = Self { stop, shown, failure, thread };
        player.wait_for(1)?;
        Ok(player)
    }

    /// Waits until so many pictures were played.
    ///
    /// # Errors
    /// When playing ended before.
    pub fn wait_for(&self, count: usize) -> Result<()> {
        while self.shown.load(Ordering::Acquire) < count {
            if self.thread.is_finished() {
                let shown = self.shown.load(Ordering::Acquire);
                return Err(anyhow!("the player ended after {shown} pictures: {:?}", self.failure.lock()));
            }
            thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    /// Stops; when each picture was played, in seconds of the clock that time stamps of frames count by.
    ///
    /// # Errors
    /// When playing failed.
    pub fn stop(self) -> Result<Vec<f64>> {
        self.stop.store(true, Ordering::Release);
        let times = self.thread.join().map_err(|_| anyhow!("the player panicked"))?;
        match self.failure.lock().ok().and_then(|mut failure| failure.take()) {
            Some(failure) => Err(anyhow!(failure)),
            None => Ok(times),
        }
    }
}

fn play(
    frames: &[Vec<u8>],
    period: Duration,
    stop: &AtomicBool,
    shown: &AtomicUsize,
    times: &mut Vec<f64>,
) -> Result<()> {
    let mut stream = Stream::start(OUTPUT, frames.first().context("no pictures to play")?)?;
    let start = Instant::now();
    for (index, frame) in (0_u32..).zip(frames) {
        while start.elapsed() < period * index && !stop.load(Ordering::Acquire) {
            thread::sleep(Duration::from_millis(2));
        }
        if stop.load(Ordering::Acquire) {
            break;
        }
        stream.show(frame)?;
        times.push(now()?);
        shown.fetch_add(1, Ordering::Release);
    }
    while !stop.load(Ordering::Acquire) {
        thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}

/// Seconds since the machine started. It never sleeps, so this is also the monotonic clock.
///
/// # Errors
/// When `/proc` is not there.
pub fn now() -> Result<f64> {
    let text = std::fs::read_to_string("/proc/uptime").context("/proc/uptime")?;
    text.split(' ').next().and_then(|seconds| seconds.parse().ok()).context("/proc/uptime")
}

/// The pictures of a folder in the order of their names.
///
/// # Errors
/// When there are none, or one cannot be read.
pub fn pictures(folder: &Path) -> Result<Vec<GrayImage>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut paths: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    paths.sort();
    let read = |path: &PathBuf| {
        let picture = image::open(path).with_context(|| path.display().to_string())?;
        Ok(picture.into_luma8())
    };
    paths.iter().map(read).collect()
}
