//! Video files, through the system's `ffmpeg`.

use super::Target;
use crate::ffmpeg::{self, Running};
use crate::pictures::Picture;
use crate::recording::EncodedPicture;
use anyhow::{Result, anyhow, bail};
use geometry::GrayImage;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// A video being written; it begins with the first frame, which has the size.
pub struct VideoTarget {
    path: PathBuf,
    rate: f64,
    encoder: Option<Encoder>,
}

/// `ffmpeg`, which frames of one size go to.
struct Encoder {
    running: Running,
    size: (usize, usize),
    log: JoinHandle<()>,
    last_words: Arc<Mutex<String>>,
}

impl VideoTarget {
    /// A video of `rate` frames per second.
    pub fn new(path: &Path, rate: f64) -> Self {
        Self { path: path.to_owned(), rate, encoder: None }
    }

    fn encoder(&mut self, size: (usize, usize)) -> Result<&mut Encoder> {
        let encoder = match self.encoder.take() {
            Some(encoder) => encoder,
            None => Encoder::start(&self.path, self.rate, size)?,
        };
        if encoder.size != size {
            bail!("its size is not that of the frames before, which a video needs");
        }
        Ok(self.encoder.insert(encoder))
    }
}

impl Encoder {
    fn start(path: &Path, rate: f64, (width, height): (usize, usize)) -> Result<Self> {
        let mut command = ffmpeg::command("ffmpeg");
        command.args(["-nostats", "-loglevel", "error", "-y", "-f", "rawvideo", "-pixel_format", "gray"]);
        command.args(["-video_size", &format!("{width}x{height}"), "-framerate", &rate.to_string()]);
        command.args(["-i", "pipe:0"]);
        if path.extension().is_some_and(|end| end.eq_ignore_ascii_case("mp4")) {
            // The quantiser's finest step but one: the finest is not kept by all encoders.
            command.args(["-c:v", "mpeg4", "-q:v", "2", "-pix_fmt", "yuv420p"]);
        } else {
            command.args(["-c:v", "ffv1", "-pix_fmt", "gray"]);
        }
        command
            .arg(ffmpeg::file_name(path))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut running = Running::start(&mut command)?;
        let Some(log) = running.child().stderr.take() else { bail!("ffmpeg gives no log") };
        let last_words = Arc::new(Mutex::new(String::new()));
        let keep = Arc::clone(&last_words);
        let log = ffmpeg::follow(log, move |line| {
            if !line.is_empty() {
                *keep.lock().unwrap_or_else(PoisonError::into_inner) = ffmpeg::reason(line);
            }
        });
        Ok(Self { running, size: (width, height), log, last_words })
    }

    /// Waits until the file is whole.
    fn finish(mut self) -> Result<()> {
        drop(self.running.child().stdin.take());
        let status = self.running.wait()?;
        if self.log.join().is_err() {
            bail!("ffmpeg's log cannot be read");
        }
        if !status.success() {
            let text = self.last_words.lock().unwrap_or_else(PoisonError::into_inner);
            bail!("ffmpeg cannot write this video: {text}");
        }
        Ok(())
    }
}

impl Target for VideoTarget {
    fn frame(&mut self, _index: u64, _timestamp: f64, picture: EncodedPicture) -> Result<()> {
        let image: GrayImage =
            Picture::Encoded(picture.bytes).into_grey().map_err(|reason| anyhow!(reason))?;
        let encoder = self.encoder((image.width(), image.height()))?;
        let Some(input) = &mut encoder.running.child().stdin else { bail!("ffmpeg takes no frames") };
        if input.write_all(image.data()).is_ok() {
            return Ok(());
        }
        // It has ended, and its log says why.
        match self.encoder.take().map(Encoder::finish) {
            Some(Err(error)) => Err(error),
            _ => bail!("ffmpeg ended before the video did"),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.encoder.take().map_or(Ok(()), Encoder::finish)
    }
}
