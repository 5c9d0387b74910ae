//! Frames as loopbox's source delivers them.

use super::pattern;
use crate::driver::{self, CAPTURE, Mode};
use crate::layout::FORMATS;
use crate::player::{Pace, Player};
use anyhow::{Context, Result, anyhow, ensure};
use sources::camera::args::{Lockable, RequestedFormat};
use sources::camera::format::Size;
use sources::camera::{CameraArgs, open_camera};
use sources::{FrameSource, SourceFrame};
use std::thread;
use std::time::Duration;

/// The camera in a mode of the driver.
fn camera(mode: &Mode, lock: Vec<Lockable>) -> Result<Box<dyn FrameSource>> {
    let format: RequestedFormat = mode.format.parse().map_err(|problem: String| anyhow!(problem))?;
    let mut source = open_camera(&CameraArgs {
        camera: Some(CAPTURE.into()),
        size: Some(Size { width: mode.width, height: mode.height }),
        format,
        lock,
        ..CameraArgs::default()
    })?;
    source.listen(Box::new(|_| {}));
    Ok(source)
}

fn next(source: &mut dyn FrameSource) -> Result<SourceFrame> {
    source.next_frame().with_context(|| format!("the frames end: {:?}", source.failure()))
}

/// Plays a picture in each format; what is captured must be that picture, level by level.
pub fn every_format() -> Result<String> {
    for format in FORMATS {
        let mode = Mode { format, ..Mode::USUAL };
        let picture = pattern(mode.width, mode.height, 1);
        let player = Player::start(std::slice::from_ref(&picture), &mode, Pace::OnDemand)?;
        let mut source = camera(&mode, Vec::new())?;
        // The first frames may still show what was there before.
        let frames = (0..5).map(|_| next(&mut *source)).collect::<Result<Vec<_>>>()?;
        let rising = frames.windows(2).all(|pair| pair[0].timestamp < pair[1].timestamp);
        ensure!(rising, "{format}: time stamps do not grow");
        drop(source);
        player.stop()?;
        let last = frames.into_iter().next_back().context("no frame")?;
        let grey = last.picture.into_grey().map_err(|problem| anyhow!("{format}: {problem}"))?;
        let differ = grey.data().iter().zip(picture.as_raw()).filter(|(a, b)| a != b).count();
        ensure!(grey.data().len() == picture.as_raw().len(), "{format}: another size");
        ensure!(differ == 0, "{format}: {differ} pixels differ from what was played");
    }
    Ok(format!("{}; the driver makes no MJPEG", FORMATS.join(" ")))
}

/// Leaves the frames of a second unread.
pub fn stalled_reader() -> Result<String> {
    let mode = Mode::USUAL;
    let player = Player::start(&[pattern(mode.width, mode.height, 2)], &mode, Pace::OnDemand)?;
    let mut source = camera(&mode, Vec::new())?;
    let before = next(&mut *source)?.timestamp;
    thread::sleep(Duration::from_secs(1));
    let mut after = before;
    for _ in 0..20 {
        after = next(&mut *source)?.timestamp;
    }
    let missed = source.missed();
    player.stop()?;
    // Every frame is either delivered or missed.
    let all = ((after - before) * mode.rate).round() as u64;
    ensure!(missed >= 15, "{missed} frames missed in a second without a reader");
    ensure!(all.abs_diff(missed + 20) <= 3, "{missed} missed and 20 delivered of {all}");
    Ok(format!("{missed} of {all}"))
}

/// The driver has an automatic gain, which wanders.
pub fn locks() -> Result<String> {
    const AUTOMATIC: &str = "Gain, Automatic";
    let mode = Mode::USUAL;
    let player = Player::start(&[pattern(mode.width, mode.height, 3)], &mode, Pace::OnDemand)?;
    let device = driver::open(CAPTURE)?;
    driver::set_control(&device, AUTOMATIC, 1)?;
    let mut source = camera(&mode, vec![Lockable::Gain])?;
    ensure!(driver::control(&device, AUTOMATIC)? == 0, "the gain is not locked");
    let gain = driver::control(&device, "Gain")?;
    for _ in 0..10 {
        next(&mut *source)?;
        let now = driver::control(&device, "Gain")?;
        ensure!(now == gain, "the gain went from {gain} to {now}");
    }
    drop(source);
    ensure!(driver::control(&device, AUTOMATIC)? == 1, "the automatic gain was not given back");
    player.stop()?;
    Ok("of what can be locked the driver has the gain".into())
}
