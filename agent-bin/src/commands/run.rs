//! `loopbox run`: tracks and maps a recording.

use super::params::ParameterArgs;
use super::publishing::Ros2Args;
use super::run_scans::{self, OpenScans, ScanArgs, ScanRun};
use super::threads::ThreadsArg;
use super::watching::ViewArgs;
use crate::console::{self, Ended, Ending, usage};
use crate::interrupt::stop_on_ctrl_c;
use crate::progress::Display;
use anyhow::{Result, anyhow, bail};
use clap::{Args, ValueEnum};
use loopbox::blobs::local_recording;
use loopbox::open::recording_name;
use loopbox::run::{Listeners, Recording, Resume, ResumeMode, RunOptions, TrajectoryFormat};
use sources::ahead::Pace;
use sources::camera::{CameraArgs, open_camera};
use sources::correction::{CameraOptions, DEFAULT_MAX_WIDTH};
use sources::recording::refuse_existing;
use sources::{FrameSource, SourceOptions};
use std::path::{Path, PathBuf};

mod checks;
mod images;
mod repeat;

/// Arguments of `loopbox run`.
#[derive(Args, Debug)]
pub struct RunArgs {
    /// The recording: a folder of images, an MCAP file, a ROS 2 or ROS 1 bag, or a video file; or a LiDAR's: a folder of
    /// KITTI, PCD or PLY scans, or an MCAP file or bag with point clouds. In a bucket: s3://BUCKET/NAME, gs://… or az://…, an object or
    /// all objects under that name
    #[arg(conflicts_with = "camera")]
    source: Option<PathBuf>,
    /// Folder for the results; made if it is not there; default: out/ and the recording's or the camera's name
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Say what the recording holds and what a run would use, as `loopbox info` does, and stop
    #[arg(long, conflicts_with = "camera")]
    check: bool,
    /// Replace results of another recording or of a merge in that folder, once the new ones are complete
    #[arg(short, long)]
    force: bool,
    /// Map the recording so many times, from first frames that are 0.2 s apart, into DIR/1, DIR/2 …; where groundtruth.txt lies
    /// beside its images, compare them as `loopbox eval --table` does, also in DIR/runs.csv
    #[arg(
        long,
        value_name = "COUNT",
        value_parser = clap::value_parser!(u32).range(1..),
        conflicts_with_all = ["camera", "check", "open", "continued", "localise", "record"]
    )]
    repeat: Option<u32>,
    /// Show the report in the browser once it is written
    #[arg(long, conflicts_with = "check")]
    pub(super) open: bool,
    /// Print the numbers as one JSON object in place of the summary: those of run.json but for the rows of single frames, and the
    /// folder as `out`
    #[arg(long, conflicts_with_all = ["log", "check", "repeat"])]
    json: bool,
    /// Show no progress and no summary; warnings stay
    #[arg(short, long, conflicts_with = "log")]
    quiet: bool,
    #[command(flatten)]
    parameters: ParameterArgs,
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    part: PartArgs,
    #[command(flatten)]
    lens: LensArgs,
    #[command(flatten)]
    map: MapArgs,
    #[command(flatten, next_help_heading = "Live camera")]
    camera: CameraArgs,
    #[command(flatten, next_help_heading = "LiDAR")]
    scans: ScanArgs,
    #[command(flatten, next_help_heading = "Live page")]
    view: ViewArgs,
    #[cfg(feature = "fleet")]
    #[command(flatten, next_help_heading = "Fleet")]
    pub(super) pairing: super::fleet::PairingArgs,
    #[command(flatten, next_help_heading = "ROS 2")]
    publishing: Ros2Args,
}

/// What of the recording is taken, and how fast.
#[derive(Args, Debug)]
#[command(next_help_heading = "Recording")]
struct PartArgs {
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
    /// Play by the time stamps and drop frames when late
    #[arg(long, conflicts_with = "camera")]
    realtime: bool,
    /// With --realtime: how many times as fast as recorded
    #[arg(
        long,
        value_name = "FACTOR",
        allow_negative_numbers = true,
        default_value_t = 1.0,
        requires = "realtime"
    )]
    speed: f64,
}

