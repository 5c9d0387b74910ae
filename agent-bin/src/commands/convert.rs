//! `loopbox convert`: a recording into another form.

use crate::console::{say, tell, warning};
use crate::interrupt::stop_on_ctrl_c;
use crate::progress::frame_bar;
use anyhow::{Result, bail};
use clap::Args;
use sources::Stop;
use sources::convert::{Draft, Kind};
use sources::correction::CameraOptions;
use sources::recording::{CalibrationFiles, Head, encode};
use sources::{FrameSource, SourceInfo, SourceOptions, time};
use std::path::PathBuf;

/// Turn a recording into an MCAP file, a ROS 1 bag, a video or a folder of images
#[derive(Args, Debug)]
pub struct ConvertArgs {
    /// The recording: a folder of images, an MCAP file, a ROS 2 or ROS 1 bag, or a video file
    source: PathBuf,
    /// What to make: .mcap, .bag, .avi, .mkv or .mp4 says which; any other name is a folder
    out: PathBuf,
    /// Replace what is there
    #[arg(short, long)]
    force: bool,
    /// Camera calibration to go with it, instead of the recording's own
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// Frames per second of images without time stamps, and of a video to make
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Topic of an MCAP file or a bag with several
    #[arg(long)]
    topic: Option<String>,
    /// Also take frames that the recorded run dropped
    #[arg(long)]
    all_frames: bool,
    /// Show no progress and no summary
    #[arg(short, long)]
    quiet: bool,
}

/// What became of the frames.
#[derive(Default)]
struct Counts {
    written: u64,
    unreadable: u64,
    first_reason: Option<String>,
}

/// Converts.
///
/// # Errors
/// When the recording cannot be read, or the other cannot be written; then nothing of it is left.
pub fn execute(args: &ConvertArgs) -> Result<()> {
    let kind = Kind::of(&args.out)?;
    let options = SourceOptions { fps: args.fps, topic: args.topic.clone(), all_frames: args.all_frames };
    let mut source = sources::open(&args.source, &options)?;
    let info = source.info().clone();
    args.check_place(&info)?;
    let camera = CameraOptions { calibration: args.calib.clone(), ..CameraOptions::default() };
    let calibration = CalibrationFiles::gather(&camera, &info)?;
    let lost = kind.loses(&calibration);
    let head = Head::new(&info, calibration);
    let stop = stop_on_ctrl_c("stopping: nothing is written (Ctrl-C again to abort)")?;
    let mut draft = Draft::begin(&args.out, &head, args.fps.or(rate(&info)))?;
    let counts = args.copy(source.as_mut(), &mut draft, &stop)?;
    if stop.requested() {
        bail!("interrupted: nothing was written");
    }
    if counts.written == 0 {
        let reason = counts.first_reason.unwrap_or_else(|| "there are no frames".into());
        bail!("{}: there is no frame to write: {reason}", args.source.display());
    }
    if args.force {
        args.make_room(kind)?;
    }
    draft.finish(&head.calibration)?;
    if let Some(warning) = source.warning() {
        warning!("{warning}");
    }
    if let Some(reason) = &counts.first_reason {
        warning!("{} frames have no readable image and are left out: {reason}", counts.unreadable);
    }
    if !args.quiet {
        lost.iter().for_each(|text| tell!("note: {text}"));
        say!("{} frames written to {}", counts.written, args.out.display());
    }
    Ok(())
}

/// Frames per second, where the source can tell.
fn rate(info: &SourceInfo) -> Option<f64> {
    let (count, duration) = (info.frame_count?, info.duration?);
    (count > 1 && duration > 0.0).then(|| (count - 1) as f64 / duration)
}

impl ConvertArgs {
    /// Refuses to write over anything unasked, and over what is read at all.
    fn check_place(&self, info: &SourceInfo) -> Result<()> {
        let Ok(there) = self.out.canonicalize() else { return Ok(()) };
        if info.path.canonicalize().is_ok_and(|source| source.starts_with(&there)) {
            bail!("{}: this is what is read\nhint: name another place", self.out.display());
        }
        if !self.force {
            bail!(
                "{}: there is something already\nhint: name another place, or replace it with --force",
                self.out.display()
            );
        }
        if there.is_dir() && !there.join("times.txt").is_file() {
            bail!(
                "{}: this folder is no recording and is not replaced\nhint: name another",
                self.out.display()
            );
        }
        Ok(())
    }

    /// Removes what is replaced: for a folder, only once all else is done.
    fn make_room(&self, kind: Kind) -> Result<()> {
        if kind == Kind::Folder && self.out.is_dir() {
            return Ok(std::fs::remove_dir_all(&self.out)?);
        }
        if self.out.is_dir() || self.out.exists() && kind == Kind::Folder {
            bail!(
                "{}: it is of another kind and is not replaced\nhint: name another place",
                self.out.display()
            );
        }
        Ok(())
    }

    fn copy(&self, source: &mut dyn FrameSource, draft: &mut Draft, stop: &Stop) -> Result<Counts> {
        let bar = frame_bar(self.quiet, source.info().frame_count);
        let mut counts = Counts::default();
        while !stop.requested() {
            let Some(frame) = source.next_frame() else { break };
            bar.inc(1);
            match encode(frame.picture) {
                Ok(picture) => {
                    draft.frame(frame.index, time::on_grid(frame.timestamp), picture)?;
                    counts.written += 1;
                }
                Err(reason) => {
                    counts.unreadable += 1;
                    counts.first_reason.get_or_insert(reason);
                }
            }
        }
        bar.finish_and_clear();
        Ok(counts)
    }
}
