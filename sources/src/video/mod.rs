//! Video, in files and in messages, through the system's `ffmpeg`.

mod decoder;
mod log;
mod packets;
mod probe;
mod quicktime;
mod topic;

pub use topic::TopicVideo;

use crate::image_list::first_existing;
use crate::pictures::{Picture, StatedFocal};
use crate::{FoundCalibration, FrameSource, SourceFrame, SourceInfo};
use anyhow::{Context, Result, anyhow, bail};
use decoder::Decoder;
use geometry::limits::check_image_size;
use probe::{Probe, probe};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A video file.
pub struct Video {
    info: SourceInfo,
    probe: Probe,
    decoder: Decoder,
    next_index: u64,
    /// Where given, frames are timed by it and not by the file.
    fps: Option<f64>,
    /// Why the frames ended before the file did.
    failure: Option<String>,
}

/// Opens a video file.
///
/// # Errors
/// When it is none, or `ffmpeg` is not installed or cannot read it.
pub fn open(path: &Path, fps: Option<f64>) -> Result<Video> {
    if is_text(path)? {
        bail!(
            "{}: this is text, not a recording\nhint: `loopbox eval` compares trajectories; a recording is a folder of images, an MCAP \
             file, a ROS bag or a video",
            path.display()
        );
    }
    let probe = probe(path).map_err(|error| not_read(path, &error))?;
    let (width, height) = probe.size;
    check_image_size(width, height).map_err(|what| anyhow!("{}: {what}", path.display()))?;
    let rate = fps.or(probe.rate);
    let info = SourceInfo {
        kind: "video file",
        path: path.to_owned(),
        frame_count: probe.frames,
        duration: probe.frames.zip(rate).map(|(count, rate)| count.saturating_sub(1) as f64 / rate),
        calibration: sidecar_calibration(path),
        camera: calib::CameraHint::default(),
        lag: None,
    };
    let decoder = Decoder::start(path, &probe).map_err(|error| not_read(path, &error))?;
    Ok(Video { info, probe, decoder, next_index: 0, fps, failure: None })
}

/// Says of a file that it is no recording, or none that can be read here.
fn not_read(path: &Path, reason: &anyhow::Error) -> anyhow::Error {
    let reason = format!("{reason:#}");
    let hint = "hint: give a folder of images, an MCAP file, a ROS bag, or a video such as MP4 or AVI";
    let hint = if reason.contains("hint:") { String::new() } else { format!("\n{hint}") };
    anyhow!("{}: neither an MCAP file nor a video that ffmpeg can read: {reason}{hint}", path.display())
}

/// Whether a file is text: FFmpeg would draw it, and that would be a video.
fn is_text(path: &Path) -> Result<bool> {
    let file = File::open(path).with_context(|| format!("{}: cannot be opened", path.display()))?;
    let mut head = Vec::new();
    file.take(512).read_to_end(&mut head).with_context(|| format!("{}: cannot be read", path.display()))?;
    // Raw video in YUV4MPEG begins with a line of text.
    let printable = |b: &u8| (b' '..=b'~').contains(b) || b"\t\r\n".contains(b) || *b >= 0x80;
    Ok(!head.is_empty() && head.iter().all(printable) && !head.starts_with(b"YUV4MPEG2"))
}

/// `walk.yaml` beside `walk.mp4`.
fn sidecar_calibration(path: &Path) -> Option<FoundCalibration> {
    let stem = path.file_stem()?.to_str()?;
    first_existing(path.parent()?, &[&format!("{stem}.yaml")]).map(FoundCalibration::File)
}

impl Video {
    /// The next frame; `None` at the end.
    fn frame(&mut self) -> Result<Option<SourceFrame>> {
        let Some((stamp, picture)) = self.decoder.next()? else { return Ok(None) };
        let index = self.next_index;
        // Some forms have no time stamps; then the file's own rate must do.
        let by_rate = || self.probe.rate.map(|rate| index as f64 / rate);
        let Some(timestamp) = self.fps.map(|fps| index as f64 / fps).or(stamp).or_else(by_rate) else {
            bail!("its frames have no time stamps\nhint: give their rate, such as --fps 30");
        };
        self.next_index += 1;
        Ok(Some(SourceFrame { index, timestamp, captured: None, picture: Picture::Raw(picture) }))
    }
}

impl FrameSource for Video {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn stated_focal(&self, size: (usize, usize)) -> Option<StatedFocal> {
        let mm = quicktime::focal_on_film(&self.info.path)?;
        Some(StatedFocal::of_film(mm, size, "video's metadata"))
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if self.failure.is_some() {
            return None;
        }
        self.frame().unwrap_or_else(|error| {
            self.failure = Some(format!("{error:#}"));
            None
        })
    }

    fn decodes(&self) -> bool {
        true
    }

    fn warning(&self) -> Option<String> {
        let path = self.info.path.display();
        if let Some(failure) = &self.failure {
            return Some(format!("{path}: the video ends after {} frames: {failure}", self.next_index));
        }
        let troubles = self.decoder.troubles();
        (!troubles.is_empty())
            .then(|| format!("{path}: parts of the video are damaged: {}", troubles.join("; ")))
    }
}