/// What is known of the lens and the sensor.
#[derive(Args, Debug)]
#[command(next_help_heading = "Lens and sensor")]
struct LensArgs {
    /// Camera calibration, if none came with the recording or another is wanted; FILE:cam1 names one of several in it, none
    /// leaves aside what came with the recording
    #[arg(long, value_name = "FILE")]
    calib: Option<PathBuf>,
    /// The horizontal field of view in degrees, to find the lens from, whatever came with the recording; without it and a
    /// calibration usual ones are begun with
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, conflicts_with = "calib")]
    fov: Option<f64>,
    /// Scale the calibration to the images, where they show the same at another size
    #[arg(long, conflicts_with = "camera")]
    scale_calib: bool,
    #[arg(long, value_name = "PIXELS", help = format!(
        "Halve images that are wider than this until they are not [default: {DEFAULT_MAX_WIDTH}]"
    ))]
    max_width: Option<usize>,
    /// Inverse response of the sensor (256 numbers), to undo it
    #[arg(long, value_name = "FILE")]
    response: Option<PathBuf>,
    /// Vignette of the lens (grey image), to undo it
    #[arg(long, value_name = "FILE")]
    vignette: Option<PathBuf>,
    /// What of the images is not to be used: a grey image of the camera's size, black there
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
}

/// What map is made, and what is written of it.
#[derive(Args, Debug)]
#[command(next_help_heading = "Map and results")]
struct MapArgs {
    /// Go on in this map of an earlier run with the same camera, and extend it: a map file or a folder of results
    #[arg(long = "continue", visible_alias = "resume", value_name = "MAP", conflicts_with = "localise")]
    continued: Option<PathBuf>,
    /// Find the frames' poses in this map of an earlier run with the same camera, which stays as it is
    #[arg(long, visible_alias = "localize", value_name = "MAP")]
    localise: Option<PathBuf>,
    /// What the agent is called where maps are merged; otherwise the recording's name
    #[arg(long, value_name = "NAME", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    name: Option<String>,
    /// Form of trajectory.txt
    #[arg(long, value_enum, value_name = "FORM", default_value_t = TrajectoryFormat::Tum)]
    trajectory: TrajectoryFormat,
    #[arg(long, value_name = "V", allow_negative_numbers = true, help = format!(
        "Leave out of cloud.ply points whose variance of inverse depth over its square is larger [default: {}]",
        map::DEFAULT_MAX_RELATIVE_VARIANCE
    ))]
    max_variance: Option<f32>,
    /// When the keyframes' features are found, by which maps are merged: beside tracking, which keeps them in the map, or
    /// later, by each merge of the map [default: now]
    #[arg(long, value_enum, value_name = "WHEN")]
    features: Option<FeatureTime>,
    /// Record what is captured in this MCAP file, from which the run can be replayed exactly
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Log events to standard output in this form
    #[arg(long, value_enum, value_name = "FORM")]
    log: Option<LogForm>,
    /// End with exit code 4 if a smaller share of the frames has a pose, 0 to 1; frames dropped late do not count
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true)]
    min_tracked: Option<f64>,
}

/// In place of a file: a calibration that came with the recording is left aside.
const NO_CALIBRATION: &str = "none";

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
pub fn execute(mut args: RunArgs) -> Result<()> {
    usage(args.check_numbers())?;
    args.threads.start()?;
    if let Some(source) = &mut args.source {
        *source = local_recording(source, &|text| console::step(args.quiet, text))?;
    }
    if let Some(path) = &args.map.record {
        refuse_existing(path)?;
    }
    let found = |source: &Path| run_scans::open(source, args.part.topic.as_deref(), &args.scans).transpose();
    if let Some(scans) = args.source.as_deref().and_then(found).transpose()? {
        return if args.check { args.print_scans(scans) } else { args.over_scans(scans) };
    }
    usage(args.for_images())?;
    if args.check {
        return args.print_images();
    }
    let stop = stop_on_ctrl_c("stopping: saving what was tracked so far (Ctrl-C again to abort)")?;
    match args.repeat {
        Some(count) => repeat::repeat(args, count, &stop),
        None => images::over_images(&args, &stop),
    }
}

impl RunArgs {
    /// With a folder for the results, where none is given.
    pub fn with_out(mut self) -> Self {
        let name = self.source.as_deref().or(self.camera.path().as_deref()).map(recording_name);
        self.out = self.out.or_else(|| Some(Path::new("out").join(name?)));
        self
    }

