//! Frames of a video, decoded by `ffmpeg` in a process of its own.
//!
//! Raw pixels come through its standard output. Their time stamps come through its log: the filter `showinfo` prints
//! a line for each frame before the frame itself is written. So both are in one order, and the stamps are the file's
//! own.

use super::log::{Line, LoggedFrame};
use super::probe::Probe;
use crate::ffmpeg::{self, Running};
use crate::pictures::RawPicture;
use anyhow::{Context, Result, bail};
use geometry::limits::check_image_size;
use std::io::Read;
use std::path::Path;
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread::{self, JoinHandle};

/// Complaints about a file that are kept; damaged files have one for every frame.
const MAX_TROUBLES: usize = 3;

/// A file being decoded.
pub struct Decoder {
    running: Running,
    pixels: ChildStdout,
    lines: Receiver<Line>,
    log: Option<JoinHandle<()>>,
    grey: bool,
    /// The stream's first time stamp, seconds.
    start: f64,
    /// As the log states it, which may be another than the file's.
    time_base: (i64, i64),
    troubles: Vec<String>,
}

impl Decoder {
    /// Begins to decode a file.
    ///
    /// # Errors
    /// When `ffmpeg` is not installed.
    pub fn start(path: &Path, probe: &Probe) -> Result<Self> {
        let mut command = quiet();
        command.args(["-protocol_whitelist", "file,pipe", "-copyts", "-i"]).arg(ffmpeg::file_name(path));
        let start = seconds(probe.start, probe.time_base);
        Self::run(command, probe.grey, (start, probe.time_base))
    }

    /// Begins to decode a stream in IVF that `feed` writes in a thread of its own; its ticks are seconds.
    ///
    /// # Errors
    /// When `ffmpeg` is not installed.
    pub fn of_packets(decoder: &str, feed: impl FnOnce(ChildStdin) + Send + 'static) -> Result<Self> {
        let mut command = quiet();
        command.args(["-protocol_whitelist", "pipe", "-copyts", "-flags:v", "-output_corrupt"]);
        command.args(["-c:v", decoder, "-f", "ivf", "-i", "pipe:0"]).stdin(Stdio::piped());
        let mut decoder = Self::run(command, false, (0.0, (1, 1)))?;
        let to = decoder.running.child().stdin.take().context("ffmpeg takes no input")?;
        thread::spawn(move || feed(to));
        Ok(decoder)
    }

    fn run(mut command: Command, grey: bool, (start, time_base): (f64, (i64, i64))) -> Result<Self> {
        let format = if grey { "gray" } else { "bgr24" };
        command.args(["-map", "0:V:0", "-vf", &format!("format={format},showinfo=checksum=0")]);
        command.args(all_frames()?).args(["-c:v", "rawvideo", "-f", "rawvideo", "pipe:1"]);
        let mut running = Running::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()))?;
        let child = running.child();
        let (Some(pixels), Some(log)) = (child.stdout.take(), child.stderr.take()) else {
            bail!("ffmpeg gives no output");
        };
        let (sender, lines) = mpsc::channel();
        let log = ffmpeg::follow(log, move |line| {
            // Without a receiver nobody reads the frames either, and ffmpeg is about to be ended.
            let _ = Line::of(line).map(|line| sender.send(line));
        });
        Ok(Self { running, pixels, lines, log: Some(log), grey, start, time_base, troubles: Vec::new() })
    }

    /// The next frame, with its seconds since the stream's start where it has a time stamp; `None` at the end.
    ///
    /// # Errors
    /// When the file ends in a frame, or `ffmpeg` gives up.
    pub fn next(&mut self) -> Result<Option<(Option<f64>, RawPicture)>> {
        let Some(logged) = self.next_logged() else { return self.ended().map(|()| None) };
        let (width, height) = logged.size;
        check_image_size(width, height).map_err(anyhow::Error::msg)?;
        let (step, encoding) = if self.grey { (width, "mono8") } else { (3 * width, "bgr8") };
        let mut data = vec![0; step * height];
        if self.pixels.read_exact(&mut data).is_err() {
            return self.ended().map(|()| None);
        }
        let time = logged.ticks.map(|ticks| seconds(ticks, self.time_base) - self.start);
        let encoding = encoding.to_owned();
        Ok(Some((time, RawPicture { width, height, step, encoding, big_endian: false, data })))
    }

    /// The problems of the file so far, in `ffmpeg`'s words.
    pub fn troubles(&self) -> &[String] {
        &self.troubles
    }

    /// The next frame's line.
    fn next_logged(&mut self) -> Option<LoggedFrame> {
        loop {
            match self.lines.recv().ok()? {
                Line::Frame(logged) => return Some(logged),
                Line::TimeBase(base) => self.time_base = base,
                Line::Trouble(text) => self.note(text),
            }
        }
    }

    fn note(&mut self, trouble: String) {
        if self.troubles.len() < MAX_TROUBLES && !self.troubles.contains(&trouble) {
            self.troubles.push(trouble);
        }
    }

    /// How it ended, once there are no more frames.
    fn ended(&mut self) -> Result<()> {
        let status = self.running.wait()?;
        if let Some(log) = self.log.take()
            && log.join().is_err()
        {
            bail!("ffmpeg's log cannot be read");
        }
        while let Ok(line) = self.lines.try_recv() {
            if let Line::Trouble(text) = line {
                self.note(text);
            }
        }
        if !status.success() {
            bail!("ffmpeg gave up: {}", self.troubles.last().map_or("it does not say why", String::as_str));
        }
        Ok(())
    }
}

/// `ffmpeg` with a log of one line for each thing.
fn quiet() -> Command {
    let mut command = ffmpeg::command("ffmpeg");
    command.args(["-nostdin", "-nostats", "-loglevel", "repeat+level+info"]);
    command
}

fn seconds(ticks: i64, (n, d): (i64, i64)) -> f64 {
    (i128::from(ticks) * i128::from(n)) as f64 / d as f64
}

/// The option that keeps every frame as it is, neither doubled nor dropped to reach an even rate.
fn all_frames() -> Result<[&'static str; 2]> {
    Ok(every_frame_of(&ffmpeg::version_text("ffmpeg").context("`ffmpeg -version` fails")?))
}

/// That option by what `ffmpeg -version` says: it is called `-fps_mode` since 5.1.
fn every_frame_of(version_text: &str) -> [&'static str; 2] {
    let version = version_text.split_whitespace().nth(2).unwrap_or_default().trim_start_matches('n');
    let mut numbers = version.split(|c: char| !c.is_ascii_digit()).map(|number| number.parse::<u32>().ok());
    match (numbers.next().flatten(), numbers.next().flatten()) {
        (Some(major), minor) if (major, minor.unwrap_or(0)) < (5, 1) => ["-vsync", "0"],
        _ => ["-fps_mode", "passthrough"],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_option_for_all_frames_depends_on_the_version() {
        for (version, option) in [
            ("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", "-vsync"),
            ("ffmpeg version 5.0.1 Copyright", "-vsync"),
            ("ffmpeg version 5.1.9-0+deb12u1 Copyright", "-fps_mode"),
            ("ffmpeg version n7.1 Copyright", "-fps_mode"),
            ("ffmpeg version N-118000-gabc Copyright", "-fps_mode"),
        ] {
            assert_eq!(every_frame_of(version)[0], option, "{version}");
        }
    }

    #[test]
    fn ticks_become_seconds() {
        assert_eq!(seconds(3584, (1, 15360)), 3584.0 / 15360.0);
        assert_eq!(seconds(i64::MAX, (1, 1)), i64::MAX as f64);
    }
}
