//! `loopbox record`: a source into an MCAP file, without tracking it.

use crate::camera::CameraOptions;
use crate::progress::frame_bar;
use crate::recording::{CalibrationFiles, Head, Recorder, refuse_existing};
use crate::runtime::Stop;
use crate::sources::{self, FrameSource, SourceOptions, time};
use anyhow::{Context, Result, bail};
use clap::Args;
use std::path::{Path, PathBuf};

/// Record a camera or any recording into an MCAP file
#[derive(Args, Debug)]
pub struct RecordArgs {
    /// The recording: a folder of images, an MCAP file, a ROS 1 bag or a video file
    source: PathBuf,
    /// The MCAP file to make
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace the file if it is there
    #[arg(long)]
    force: bool,
    /// Camera calibration to put into it
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// Inverse response of the sensor to put into it
    #[arg(long, value_name = "FILE")]
    response: Option<PathBuf>,
    /// Vignette of the lens to put into it
    #[arg(long, value_name = "FILE")]
    vignette: Option<PathBuf>,
    /// End after so many seconds of the source's time
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Frames per second of images without time stamps
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Topic of an MCAP file or a bag with several
    #[arg(long)]
    topic: Option<String>,
    /// Show no progress and no summary
    #[arg(long)]
    quiet: bool,
}

/// Records.
///
/// # Errors
/// When the source cannot be opened, or the file is there already or cannot be written.
pub fn execute(args: &RecordArgs) -> Result<()> {
    if let Some(bad) = args.duration.filter(|seconds| !(seconds.is_finite() && *seconds > 0.0)) {
        bail!("--duration {bad} is not a time\nhint: give seconds, such as --duration 60");
    }
    if !args.force {
        refuse_existing(&args.out).map_err(|error| error.context("the recording is not begun"))?;
    }
    let source = args.open()?;
    let options = CameraOptions {
        calibration: args.calib.clone(),
        response: args.response.clone(),
        vignette: args.vignette.clone(),
    };
    let calibration = CalibrationFiles::gather(&options, source.info())?;
    if calibration.camera.is_none() && !args.quiet {
        eprintln!("warning: no calibration goes into the recording: a run over it will need --calib");
    }
    let head = Head::new(source.info(), calibration);
    if args.force {
        remove(&args.out, &source.info().path)?;
    }
    let stop = Stop::on_ctrl_c("stopping: ending the recording (Ctrl-C again to abort)")?;
    let recorder = Recorder::idle();
    recorder.start(&args.out, &head)?;
    let warning = copy(source, &recorder, args, &stop);
    let summary = recorder.stop()?;
    if let Some(warning) = warning {
        eprintln!("warning: {warning}");
    }
    if summary.frames == 0 {
        bail!("{}: there was no frame to record", args.source.display());
    }
    if !args.quiet {
        println!("{}", summary.text());
    }
    Ok(())
}

impl RecordArgs {
    /// Where the frames come from.
    fn open(&self) -> Result<Box<dyn FrameSource>> {
        let options = SourceOptions { fps: self.fps, topic: self.topic.clone(), all_frames: true };
        sources::open(&self.source, &options)
    }
}

/// Hands every frame to the recorder until the source ends or the user stops it; the source's warning.
fn copy(
    mut source: Box<dyn FrameSource>,
    recorder: &Recorder,
    args: &RecordArgs,
    stop: &Stop,
) -> Option<String> {
    let bar = frame_bar(args.quiet, source.info().frame_count);
    let mut first = None;
    while !stop.requested() {
        let Some(mut frame) = source.next_frame() else { break };
        frame.timestamp = time::on_grid(frame.timestamp);
        let since_first = frame.timestamp - *first.get_or_insert(frame.timestamp);
        if args.duration.is_some_and(|duration| since_first > duration) {
            break;
        }
        recorder.frame_waiting(&frame);
        bar.inc(1);
        if let Some(warning) = recorder.take_warning() {
            bar.suspend(|| eprintln!("warning: {warning}"));
            if recorder.has_failed() {
                break;
            }
        }
    }
    bar.finish_and_clear();
    source.warning()
}

/// Removes what is to be replaced, unless it is what is read.
fn remove(out: &Path, source: &Path) -> Result<()> {
    let (Ok(out_file), source_file) = (out.canonicalize(), source.canonicalize()) else { return Ok(()) };
    if source_file.is_ok_and(|source| source.starts_with(&out_file)) {
        bail!("{}: this is what is read\nhint: name another --out", out.display());
    }
    if out.is_dir() {
        bail!("{}: this is a folder\nhint: name a file", out.display());
    }
    std::fs::remove_file(out).with_context(|| format!("{}: cannot be replaced", out.display()))
}
