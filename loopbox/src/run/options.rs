//! A run as it is asked for, and its way from there to the results.

use super::diagnosis::too_few_poses;
use super::lens::{FirstPart, FoundLens, Recording};
use super::lens_check::GivenLens;
use super::outlook::expect_found_camera;
use super::output::{Output, REPORT, TrajectoryFormat};
use super::record::{CalibrationRecord, Setup};
use super::resuming::{Kept, Resume};
use super::saving::Form;
use super::scale_doubt::doubtful_scale;
use super::session::{Mapped, Session};
use super::without_depth::doubtful_depth;
use super::{Progress, Silent};
use crate::listeners::{Listeners, MapListener};
use crate::open::recording_name;
use crate::swapping::SwapFiles;
use anyhow::{Result, anyhow, bail};
use geometry::Pinhole;
use map::{AgentInfo, Identity};
use slam_direct::Params;
use sources::ahead::{Ahead, Pace, Preparation};
use sources::correction::{CameraOptions, ImageCorrection, correction};
use sources::recording::{CalibrationFiles, Head, RecordButton, Recorder};
use sources::{FrameSource, SourceInfo, SourceOptions, Stop};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use view::watch::{Ended, Watch};

/// Time that the mapping of a keyframe may take beside the tracking where frames come at their own time, seconds: two
/// keyframes' work on one slow core. More makes the map older that frames are tracked against.
const LIVE_LAG: f64 = 0.1;
/// The rate of a camera that does not tell it, frames a second.
const USUAL_RATE: f64 = 30.0;
/// The largest `mapping.lag`.
const MAX_LAG: usize = 10;

/// How a run is to go.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Folder for the results; made if it is not there.
    pub out: PathBuf,
    /// What people are to call the agent; `None` for the recording's name.
    pub name: Option<String>,
    /// Replace results of another recording or of a merge in that folder.
    pub force: bool,
    /// What is known of the camera beyond what comes with the recording.
    pub camera: CameraOptions,
    /// The lens, where it was found from the recording.
    pub lens: Option<FoundLens>,
    /// How the recording is opened once more, where it is one: by how much a wrong calibration is off is found from its first part.
    pub recording: Option<Recording>,
    /// How the agent tracks and maps.
    pub params: Params,
    /// Every frame, or as they come.
    pub pace: Pace,
    /// Frames a second of a camera, where it was asked for a rate.
    pub rate: Option<f64>,
    /// Seconds into the recording from which frames are taken.
    pub start: Option<f64>,
    /// Seconds into the recording until which they are.
    pub end: Option<f64>,
    /// The map of an earlier run to go on in.
    pub resume: Option<Resume>,
    /// Keep what is captured in this file as well.
    pub record: Option<PathBuf>,
    /// Form of the trajectory.
    pub trajectory: TrajectoryFormat,
    /// Largest variance of inverse depth over its square of the cloud's points.
    pub max_variance: f32,
    /// Whether the keyframes' features are found beside tracking, so that merging need not. Without them the map is
    /// smaller, and merging finds them at each call.
    pub features: bool,
    /// Nobody looks after the run, for months: a full disk is waited out, with the map growing in memory; rows of old frames
    /// are forgotten; and when it is to stop, the map is left as it has grown, without trajectory, cloud and report.
    pub unattended: bool,
    /// Where keyframes are kept that are too many for memory; `None` for [files](SwapFiles::new) beside the results.
    pub swap: Option<Arc<SwapFiles>>,
}

impl RunOptions {
    /// The usual run, with results in `out`.
    pub fn to(out: impl Into<PathBuf>) -> Self {
        Self {
            out: out.into(),
            name: None,
            force: false,
            camera: CameraOptions::default(),
            lens: None,
            recording: None,
            params: Params::default(),
            pace: Pace::EveryFrame,
            rate: None,
            start: None,
            end: None,
            resume: None,
            record: None,
            trajectory: TrajectoryFormat::Tum,
            max_variance: map::DEFAULT_MAX_RELATIVE_VARIANCE,
            features: true,
            unattended: false,
            swap: None,
        }
    }
}

/// A run that is ready to go: all that can be refused before the first frame has been looked at.
pub struct PreparedRun {
    source: Box<dyn FrameSource>,
    info: SourceInfo,
    about: AgentInfo,
    camera: Pinhole,
    params: Params,
    correction: ImageCorrection,
    head: Head,
    output: Output,
    kept: Option<Kept>,
    /// What there is to know of the map that is gone on in.
    warnings: Vec<String>,
    options: RunOptions,
    listeners: Listeners,
}

