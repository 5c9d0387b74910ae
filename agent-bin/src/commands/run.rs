//! `loopbox run`: tracks and maps a recording.

use super::params;
use super::publishing::{self, Ros2Args};
use super::run_scans::{self, ScanArgs, ScanRun};
use super::watching::ViewArgs;
use crate::console::{Ended, Ending};
use crate::interrupt::stop_on_ctrl_c;
use crate::progress::{Console, Display};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use loopbox::run::{
    Going, Listeners, PreparedRun, Progress, Recording, Resume, RunOptions, TrajectoryFormat,
};
use scans::ScanSource;
use sources::ahead::Pace;
use sources::camera::{CameraArgs, open_camera};
use sources::correction::{CameraOptions, DEFAULT_MAX_WIDTH};
use sources::recording::{check_length, check_name, refuse_existing};
use sources::{FrameSource, SourceOptions};
use std::path::{Path, PathBuf};

/// Arguments of `loopbox run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    /// The recording: a folder of images, an MCAP file, a ROS 1 bag or a video file; or a LiDAR's: a folder of KITTI, PCD
    /// or PLY scans, or an MCAP file or bag with point clouds
    #[arg(conflicts_with = "camera")]
    source: Option<PathBuf>,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    scans: ScanArgs,
    /// Camera calibration, if none came with the recording or another is wanted
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// Without a calibration: the horizontal field of view in degrees, to find the lens from; where it is not given
    /// either, usual ones are begun with
    #[arg(long, value_name = "DEGREES", conflicts_with = "calib")]
    fov: Option<f64>,
    /// Scale the calibration to the images, where they show the same at another size
    #[arg(long, conflicts_with = "camera")]
    scale_calib: bool,
    /// Halve images that are wider than this until they are not
    #[arg(long, value_name = "PIXELS", default_value_t = DEFAULT_MAX_WIDTH)]
    max_width: usize,
    /// Inverse response of the sensor (256 numbers), to undo it
    #[arg(long, value_name = "FILE")]
    response: Option<PathBuf>,
    /// Vignette of the lens (grey image), to undo it
    #[arg(long, value_name = "FILE")]
    vignette: Option<PathBuf>,
    /// What of the images is not to be used: a grey image of the camera's size, black there
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Go on in this map of an earlier run with the same camera, and extend it: a map file or a folder of results
    #[arg(long = "continue", value_name = "MAP", conflicts_with = "localise")]
    continued: Option<PathBuf>,
    /// Tell the frames' poses in this map of an earlier run with the same camera, which stays as it is
    #[arg(long, value_name = "MAP")]
    localise: Option<PathBuf>,
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What the agent is called where maps are merged; otherwise the recording's name
    #[arg(long, value_name = "NAME", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    name: Option<String>,
    /// Replace results of another recording or of a merge in that folder, once the new ones are complete
    #[arg(long)]
    force: bool,
    /// Form of trajectory.txt
    #[arg(long, value_enum, value_name = "FORM", default_value_t = TrajectoryFormat::Tum)]
    trajectory: TrajectoryFormat,
    /// Leave out of cloud.ply points whose variance of inverse depth over its square is larger
    #[arg(long, value_name = "V", default_value_t = map::DEFAULT_MAX_RELATIVE_VARIANCE)]
    max_variance: f32,
    /// When the keyframes' features are found, by which maps are merged: beside tracking, which keeps them in the map, or
    /// later, by each merge of the map
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = FeatureTime::Now)]
    features: FeatureTime,
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
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    start: Option<f64>,
    /// Stop so many seconds into the recording
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
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
    #[arg(long, value_name = "COUNT", allow_negative_numbers = true)]
    threads: Option<usize>,
    #[command(flatten)]
    view: ViewArgs,
    #[cfg(feature = "fleet")]
    #[command(flatten)]
    pairing: super::fleet::PairingArgs,
    #[command(flatten)]
    publishing: Ros2Args,
}

/// When features are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FeatureTime {
    /// As the map is made.
    Now,
    /// When maps are merged.
    Later,
}

