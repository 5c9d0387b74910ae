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

/// When the next picture comes.
#[derive(Clone, Copy, Debug)]
pub enum Pace {
    /// So many a second.
    PerSecond(f64),
    /// When [`Player::advance`] says so: an emulated processor on a busy machine is as fast as it is.
    OnDemand,
}

/// Pictures that are being played. The last one stays until the player is stopped.
pub struct Player {
    stop: Arc<AtomicBool>,
    allowed: Arc<AtomicUsize>,
    played_count: Arc<AtomicUsize>,
    /// Why playing ended early.
    failure: Arc<Mutex<Option<String>>>,
    thread: JoinHandle<Vec<f64>>,
}

impl Player {
    /// Connects output and input and plays pictures; returns when the first one is shown.
    ///
    /// # Errors
    /// When the driver refuses.
    pub fn start(pictures: &[GrayImage], mode: &Mode, pace: Pace) -> Result<Self> {
        driver::connect(mode)?;
        let frames = pictures.iter().map(|p| layout::bytes(p, mode.format)).collect::<Result<Vec<_>>>()?;
        let stop = Arc::new(AtomicBool::new(false));
        let played_count = Arc::new(AtomicUsize::new(0));
        let allowed = Arc::new(AtomicUsize::new(1));
        let failure = Arc::new(Mutex::new(None));
        let thread = thread::spawn({
            let (stop, played_count, failure) = (stop.clone(), played_count.clone(), failure.clone());
            let (start, allowed) = (Instant::now(), allowed.clone());
            let is_due = move |index: usize| match pace {
                Pace::PerSecond(rate) => start.elapsed().as_secs_f64() * rate >= index as f64,
                Pace::OnDemand => allowed.load(Ordering::Acquire) > index,
            };
            move || {
                let mut times = Vec::new();
                let played = play(&frames, &is_due, &stop, &played_count, &mut times);
                if let (Err(error), Ok(mut failure)) = (played, failure.lock()) {
                    *failure = Some(format!("{error:#}"));
                }
                times
            }
        });
        let player = Self { stop, allowed, played_count, failure, thread };
        player.wait_for(1)?;
        Ok(player)
    }

    /// Shows the next picture and returns when it is on its way, with the time of that.
    ///
    /// # Errors
    /// When playing ended before.
    pub fn advance(&self) -> Result<f64> {
        let count = self.allowed.fetch_add(1, Ordering::AcqRel) + 1;
        self.wait_for(count)?;
        now()
    }

    /// Waits until so many pictures were played.
    ///
    /// # Errors
    /// When playing ended before.
    pub fn wait_for(&self, count: usize) -> Result<()> {
        while self.played_count.load(Ordering::Acquire) < count {
            if self.thread.is_finished() {
                let played_count = self.played_count.load(Ordering::Acquire);
                return Err(anyhow!(
                    "the player ended after {played_count} pictures: {:?}",
                    self.failure.lock()
                ));
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
    is_due: &dyn Fn(usize) -> bool,
    stop: &AtomicBool,
    played_count: &AtomicUsize,
    times: &mut Vec<f64>,
) -> Result<()> {
    let mut stream = Stream::start(OUTPUT, frames.first().context("no pictures to play")?)?;
    for (index, frame) in frames.iter().enumerate() {
        while !is_due(index) && !stop.load(Ordering::Acquire) {
            thread::sleep(Duration::from_millis(2));
        }
        if stop.load(Ordering::Acquire) {
            break;
        }
        stream.show(frame)?;
        times.push(now()?);
        played_count.fetch_add(1, Ordering::Release);
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