/// Tracks and maps the recording at `source` and writes the results; tells nobody how it goes.
///
/// ```no_run
/// use loopbox::run::{RunOptions, run};
///
/// let mapped = run("demo/parking_a".as_ref(), RunOptions::to("out/parking_a"))?;
/// println!("{} frames have a pose, see {}", mapped.record.frames.tracked, mapped.folder.display());
/// # Ok::<(), anyhow::Error>(())
/// ```
///
/// # Errors
/// When the recording or its calibration cannot be used, nothing could be tracked, or the results cannot be written.
pub fn run(source: &Path, options: RunOptions) -> Result<Mapped> {
    let recording = Recording { path: source.to_owned(), options: SourceOptions::default() };
    let mut options = options;
    let source = recording.open()?;
    options.without_calibration(source.info(), recording, None, &Stop::default(), &Silent)?;
    PreparedRun::new(source, options)?.go(|_, _, _| Ok(Watch::none()), &Stop::default(), &Silent)
}

impl PreparedRun {
    /// Prepares a run over `source`.
    ///
    /// # Errors
    /// When there is no usable calibration, or the folder of results cannot be written to or holds those of something
    /// else.
    pub fn new(mut source: Box<dyn FrameSource>, mut options: RunOptions) -> Result<Self> {
        let pace = if source.is_live() { Pace::Live } else { options.pace };
        let lag = lag(source.info(), options.params.mapping.lag, pace, options.rate);
        let found = options.lens.as_ref().map(FoundLens::calibration);
        let calibration = found.or_else(|| source.info().calibration.clone());
        let info = SourceInfo { lag: (lag > 0).then_some(lag), calibration, ..source.info().clone() };
        if let (Some(start), Some(duration)) = (options.start, info.duration)
            && start > duration
        {
            bail!("{}: it ends at {duration:.2} s, before --start {start}", info.path.display());
        }
        let params = options.params.clone().with_lag(lag);
        let correction = correction(&options.camera, &info)?;
        if options.lens.is_none() && !options.camera.leave_found {
            expect_found_camera(source.as_mut(), &options.camera);
        }
        let camera = correction.camera();
        let provenance = provenance(&info, &correction, &params);
        // A camera that is live is seen by nobody again; who a recording is follows from its first image.
        let identity = source.is_live().then(random_identity).transpose()?;
        let name = options.name.clone().unwrap_or_else(|| recording_name(&info.path));
        let about = AgentInfo { provenance, identity, ..AgentInfo::new(name, camera) };
        let kept = options.resume.take().map(|resume| Kept::open(resume, &camera, &about)).transpose()?;
        let (kept, warnings) = kept.map_or((None, Vec::new()), |(kept, warnings)| (Some(kept), warnings));
        if let Some(kept) = &kept {
            kept.spare(&options.out)?;
        }
        let mut output = Output::create(&options.out, about.clone(), &info.path, options.force)?;
        output.wait_for_room(options.unattended);
        if let Some(lens) = &options.lens {
            output.add("camera.yaml", lens.file());
        }
        let head = Head::new(&info, CalibrationFiles::gather(&options.camera, &info)?);
        let listeners = Listeners::default();
        Ok(Self {
            source,
            info,
            about,
            camera,
            params,
            correction,
            head,
            output,
            kept,
            warnings,
            options,
            listeners,
        })
    }

    /// The same, of whose maps `listener` is told as well.
    pub fn with_listener(mut self, mut listener: impl MapListener + 'static) -> Self {
        listener.begins(&self.about);
        self.listeners.add(listener);
        self
    }

    /// What is odd about the source and its calibration, for people.
    pub fn problems(&self) -> Vec<String> {
        let problems = self.source.problems().into_iter().chain(self.correction.problem());
        let of_source = problems.map(|problem| format!("{}: {problem}", self.info.path.display()));
        of_source.chain(self.warnings.iter().cloned()).collect()
    }

    /// Which calibration is used and where it came from, for people.
    pub fn calibration(&self) -> String {
        format!("calibration: {}", self.correction.text())
    }

    /// Whether it was given, or came with the recording: of one that was found from the images that was said.
    pub fn is_given_a_calibration(&self) -> bool {
        self.options.lens.is_none()
    }

    /// How many frames the recording has, where that is known.
    pub fn frame_count(&self) -> Option<u64> {
        self.info.frame_count
    }