impl FeatureTime {
    /// Whether they are found as the map is made.
    pub fn is_now(self) -> bool {
        self == Self::Now
    }
}

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
    args.publishing.check()?;
    let found = |source: &Path| run_scans::open(source, args.topic.as_deref(), &args.scans).transpose();
    if let Some(scans) = args.source.as_deref().and_then(found).transpose()? {
        return args.over_scans(scans);
    }
    if let Some(name) = args.scans.given() {
        bail!(
            "{name} is for scans of a LiDAR\nhint: give a folder of KITTI (.bin), PCD or PLY scans, or a file with them"
        );
    }
    let stop = stop_on_ctrl_c("stopping: saving what was tracked so far (Ctrl-C again to abort)")?;
    let mut options = args.options()?;
    args.take_threads()?;
    let source = args.open()?;
    if let Some(recording) = args.recording() {
        let progress = Console::new(args.display(), None);
        options.without_calibration(source.info(), recording, args.fov, &stop, &progress)?;
    }
    let prepared = PreparedRun::new(source, options)?;
    let progress = Console::new(args.display(), prepared.frame_count());
    prepared.problems().iter().for_each(|problem| progress.warn(problem));
    #[cfg(feature = "fleet")]
    let fleet = args.pairing.start(&args.out, args.quiet)?;
    let watched = |about: &_, frames, recording| {
        let watch = args.view.start(about, frames, recording)?;
        #[cfg(feature = "fleet")]
        if let Some(fleet) = &fleet {
            fleet.shown_by(watch.neighbourhood());
        }
        Ok(watch)
    };
    #[cfg(feature = "fleet")]
    let prepared = match &fleet {
        Some(fleet) => prepared.told_to(fleet.teller()?),
        None => prepared,
    };
    let (prepared, publishing) = match args.publishing.start()? {
        Some((follower, publishing)) => (prepared.told_to(follower), Some(publishing)),
        None => (prepared, None),
    };
    let mapped = prepared.go(watched, &stop, &progress);
    publishing.map(|publishing| publishing::end(publishing, args.quiet)).transpose()?;
    let mapped = mapped?;
    #[cfg(feature = "fleet")]
    if let Some(fleet) = fleet {
        args.pairing.end(fleet, &args.out, &stop, args.quiet)?;
    }
    match (mapped.failure, mapped.apart) {
        (Some(failure), _) => bail!("the run ended early, what was tracked is saved: {failure}"),
        (None, Some(apart)) => bail!("{apart}"),
        (None, None) => args.judge(mapped.record.frames.tracked_share),
    }
}

