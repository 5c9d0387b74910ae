//! Video files, through the system's OpenCV.

use super::image_list::first_existing;
use super::{FoundCalibration, FrameSource, SourceFrame, SourceInfo, quicktime};
use crate::pictures::{Picture, RawPicture, StatedFocal};
use anyhow::{Context, Result, anyhow, bail};
use geometry::limits::check_image_size;
use opencv::core::Mat;
use opencv::prelude::*;
use opencv::videoio::{
    CAP_FFMPEG, CAP_OPENCV_MJPEG, CAP_PROP_FPS, CAP_PROP_FRAME_COUNT, CAP_PROP_FRAME_HEIGHT,
    CAP_PROP_FRAME_WIDTH, CAP_PROP_POS_MSEC, VideoCapture,
};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Named, because left to itself OpenCV would also try GStreamer, whose complaints about files that are
/// no videos fill the terminal.
const BACKENDS: [i32; 2] = [CAP_FFMPEG, CAP_OPENCV_MJPEG];

/// A video file.
pub struct Video {
    info: SourceInfo,
    capture: VideoCapture,
    frame: Mat,
    next_index: u64,
    /// Where given, frames are timed by it and not by the file.
    fps: Option<f64>,
    nominal_fps: Option<f64>,
}

/// Opens a video file.
///
/// # Errors
/// When OpenCV cannot read it.
pub fn open(path: &Path, fps: Option<f64>) -> Result<Video> {
    if is_text(path)? {
        bail!(
            "{}: this is text, not a recording\nhint: `loopbox eval` compares trajectories; a recording is a folder of images, an MCAP \
             file, a ROS 1 bag or a video",
            path.display()
        );
    }
    let name = path.to_str().with_context(|| format!("{}: the name is not UTF-8", path.display()))?;
    let Some(capture) = BACKENDS.iter().find_map(|&backend| opened(name, backend)) else {
        bail!(
            "{}: neither an MCAP file nor a video that OpenCV can read\nhint: give a folder of images, an MCAP \
             file, or a video such as MP4 or AVI",
            path.display()
        );
    };
    let property = |id| capture.get(id).ok().filter(|value| value.is_finite() && *value > 0.0);
    let side = |id| property(id).map_or(0, |side| side as usize);
    if let (width @ 1.., height @ 1..) = (side(CAP_PROP_FRAME_WIDTH), side(CAP_PROP_FRAME_HEIGHT)) {
        check_image_size(width, height).map_err(|what| anyhow!("{}: {what}", path.display()))?;
    }
    let frame_count = property(CAP_PROP_FRAME_COUNT).map(|count| count as u64);
    let nominal_fps = property(CAP_PROP_FPS);
    let rate = fps.or(nominal_fps);
    let info = SourceInfo {
        kind: "video file",
        path: path.to_owned(),
        frame_count,
        duration: frame_count.zip(rate).map(|(count, rate)| count.saturating_sub(1) as f64 / rate),
        calibration: calibration_beside(path),
        lag: None,
    };
    Ok(Video { info, capture, frame: Mat::default(), next_index: 0, fps, nominal_fps })
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

fn opened(name: &str, backend: i32) -> Option<VideoCapture> {
    let capture = VideoCapture::from_file(name, backend).ok()?;
    capture.is_opened().unwrap_or(false).then_some(capture)
}

/// `walk.yaml` beside `walk.mp4`.
fn calibration_beside(path: &Path) -> Option<FoundCalibration> {
    let stem = path.file_stem()?.to_str()?;
    first_existing(path.parent()?, &[&format!("{stem}.yaml")]).map(FoundCalibration::File)
}

impl Video {
    /// Seconds of the frame just read.
    fn time(&self, index: u64) -> f64 {
        let milliseconds = self.capture.get(CAP_PROP_POS_MSEC).unwrap_or(0.0);
        match (self.fps, self.nominal_fps) {
            (Some(fps), _) => index as f64 / fps,
            // Some forms have no time stamps; then the nominal rate must do.
            (None, Some(fps)) if milliseconds == 0.0 => index as f64 / fps,
            _ => milliseconds * 1e-3,
        }
    }

    fn picture(&self) -> Result<Picture, opencv::Error> {
        let size = self.frame.size()?;
        let encoding = if self.frame.channels() == 1 { "mono8" } else { "bgr8" };
        Ok(Picture::Raw(RawPicture {
            width: size.width as usize,
            height: size.height as usize,
            step: self.frame.step1(0)? * self.frame.elem_size1(),
            encoding: encoding.to_owned(),
            big_endian: false,
            data: self.frame.data_bytes()?.to_vec(),
        }))
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
        if !self.capture.read(&mut self.frame).unwrap_or(false) {
            return None;
        }
        let index = self.next_index;
        self.next_index += 1;
        let timestamp = self.time(index);
        let picture = self.picture().unwrap_or_else(|error| Picture::Broken(error.to_string()));
        Some(SourceFrame { index, timestamp, captured: None, picture })
    }
}