    /// Tracks and maps until the source ends or `stop` is wished. `watched` starts what shows the run of this agent over
    /// so many frames, which the button records.
    ///
    /// # Errors
    /// When threads or viewers cannot be started, nothing could be tracked, or the results cannot be written.
    pub fn go(
        self,
        watched: impl FnOnce(&AgentInfo, Option<u64>, RecordButton) -> Result<Watch>,
        stop: &Stop,
        progress: &dyn Progress,
    ) -> Result<Mapped> {
        let Self { source, info, about, camera, params, correction, .. } = self;
        let Self { head, output, mut kept, options, listeners, .. } = self;
        let recorder = Recorder::idle();
        if let Some(path) = &options.record {
            recorder.start(path, &head)?;
        }
        let focal_deviation = options.lens.as_ref().map(|lens| lens.focal_deviation);
        let calibration = CalibrationRecord::new(&correction, focal_deviation);
        let unused = correction.unused().cloned();
        let lens = options.lens.is_none().then(|| given_lens(&correction, options.recording, &params, stop));
        let preparation = Preparation::new(correction, options.start, options.end);
        let ahead = Ahead::start(source, preparation, options.pace, recorder.clone())?;
        let mut watch = watched(&about, info.frame_count, RecordButton::new(&recorder, head, &options.out))?;
        let form = Form { format: options.trajectory, max_variance: options.max_variance };
        let (features, unattended) = (options.features, options.unattended);
        let setup = Setup { source: info, camera, calibration, params };
        let swap = options.swap.unwrap_or_else(|| Arc::new(SwapFiles::new(options.out.clone())));
        if let Some(kept) = &mut kept {
            kept.swap_out(&*swap);
        }
        let session = Session {
            about,
            setup,
            unused,
            features,
            unattended,
            form,
            stop,
            progress,
            lens,
            kept,
            listeners,
            swap,
        };
        let mapped = session.run(output, &ahead, &mut watch);
        // Tells the recorder which frames nobody took, so that a replay ends where this run did.
        drop(ahead);
        let recorded = recorder.is_recording().then(|| recorder.stop()).transpose();
        let mapped = mapped?;
        if let Ok(Some(summary)) = &recorded {
            progress.note(&summary.text());
        }
        end(&mapped, progress, watch);
        recorded?;
        Ok(mapped)
    }
}

/// Tells the user and the viewers what the run has come to.
fn end(mapped: &Mapped, progress: &dyn Progress, watch: Watch) {
    warn(mapped, progress);
    progress.mapped(&mapped.record, &mapped.folder);
    let note = format!("The run has ended. Its results are in {}", mapped.folder.display());
    let report = mapped.record.files.iter().any(|name| name == REPORT);
    let report = report.then(|| mapped.folder.join(REPORT));
    watch.end(Ended { note: &note, report: report.as_deref() });
}

/// Says what of a result is doubtful.
fn warn(mapped: &Mapped, progress: &dyn Progress) {
    let fragments = mapped.record.fragments.iter().flat_map(|one| {
        let scale = doubtful_scale(&one.trajectory, &one.scale_doubts);
        let depth = doubtful_depth(&one.map, one.without_depth.as_ref());
        depth.into_iter().chain(one.not_carried()).chain(scale)
    });
    too_few_poses(&mapped.record.frames).into_iter().chain(fragments).for_each(|text| progress.warn(&text));
}

/// The lens that images are undistorted by, and of a recording its first part, from which a better one is found.
fn given_lens(
    correction: &ImageCorrection,
    recording: Option<Recording>,
    params: &Params,
    stop: &Stop,
) -> GivenLens {
    let (lens, halvings) = (*correction.lens(), correction.halvings());
    let first_part = recording.map(|recording| {
        let mask = correction.drawn_mask().cloned();
        FirstPart { recording, halvings, mask, params: params.clone(), stop: stop.clone() }
    });
    GivenLens { lens, halvings, first_part }
}

/// An identity that no other agent has.
fn random_identity() -> Result<Identity> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| anyhow!("the system gives no random numbers: {error}"))?;
    Ok(Identity::random(bytes))
}

/// Where the map comes from; nothing in it may differ between two runs of the same command.
fn provenance(info: &SourceInfo, correction: &ImageCorrection, params: &Params) -> BTreeMap<String, String> {
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
fn lag(info: &SourceInfo, asked: usize, pace: Pace, rate: Option<f64>) -> usize {
    let speed = match pace {
        Pace::EveryFrame => None,
        Pace::RealTime { speed } => Some(speed),
        Pace::Live => Some(1.0),
    };
    match (asked, info.lag, speed) {
        (0, Some(recorded), _) => recorded,
        (0, None, Some(speed)) => {
            let recorded = info.frame_count.zip(info.duration).filter(|(_, duration)| *duration > 0.0);
            let rate = recorded.map(|(count, duration)| count as f64 / duration).or(rate);
            ((LIVE_LAG * speed * rate.unwrap_or(USUAL_RATE)).round() as usize).clamp(1, MAX_LAG)
        }
        _ => asked,
    }
}