impl RunArgs {
    fn check(&self) -> Result<()> {
        if !(self.speed.is_finite() && self.speed > 0.0) {
            bail!(
                "--speed {} is not a speed\nhint: 1 is the speed of the recording, 2 twice as fast",
                self.speed
            );
        }
        if self.max_width < 64 {
            bail!("--max-width {} leaves nothing to track\nhint: 640 and more do", self.max_width);
        }
        if let Some(fov) = self.fov.filter(|fov| !(5.0..=150.0).contains(fov)) {
            bail!("--fov {fov} is not a field of view\nhint: give degrees, such as --fov 65");
        }
        if let Some(share) = self.min_tracked.filter(|share| !(0.0..=1.0).contains(share)) {
            bail!("--min-tracked {share} is not a share\nhint: 0.9 asks for 90 % of the frames");
        }
        if let Some(path) = &self.record {
            check_name(path)?;
            check_length(path)?;
            refuse_existing(path)?;
        }
        if let Some(name) = &self.name {
            check_length(Path::new(name))?;
        }
        if self.threads == Some(0) {
            bail!("--threads 0 leaves nobody to map\nhint: give 1 or more; without it there is one per core");
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

    /// A run over a LiDAR's scans.
    fn over_scans(&self, mut source: Box<dyn ScanSource>) -> Result<()> {
        let given = [
            (self.calib.is_some(), "--calib"),
            (self.scale_calib, "--scale-calib"),
            (self.response.is_some(), "--response"),
            (self.vignette.is_some(), "--vignette"),
            (self.mask.is_some(), "--mask"),
            (self.realtime, "--realtime"),
            (self.record.is_some(), "--record"),
            (self.camera.fps.is_some(), "--fps"),
            (self.all_frames, "--all-frames"),
            (self.continued.is_some(), "--continue"),
            (self.localise.is_some(), "--localise"),
            (self.publishing.is_wanted(), "--ros2"),
        ];
        let given = given.into_iter().find(|(is_given, _)| *is_given).map(|(_, name)| name);
        if let Some(name) = given.or(self.view.given()) {
            bail!("{name} is for images, and {} holds scans of a LiDAR", source.info().path.display());
        }
        self.take_threads()?;
        let stop = stop_on_ctrl_c("stopping: saving what was mapped so far (Ctrl-C again to abort)")?;
        #[cfg_attr(not(feature = "fleet"), expect(unused_mut, reason = "only a fleet listens"))]
        let mut listeners = Listeners::default();
        #[cfg(feature = "fleet")]
        let fleet = self.pairing.start(&self.out, self.quiet)?;
        #[cfg(feature = "fleet")]
        if let Some(fleet) = &fleet {
            listeners.add(fleet.teller()?);
        }
        let run = ScanRun {
            out: &self.out,
            name: self.name.as_deref(),
            force: self.force,
            start: self.start,
            end: self.end,
            kitti: self.trajectory == TrajectoryFormat::Kitti,
            params: self.params.as_deref(),
            quiet: self.quiet,
            json: self.log.is_some(),
            listeners,
            stop: &stop,
        };
        let share = run_scans::execute(source.as_mut(), &run, &self.scans);
        // Whoever listens learns by this that no more comes.
        drop(run);
        let share = share?;
        #[cfg(feature = "fleet")]
        if let Some(fleet) = fleet {
            self.pairing.end(fleet, &self.out, &stop, self.quiet)?;
        }
        self.judge(share)
    }

    fn take_threads(&self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("cannot start threads")
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
                Err(Ended { ending: Ending::TooLittleTracked, text }.into())
            }
            _ => Ok(()),
        }
    }

    /// The recording, or the camera that is to be used instead.
    fn open(&self) -> Result<Box<dyn FrameSource>> {
        let Some(recording) = self.recording() else {
            self.camera.needed()?;
            return open_camera(&self.camera.clone().for_calibration(self.calib.as_deref())?);
        };
        self.camera.not_needed()?;
        if self.camera.duration.is_some() {
            bail!("--duration is for cameras\nhint: of a recording, take --start and --end");
        }
        recording.open()
    }

    /// The recording, where it is one.
    fn recording(&self) -> Option<Recording> {
        let (fps, topic) = (self.camera.fps, self.topic.clone());
        let options = SourceOptions { fps, topic, all_frames: self.all_frames };
        Some(Recording { path: self.source.clone()?, options })
    }

    fn options(&self) -> Result<RunOptions> {
        let camera = CameraOptions {
            calibration: self.calib.clone(),
            response: self.response.clone(),
            vignette: self.vignette.clone(),
            mask: self.mask.clone(),
            scale_to: self.scale_to()?,
            max_width: self.max_width,
        };
        Ok(RunOptions {
            name: self.name.clone(),
            force: self.force,
            camera,
            params: self.params.as_deref().map(params::read).transpose()?.unwrap_or_default(),
            pace: self.pace(),
            rate: self.camera.fps,
            start: self.start,
            end: self.end,
            resume: self.resume(),
            record: self.record.clone(),
            trajectory: self.trajectory,
            max_variance: self.max_variance,
            features: self.features.is_now(),
            ..RunOptions::to(&self.out)
        })
    }

    /// The map to go on in.
    fn resume(&self) -> Option<Resume> {
        let on = self.continued.iter().map(|map| (map, Going::On));
        let given = on.chain(self.localise.iter().map(|map| (map, Going::Localising))).next();
        given.map(|(map, going)| Resume { map: map.clone(), going, opened: None })
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
