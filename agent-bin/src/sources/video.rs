//! Video files, through the system's OpenCV.

use super::image_list::first_existing;
use super::{FoundCalibration, FrameSource, SourceFrame, SourceInfo};
use crate::pictures::{Picture, RawPicture};
use anyhow::{Context, Result, bail};
use opencv::core::Mat;
use opencv::prelude::*;
use opencv::videoio::{CAP_ANY, CAP_PROP_FPS, CAP_PROP_FRAME_COUNT, CAP_PROP_POS_MSEC, VideoCapture};
use std::path::Path;

/// A video file.
pub struct Video {
    info: SourceInfo,
    capture: VideoCapture,
    frame: Mat,
    next_index: u64,
    /// Where given, frames are timed by it and not by the file.
    fps: Option<f64>,
}

/// Opens a video file.
///
/// # Errors
/// When OpenCV cannot read it.
pub fn open(path: &Path, fps: Option<f64>) -> Result<Video> {
    let name = path.to_str().with_context(|| format!("{}: the name is not UTF-8", path.display()))?;
    let capture = VideoCapture::from_file(name, CAP_ANY)
        .with_context(|| format!("{}: OpenCV cannot read it", path.display()))?;
    if !capture.is_opened().unwrap_or(false) {
        bail!(
            "{}: neither an MCAP file nor a video that OpenCV can read\nhint: give a folder of images, an MCAP \
             file, or a video such as MP4 or AVI",
            path.display()
        );
    }
    let property = |id| capture.get(id).ok().filter(|value| value.is_finite() && *value > 0.0);
    let frame_count = property(CAP_PROP_FRAME_COUNT).map(|count| count as u64);
    let fps = fps.or_else(|| times_are_missing(&capture).then(|| property(CAP_PROP_FPS)).flatten());
    let rate = fps.or(property(CAP_PROP_FPS));
    let info = SourceInfo {
        kind: "video file",
        path: path.to_owned(),
        frame_count,
        duration: frame_count.zip(rate).map(|(count, rate)| count.saturating_sub(1) as f64 / rate),
        calibration: calibration_beside(path),
    };
    Ok(Video { info, capture, frame: Mat::default(), next_index: 0, fps })
}

/// Whether the file's form has no time stamps, so that its nominal rate must do.
fn times_are_missing(capture: &VideoCapture) -> bool {
    capture.get(CAP_PROP_POS_MSEC).is_err()
}

/// `walk.yaml` beside `walk.mp4`.
fn calibration_beside(path: &Path) -> Option<FoundCalibration> {
    let stem = path.file_stem()?.to_str()?;
    first_existing(path.parent()?, &[&format!("{stem}.yaml")]).map(FoundCalibration::File)
}

impl Video {
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

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if !self.capture.read(&mut self.frame).unwrap_or(false) {
            return None;
        }
        let index = self.next_index;
        self.next_index += 1;
        let timestamp = match self.fps {
            Some(fps) => index as f64 / fps,
            None => self.capture.get(CAP_PROP_POS_MSEC).unwrap_or(f64::NAN) * 1e-3,
        };
        let picture = self.picture().unwrap_or_else(|error| Picture::Broken(error.to_string()));
        Some(SourceFrame { index, timestamp, picture })
    }
}