    /// Folder for the results.
    pub fn out(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new("out"))
    }

    /// A run over a LiDAR's scans.
    fn over_scans(&self, scans: OpenScans) -> Result<()> {
        let given = [
            (self.lens.calib.is_some(), "--calib"),
            (self.lens.fov.is_some(), "--fov"),
            (self.lens.max_width.is_some(), "--max-width"),
            (self.map.max_variance.is_some(), "--max-variance"),
            (self.map.features.is_some(), "--features"),
            (self.camera.duration.is_some(), "--duration"),
            (self.lens.scale_calib, "--scale-calib"),
            (self.lens.response.is_some(), "--response"),
            (self.lens.vignette.is_some(), "--vignette"),
            (self.lens.mask.is_some(), "--mask"),
            (self.part.realtime, "--realtime"),
            (self.map.record.is_some(), "--record"),
            (self.camera.fps.is_some(), "--fps"),
            (self.part.all_frames, "--all-frames"),
            (self.map.continued.is_some(), "--continue"),
            (self.map.localise.is_some(), "--localise"),
            (self.publishing.is_wanted(), "--ros2"),
            (self.repeat.is_some(), "--repeat"),
        ];
        let given = given.into_iter().find(|(is_given, _)| *is_given).map(|(_, name)| name);
        if let Some(name) = given.or(self.view.given()) {
            let path = scans.source.info().path.display();
            return usage(Err(anyhow!("{name} is for images, and {path} holds scans of a LiDAR")));
        }
        let stop = stop_on_ctrl_c("stopping: saving what was mapped so far (Ctrl-C again to abort)")?;
        #[cfg_attr(not(feature = "fleet"), expect(unused_mut, reason = "only a fleet listens"))]
        let mut listeners = Listeners::default();
        #[cfg(feature = "fleet")]
        let fleet = self.pairing.start(self.out(), self.quiet)?;
        #[cfg(feature = "fleet")]
        if let Some(fleet) = &fleet {
            listeners.add(fleet.publisher()?);
        }
        let run = ScanRun {
            out: self.out(),
            name: self.map.name.as_deref(),
            force: self.force,
            start: self.part.start,
            end: self.part.end,
            kitti: self.map.trajectory == TrajectoryFormat::Kitti,
            params: self.parameters.of_scans()?,
            quiet: self.quiet,
            log: self.map.log.is_some(),
            json: self.json,
            listeners,
            stop: &stop,
        };
        let share = run_scans::execute(scans, &run, &self.scans);
        // Whoever listens learns by this that no more comes.
        drop(run);
        let share = share?;
        #[cfg(feature = "fleet")]
        if let Some(fleet) = fleet {
            self.pairing.end(fleet, self.out(), &stop, self.quiet)?;
        }
        self.judge(share)
    }

    /// Whether enough was tracked.
    fn judge(&self, share: f64) -> Result<()> {
        match self.map.min_tracked {
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
            return open_camera(&self.camera.clone().for_calibration(self.calibration())?);
        };
        recording.open()
    }

    /// The recording, where it is one.
    fn recording(&self) -> Option<Recording> {
        let (fps, topic) = (self.camera.fps, self.part.topic.clone());
        let options = SourceOptions { fps, topic, all_frames: self.part.all_frames };
        Some(Recording { path: self.source.clone()?, options })
    }

    fn options(&self) -> Result<RunOptions> {
        let camera = CameraOptions {
            calibration: self.calibration().map(Path::to_owned),
            leave_found: self.lens.calib.is_some() && self.calibration().is_none(),
            response: self.lens.response.clone(),
            vignette: self.lens.vignette.clone(),
            mask: self.lens.mask.clone(),
            scale_to: self.scale_to()?,
            max_width: self.lens.max_width.unwrap_or(DEFAULT_MAX_WIDTH),
        };
        Ok(RunOptions {
            name: self.map.name.clone(),
            force: self.force,
            camera,
            params: self.parameters.of_run()?,
            pace: self.pace(),
            rate: self.camera.fps,
            start: self.part.start,
            end: self.part.end,
            resume: self.resume(),
            record: self.map.record.clone(),
            trajectory: self.map.trajectory,
            max_variance: self.map.max_variance.unwrap_or(map::DEFAULT_MAX_RELATIVE_VARIANCE),
            features: self.map.features.is_none_or(FeatureTime::is_now),
            ..RunOptions::to(self.out())
        })
    }

    /// The calibration that is given.
    fn calibration(&self) -> Option<&Path> {
        self.lens.calib.as_deref().filter(|path| *path != Path::new(NO_CALIBRATION))
    }

    /// The map to go on in.
    fn resume(&self) -> Option<Resume> {
        let on = self.map.continued.iter().map(|map| (map, ResumeMode::Mapping));
        let given = on.chain(self.map.localise.iter().map(|map| (map, ResumeMode::Localising))).next();
        given.map(|(map, mode)| Resume { map: map.clone(), mode, opened: None })
    }

    /// The size of the first image, if the calibration is to be scaled to it.
    fn scale_to(&self) -> Result<Option<(usize, usize)>> {
        if !self.lens.scale_calib {
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
        if self.part.realtime { Pace::RealTime { speed: self.part.speed } } else { Pace::EveryFrame }
    }

    fn display(&self) -> Display {
        match (self.quiet, self.map.log) {
            (true, _) => Display::Quiet,
            (false, Some(LogForm::Json)) => Display::Json,
            (false, None) => Display::Bar,
        }
    }
}
