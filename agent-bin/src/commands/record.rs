//! `loopbox record`: a source into an MCAP file, without tracking it.

use crate::console::{say, tell, warning};
use crate::interrupt::stop_on_ctrl_c;
use crate::progress::frame_bar;
use anyhow::{Context, Result, bail};
use clap::Args;
use sources::Stop;
use sources::camera::{CameraArgs, open_camera};
use sources::correction::CameraOptions;
use sources::recording::{CalibrationFiles, Head, Recorder, check_name, refuse_existing};
use sources::{FrameSource, SourceOptions, time};
use std::path::{Path, PathBuf};

/// Record a camera or any recording into an MCAP file
#[derive(Args, Debug)]
pub struct RecordArgs {
    /// The recording: a folder of images, an MCAP file, a ROS 2 or ROS 1 bag, or a video file
    #[arg(conflicts_with = "camera")]
    source: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraArgs,
    /// The MCAP file to make
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Replace the file if it is there
    #[arg(short, long)]
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
    /// Topic of an MCAP file or a bag with several
    #[arg(long)]
    topic: Option<String>,
    /// Show no progress and no summary
    #[arg(short, long)]
    quiet: bool,
}

/// Records.
///
/// # Errors
/// When the source cannot be opened, or the file is there already or cannot be written.
pub fn execute(args: &RecordArgs) -> Result<()> {
    args.camera.check()?;
    check_name(&args.out)?;
    if !args.force {
        refuse_existing(&args.out).map_err(|error| error.context("the recording is not begun"))?;
    }
    let mut source = args.open()?;
    let options = CameraOptions {
        calibration: args.calib.clone(),
        response: args.response.clone(),
        vignette: args.vignette.clone(),
        ..CameraOptions::default()
    };
    let calibration = CalibrationFiles::gather(&options, source.info())?;
    if calibration.camera.is_none() && !args.quiet {
        warning!("no calibration goes into the recording: a run over it will need --calib");
    }
    let head = Head::new(source.info(), calibration);
    if args.force {
        remove(&args.out, &source.info().path)?;
    }
    let stop = stop_on_ctrl_c("stopping: ending the recording (Ctrl-C again to abort)")?;
    let recorder = Recorder::idle();
    recorder.start(&args.out, &head)?;
    source.listen(Box::new(|notice| tell!("{}", notice.text())));
    let stopper = source.stopper();
    stop.while_waiting(stopper, || copy(source.as_mut(), &recorder, args, &stop));
    let summary = recorder.stop()?;
    if let Some(warning) = source.warning() {
        warning!("{warning}");
    }
    if summary.frames == 0 {
        let failure = source.failure().map(|failure| format!(": {failure}")).unwrap_or_default();
        bail!("{}: there was no frame to record{failure}", source.info().path.display());
    }
    if !args.quiet {
        say!("{}", summary.text());
    }
    match source.failure() {
        Some(failure) => bail!("the recording ended early, what was captured is in it: {failure}"),
        None => Ok(()),
    }
}

impl RecordArgs {
    /// Where the frames come from.
    fn open(&self) -> Result<Box<dyn FrameSource>> {
        let Some(source) = &self.source else {
            self.camera.needed()?;
            return open_camera(&self.camera);
        };
        self.camera.not_needed()?;
        let (fps, topic) = (self.camera.fps, self.topic.clone());
        sources::open(source, &SourceOptions { fps, topic, all_frames: true })
    }
}

/// Hands every frame to the recorder until the source ends or the user stops it.
fn copy(source: &mut dyn FrameSource, recorder: &Recorder, args: &RecordArgs, stop: &Stop) {
    let bar = frame_bar(args.quiet, source.info().frame_count);
    let is_live = source.is_live();
    let mut first = None;
    while !stop.requested() {
        let Some(mut frame) = source.next_frame() else { break };
        frame.timestamp = time::on_grid(frame.timestamp);
        let since_first = frame.timestamp - *first.get_or_insert(frame.timestamp);
        if args.camera.duration.is_some_and(|duration| since_first > duration) {
            break;
        }
        if is_live {
            recorder.frame(&frame);
        } else {
            recorder.frame_waiting(&frame);
        }
        bar.inc(1);
        if let Some(warning) = recorder.take_warning() {
            bar.suspend(|| warning!("{warning}"));
            if recorder.has_failed() {
                break;
            }
        }
    }
    bar.finish_and_clear();
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
