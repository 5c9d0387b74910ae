//! `loopbox run`: tracks and maps a recording.

use super::params;
use super::watching::ViewArgs;
use crate::ahead::{Ahead, Pace, Preparation};
use crate::camera::{self, CameraOptions, ImageCorrection};
use crate::console::{Ended as EndedBy, Ending};
use crate::diagnosis::too_few_poses;
use crate::output::{Output, TrajectoryFormat};
use crate::progress::{Display, Progress};
use crate::recording::{CalibrationFiles, Head, RecordButton, Recorder, refuse_existing};
use crate::runtime::Stop;
use crate::saving::Form;
use crate::session::{Mapped, Session};
use crate::sources::camera::{CameraArgs, open_camera};
use crate::sources::{self, FrameSource, SourceInfo, SourceOptions};
use crate::watch::Ended;
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use map::AgentInfo;
use slam_direct::Params;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Arguments of `loopbox run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    /// The recording: a folder of images, an MCAP file, a ROS 1 bag or a video file
    #[arg(conflicts_with = "camera")]
    source: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraArgs,
    /// Camera calibration, if none came with the recording or another is wanted
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// Scale the calibration to the images, where they show the same at another size
    #[arg(long, conflicts_with = "camera")]
    scale_calib: bool,
    /// Inverse response of the sensor (256 numbers), to undo it
    #[arg(long, value_name = "FILE")]
    response: Option<PathBuf>,
    /// Vignette of the lens (grey image), to undo it
    #[arg(long, value_name = "FILE")]
    vignette: Option<PathBuf>,
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Replace results of another recording or of a merge in that folder, once the new ones are complete
    #[arg(long)]
    force: bool,
    /// Form of trajectory.txt
    #[arg(long, value_enum, value_name = "FORM", default_value_t = TrajectoryFormat::Tum)]
    trajectory: TrajectoryFormat,
    /// Leave out of cloud.ply points whose variance of inverse depth over its square is larger
    #[arg(long, value_name = "V", default_value_t = map::DEFAULT_MAX_RELATIVE_VARIANCE)]
    max_variance: f32,
    /// Parameter file (TOML); `loopbox params` prints the defaults
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    /// Play by the time stamps and drop frames when late
    #[arg(long, conflicts_with = "camera")]
    realtime: bool,
    /// With --realtime: how many times as fast as recorded
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "realtime")]
    speed: f64,
    /// Skip the first seconds of the recording
    #[arg(long, value_name = "SECONDS")]
    start: Option<f64>,
    /// Stop so many seconds into the recording
    #[arg(long, value_name = "SECONDS")]
    end: Option<f64>,
    /// Topic of an MCAP file or a bag with several
    #[arg(long)]
    topic: Option<String>,
    /// Also process frames that the run dropped when this recording was made
    #[arg(long)]
    all_frames: bool,
    /// Record what is captured in this MCAP file, from which the run can be replayed exactly
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Show no progress and no summary
    #[arg(long, conflicts_with = "log")]
    quiet: bool,
    /// Log events to standard output in this form
    #[arg(long, value_enum, value_name = "FORM")]
    log: Option<LogForm>,
    /// End with exit code 4 if a smaller share of the frames has a pose, 0 to 1; frames dropped late do not count
    #[arg(long, value_name = "SHARE")]
    min_tracked: Option<f64>,
    /// Threads for mapping; default: one per core. The result does not depend on it
    #[arg(long, value_name = "COUNT")]
    threads: Option<usize>,
    #[command(flatten)]
    view: ViewArgs,
}

/// Time that the mapping of a keyframe may take beside the tracking where frames come at their own time, seconds: two
/// keyframes' work on one slow core. More makes the map older that frames are tracked against.
const LIVE_LAG: f64 = 0.1;
/// The rate of a camera that does not tell it, frames a second.
const USUAL_RATE: f64 = 30.0;
/// The largest `mapping.lag`.
const MAX_LAG: usize = 10;

/// Forms of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum LogForm {
    /// One JSON object a line.
    Json,
}

/// Runs it.
///
/// # Errors
/// When the recording, calibration or parameters cannot be used, nothing could be tracked, or the
/// results cannot be written.
pub fn execute(args: &RunArgs) -> Result<()> {
    args.check()?;
    let params: Params = args.params.as_deref().map(params::read).transpose()?.unwrap_or_default();
    let source = args.open()?;
    let lag = args.lag(source.info(), params.mapping.lag);
    let info = SourceInfo { lag: (lag > 0).then_some(lag), ..source.info().clone() };
    let params = params.with_lag(lag);
    let options = CameraOptions { scale_to: args.scale_to()?, ..args.calibration() };
    let correction = camera::correction(&options, &info)?;
    let camera = correction.camera();
    let problems = source.problems().into_iter().chain(correction.problem());
    let problems: Vec<String> =
        problems.map(|problem| format!("{}: {problem}", info.path.display())).collect();
    let provenance = args.provenance(&info, &correction, &params);
    let name = recording_name(&info.path);
    let about = AgentInfo { provenance, ..AgentInfo::new(name, camera) };
    let output = Output::create(&args.out, about.clone(), &info.path, args.force)?;
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .context("cannot start threads")?;
    }
    let stop = Stop::on_ctrl_c("stopping: saving what was tracked so far (Ctrl-C again to abort)")?;
    let progress = Progress::new(args.display(), info.frame_count);
    problems.iter().for_each(|problem| progress.warn(problem));
    let head = Head::new(&info, CalibrationFiles::gather(&args.calibration(), &info)?);
    let recorder = Recorder::idle();
    if let Some(path) = &args.record {
        recorder.start(path, &head)?;
    }
    let preparation = Preparation::new(correction, args.start, args.end);
    let ahead = Ahead::start(source, preparation, args.pace(), recorder.clone())?;
    let mut watch =
        args.view.start(&about, info.frame_count, RecordButton::new(&recorder, head, &args.out))?;
    let form = Form { format: args.trajectory, max_variance: args.max_variance };
    let session = Session { about, source: info, camera, params, form, stop: &stop, progress: &progress };
    let mapped = session.run(output, &ahead, &mut watch);
    // Tells the recorder which frames nobody took, so that a replay ends where this run did.
    drop(ahead);
    let recorded = recorder.is_recording().then(|| recorder.stop()).transpose();
    let Mapped { folder, record, failure } = mapped?;
    if let Ok(Some(summary)) = &recorded {
        progress.note(&summary.text());
    }
    if let Some(warning) = too_few_poses(&record.frames) {
        progress.warn(&warning);
    }
    progress.finish(&record, &folder.display().to_string());
    watch.end(Ended(&format!("The run has ended. Its results are in {}", folder.display())));
    recorded?;
    match failure {
        Some(failure) => bail!("the run ended early, what was tracked is saved: {failure}"),
        None => args.judge(record.frames.tracked_share),
    }
}

/// What people call a recording: the last part of its path, of a file without the extension.
fn recording_name(path: &Path) -> String {
    // A path such as `.` names nothing before it is made whole.
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let name = if whole.is_dir() { whole.file_name() } else { whole.file_stem() };
    name.map_or_else(|| "recording".into(), |name| name.to_string_lossy().into_owned())
}

impl RunArgs {
    fn check(&self) -> Result<()> {
        if !(self.speed.is_finite() && self.speed > 0.0) {
            bail!(
                "--speed {} is not a speed\nhint: 1 is the speed of the recording, 2 twice as fast",
                self.speed
            );
        }
        if let Some(share) = self.min_tracked.filter(|share| !(0.0..=1.0).contains(share)) {
            bail!("--min-tracked {share} is not a share\nhint: 0.9 asks for 90 % of the frames");
        }
        if let Some(path) = &self.record {
            refuse_existing(path)?;
        }
        if let (Some(start), Some(end)) = (self.start, self.end)
            && start >= end
        {
            bail!("--start {start} is not before --end {end}");
        }
        if let Some(out_of_range) = [self.start, self.end].into_iter().flatten().find(|s| !s.is_finite()) {
            bail!("--start and --end are seconds into the recording, not {out_of_range}");
        }
        if !(self.max_variance.is_finite() && self.max_variance > 0.0) {
            bail!("--max-variance is {}\nhint: give a number above 0", self.max_variance);
        }
        Ok(())
    }

    /// Whether enough was tracked.
    fn judge(&self, share: f64) -> Result<()> {
        match self.min_tracked {
            Some(least) if share < least => {
                let text = format!(
                    "{:.1} % of the frames have a pose, --min-tracked asks for {:.1} %; what was tracked is saved",
                    100.0 * share,
                    100.0 * least
                );
                Err(EndedBy { ending: Ending::TooLittleTracked, text }.into())
            }
            _ => Ok(()),
        }
    }

    /// The recording, or the camera that is to be used instead.
    fn open(&self) -> Result<Box<dyn FrameSource>> {
        let Some(source) = &self.source else {
            self.camera.needed()?;
            return open_camera(&self.camera.clone().for_calibration(self.calib.as_deref())?);
        };
        let (fps, topic) = (self.camera.fps, self.topic.clone());
        self.camera.not_needed()?;
        if self.camera.duration.is_some() {
            bail!("--duration is for cameras\nhint: of a recording, take --start and --end");
        }
        sources::open(source, &SourceOptions { fps, topic, all_frames: self.all_frames })
    }

    fn calibration(&self) -> CameraOptions {
        CameraOptions {
            calibration: self.calib.clone(),
            response: self.response.clone(),
            vignette: self.vignette.clone(),
            scale_to: None,
        }
    }

    /// The size of the first image, if the calibration is to be scaled to it.
    fn scale_to(&self) -> Result<Option<(usize, usize)>> {
        if !self.scale_calib {
            return Ok(None);
        }
        let first = self.open()?.next_frame().map(|frame| frame.picture.into_grey());
        match first {
            Some(Ok(image)) => Ok(Some((image.width(), image.height()))),
            Some(Err(reason)) => bail!("--scale-calib needs the first image: {reason}"),
            None => bail!("--scale-calib needs an image, and there is none"),
        }
    }

    /// Where the map comes from; nothing in it may differ between two runs of the same command.
    fn provenance(
        &self,
        info: &SourceInfo,
        correction: &ImageCorrection,
        params: &Params,
    ) -> BTreeMap<String, String> {
        let parameters = if *params == Params::default() { "defaults".into() } else { format!("{params:?}") };
        let pairs = [
            ("program", concat!("loopbox ", env!("CARGO_PKG_VERSION")).to_owned()),
            ("source", info.path.display().to_string()),
            ("source kind", info.kind.to_owned()),
            ("calibration", correction.origin().to_owned()),
            ("parameters", parameters),
        ];
        pairs.map(|(key, value)| (key.to_owned(), value)).into()
    }

    /// How many frames mapping may take: as many as asked for; else those of the run that was recorded; else, where
    /// frames come at their own time, those of [`LIVE_LAG`].
    fn lag(&self, info: &SourceInfo, asked: usize) -> usize {
        let is_live = self.realtime || self.source.is_none();
        match (asked, info.lag) {
            (0, Some(recorded)) => recorded,
            (0, None) if is_live => {
                let recorded = info.frame_count.zip(info.duration).filter(|(_, duration)| *duration > 0.0);
                let rate = recorded.map(|(count, duration)| count as f64 / duration).or(self.camera.fps);
                ((LIVE_LAG * self.speed * rate.unwrap_or(USUAL_RATE)).round() as usize).clamp(1, MAX_LAG)
            }
            _ => asked,
        }
    }

    fn pace(&self) -> Pace {
        if self.realtime { Pace::RealTime { speed: self.speed } } else { Pace::EveryFrame }
    }

    fn display(&self) -> Display {
        match (self.quiet, self.log) {
            (true, _) => Display::Quiet,
            (false, Some(LogForm::Json)) => Display::Json,
            (false, None) => Display::Bar,
        }
    }
}
