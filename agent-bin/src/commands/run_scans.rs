//! `loopbox run` over a LiDAR's scans.

use crate::console::{Ended, Ending, say, tell, warning};
use crate::progress::print_numbers;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use eval::read_trajectory;
use geometry::Se3;
use indicatif::{ProgressBar, ProgressStyle};
use loopbox::lidar::outlook::ScanOutlook;
use loopbox::lidar::poses::GivenPoses;
use loopbox::lidar::record::{FragmentRow, LidarRecord, LoopRow};
use loopbox::lidar::run::Event;
use loopbox::lidar::sweep_timing::{PointTimes, Scaled, Timed, point_times};
use loopbox::lidar::{LidarOptions, Mapped, map_recording};
use loopbox::run::Listeners;
use nalgebra::UnitQuaternion;
use scans::{Folder, FolderOptions, FolderSource, ScanSource, ScanTiming};
use serde_json::json;
use slam_lidar::loop_verdict::LoopTest;
use slam_lidar::mapping::MappingParams;
use slam_lidar::tracking::Method;
use sources::forward::ForwardScans;
use sources::{FolderKind, Stop, open_scans};
use std::path::{Path, PathBuf};

/// What only recordings of LiDARs take.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct ScanArgs {
    /// Of a LiDAR: the odometry. planes is loopbox's own, floam the paper's, a-loam is there to compare with
    #[arg(long, value_name = "METHOD", value_parser = method_parser())]
    pub odometry: Option<Method>,
    /// Of a LiDAR: build the map on these poses of the sensor (TUM), in place of tracking
    #[arg(long, value_name = "FILE", conflicts_with = "odometry")]
    pub poses: Option<PathBuf>,
    /// Of a folder of scans without times.txt: scans a second [default: 10]
    #[arg(long, value_name = "RATE")]
    pub rate: Option<f64>,
    /// Of a folder of scans: the file of their times, a line each, where it is not times.txt in the folder
    #[arg(long, value_name = "FILE", conflicts_with = "rate")]
    pub times: Option<PathBuf>,
    /// Of scans without times of points: how the sensor turns. auto finds it from the first seconds, rigid: scans are undistorted
    /// already, kitti: as KITTI's, or clockwise or counter-clockwise, the azimuth in degrees at which a sweep begins, and what of
    /// it the stamp is (begin, middle, end), as clockwise,180,middle
    #[arg(long, value_name = "HOW", default_value = "auto", hide_default_value = true, value_parser = str::parse::<ScanTiming>)]
    pub scan_timing: ScanTiming,
    /// The same as --scan-timing rigid
    #[arg(long, conflicts_with = "scan_timing")]
    pub undistorted: bool,
    /// Of a LiDAR: the unit of the clouds' lengths, where it is not the metre
    #[arg(long, value_enum, value_name = "UNIT", default_value_t = ScanUnit::M, hide_default_value = true)]
    pub scan_unit: ScanUnit,
    /// Of a LiDAR: end with exit code 4 where part of the path is guessed, because the scans do not determine all of the motion
    #[arg(long)]
    pub strict: bool,
    /// Of a folder that holds both: take the scans or the images
    #[arg(long, value_enum, value_name = "WHICH")]
    pub sensor: Option<SensorChoice>,
}

/// Units of lengths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ScanUnit {
    /// Metres
    #[default]
    M,
    /// Centimetres
    Cm,
    /// Millimetres
    Mm,
}

/// What a folder that holds images and scans is taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SensorChoice {
    /// Its images
    Camera,
    /// Its scans
    Lidar,
}

/// A recording of scans, and what is known of the times of its points.
pub struct OpenScans {
    /// Its scans, from the first on.
    pub source: Box<dyn ScanSource>,
    /// Whence the times of their points are known.
    pub times: PointTimes,
    /// What else the folder holds, for people.
    pub also: Option<String>,
}

impl OpenScans {
    /// What can be said of it beforehand; it is read on.
    pub fn outlook(&mut self) -> ScanOutlook {
        let farthest = MappingParams::default().odometry.range.1;
        let mut outlook = ScanOutlook::of(self.source.as_mut(), &self.times, farthest);
        outlook.facts.extend(self.also.clone().map(|also| ("also", also)));
        outlook
    }
}

fn method_parser() -> impl TypedValueParser<Value = Method> {
    PossibleValuesParser::new(Method::ALL.map(Method::name)).try_map(|name| name.parse::<Method>())
}

impl ScanArgs {
    /// The first option that was given, by its name on the command line.
    pub fn given(&self) -> Option<&'static str> {
        let Self { odometry, poses, rate, times, undistorted, scan_timing, scan_unit, strict, sensor: _ } =
            self;
        let given = [
            (odometry.is_some(), "--odometry"),
            (poses.is_some(), "--poses"),
            (rate.is_some(), "--rate"),
            (times.is_some(), "--times"),
            (*undistorted, "--undistorted"),
            (*scan_timing != ScanTiming::Found, "--scan-timing"),
            (*scan_unit != ScanUnit::M, "--scan-unit"),
            (*strict, "--strict"),
        ];
        given.into_iter().find(|(is_given, _)| *is_given).map(|(_, name)| name)
    }
}

/// Opens the scans of a LiDAR at a path, if it holds such: a folder, or a file with scans on `topic` or on its only one.
///
/// # Errors
/// When there are scans, but they cannot be read.
pub fn open(path: &Path, topic: Option<&str>, args: &ScanArgs) -> Result<Option<OpenScans>> {
    let Some(mut first) = as_recorded(path, topic, args)? else { return Ok(None) };
    let timing = if args.undistorted { ScanTiming::Rigid } else { args.scan_timing };
    let times = point_times(first.as_mut(), timing);
    // What was looked at is read once more.
    let again = as_recorded(path, topic, args)?.unwrap_or(first);
    let also = FolderKind::of(path).other();
    Ok(Some(OpenScans { source: Box::new(Timed::new(again, &times)), times, also }))
}

/// The scans as they are recorded, but for the unit.
fn as_recorded(path: &Path, topic: Option<&str>, args: &ScanArgs) -> Result<Option<Box<dyn ScanSource>>> {
    let kind = FolderKind::of(path);
    let is_lidar = match args.sensor {
        Some(SensorChoice::Lidar) => kind.scans > 0,
        Some(SensorChoice::Camera) => return Ok(None),
        None => kind.is_of_lidar(),
    };
    let source: Box<dyn ScanSource> = if is_lidar {
        let options = FolderOptions { rate: args.rate, times: args.times.clone() };
        Box::new(FolderSource::new(Folder::open(path, &options)?))
    } else {
        let Some(found) = open_scans(path, topic)? else { return Ok(None) };
        Box::new(found)
    };
    // Time goes forward.
    let source: Box<dyn ScanSource> = Box::new(ForwardScans::new(source));
    Ok(Some(match args.scan_unit {
        ScanUnit::M => source,
        ScanUnit::Cm => Box::new(Scaled::new(source, 0.01)),
        ScanUnit::Mm => Box::new(Scaled::new(source, 0.001)),
    }))
}

/// How a run over scans is made, in what it has in common with one over images.
pub struct ScanRun<'a> {
    /// Folder for the results.
    pub out: &'a Path,
    /// What the agent is called, if not as the recording.
    pub name: Option<&'a str>,
    /// Whether results of something else there are replaced.
    pub force: bool,
    /// Only scans from here on, seconds.
    pub start: Option<f64>,
    /// Only scans up to here.
    pub end: Option<f64>,
    /// Trajectory in KITTI's form.
    pub kitti: bool,
    /// The parameters.
    pub params: MappingParams,
    /// Nothing is said.
    pub quiet: bool,
    /// A JSON object a line.
    pub log: bool,
    /// The numbers as one JSON object in place of the summary.
    pub json: bool,
    /// Who is told how the map grows.
    pub listeners: Listeners,
    /// Ends it.
    pub stop: &'a Stop,
}

/// Runs it; returns the share of the scans that have a pose. With `--strict` it fails where part of the path is guessed.
///
/// # Errors
/// When scans, poses or parameters cannot be used, nothing could be tracked, or results cannot be written.
pub fn execute(opened: OpenScans, run: &ScanRun<'_>, args: &ScanArgs) -> Result<f64> {
    let OpenScans { mut source, times, also } = opened;
    let source = source.as_mut();
    if !run.quiet && !run.log {
        also.iter().for_each(|also| tell!("note: the folder also holds {also}"));
        tell!("point times: {}", times.text());
    }
    let params = MappingParams { method: args.odometry.unwrap_or(run.params.method), ..run.params };
    let poses = args.poses.as_deref().map(read_poses).transpose()?;
    let options = LidarOptions {
        out: run.out.to_owned(),
        name: run.name.map(str::to_owned),
        force: run.force,
        params,
        poses: args.poses.clone().zip(poses),
        start: run.start,
        end: run.end,
        kitti: run.kitti,
        point_times: Some(times.text()),
        listeners: run.listeners.clone(),
    };
    let console = Console::new(run, source.info().count);
    let mapped = map_recording(source, options, run.stop, &mut |event| console.show(event));
    console.bar.finish_and_clear();
    let Mapped { record, failure } = mapped?;
    if !run.log {
        source.remarks().iter().for_each(|remark| warning!("{remark}"));
    }
    if run.log {
        say!(
            "{}",
            json!({
                "event": "end", "scans": record.scans, "cost": record.cost, "map": record.map, "warnings": record.warnings
            })
        );
    } else if run.json {
        print_numbers(&record, run.out);
    } else if !run.quiet {
        summary(&record, run.out);
    }
    if !run.log {
        record.warnings.iter().for_each(|warning| warning!("{warning}"));
    }
    match failure {
        Some(failure) => bail!("the run ended early, what was mapped is saved: {failure}"),
        None if args.strict && record.scans.guessed > 0 => {
            let text = format!(
                "{:.1} m of the path are guessed, which --strict does not take; the map is saved",
                record.map.guessed_m
            );
            Err(Ended { ending: Ending::TooLittleTracked, text }.into())
        }
        None => Ok(record.scans.tracked as f64 / record.scans.offered.max(1) as f64),
    }
}

fn read_poses(path: &Path) -> Result<GivenPoses> {
    let trajectory = read_trajectory(path)?;
    let Some(times) = trajectory.timestamps else {
        bail!(
            "{}: has no time stamps\nhint: give poses in TUM's form, t tx ty tz qx qy qz qw",
            path.display()
        );
    };
    let pose = |pose: &eval::Pose| Se3::new(UnitQuaternion::from_matrix(&pose.rotation), pose.translation);
    let poses = trajectory.world_from_camera.iter().map(pose);
    let poses = times.into_iter().zip(poses).collect();
    GivenPoses::new(poses).with_context(|| format!("{}: cannot be used", path.display()))
}

/// What the user sees meanwhile.
struct Console {
    bar: ProgressBar,
    log: bool,
    skipped: std::cell::Cell<u64>,
}

/// So many scans that are skipped are named; the others are counted.
const NAMED: u64 = 3;

impl Console {
    fn new(run: &ScanRun<'_>, count: Option<u64>) -> Self {
        let bar = match count.filter(|_| !run.quiet && !run.log) {
            Some(count) => ProgressBar::new(count),
            None => ProgressBar::hidden(),
        };
        if let Ok(style) =
            ProgressStyle::with_template("{bar:30} {pos}/{len} scans  {per_sec:>9}  eta {eta:>4}  {msg}")
        {
            bar.set_style(style);
        }
        Self { bar, log: run.log, skipped: 0.into() }
    }

    fn show(&self, event: Event<'_>) {
        match event {
            Event::Scan { row, map, .. } => {
                self.bar.set_position(row.index + 1);
                self.bar.set_message(format!("{} keyframes", map.keyframes.len()));
                if self.log {
                    say!("{}", json!({ "event": "scan", "scan": row, "keyframes": map.keyframes.len() }));
                }
            }
            Event::Skipped { index, reason, detail } if self.log => {
                say!("{}", json!({ "event": "skip", "index": index, "reason": reason, "detail": detail }));
            }
            Event::Skipped { index, detail, .. } => {
                self.skipped.set(self.skipped.get() + 1);
                if self.skipped.get() <= NAMED {
                    self.bar.suspend(|| warning!("scan {index} is skipped: {detail}"));
                }
            }
        }
    }
}

/// The numbers of a run, for people.
fn summary(record: &LidarRecord, out: &Path) {
    let (scans, map, cost) = (&record.scans, &record.map, &record.cost);
    let skipped: u64 = scans.skipped.values().sum();
    say!("scans        {} of {} have a pose, {skipped} skipped", scans.tracked, scans.offered);
    for (reason, first) in &scans.skipped_first {
        say!("             {} {}: {first}", scans.skipped[reason], reason.replace('_', " "));
    }
    let without = (scans.tracked + scans.tracked_apart).saturating_sub(scans.timed);
    if without > 0 {
        say!("rigid        {without} scans have no times of points and were taken as undistorted");
    }
    if scans.degenerate > 0 {
        say!("open         {} scans determine a direction of the pose badly", scans.degenerate);
    }
    if scans.guessed > 0 {
        say!(
            "guessed      {:.1} m of the path, in {} scans that do not determine it",
            map.guessed_m,
            scans.guessed
        );
    }
    say_losses(record);
    say!("way          {:.2} m", map.path_m);
    say!("keyframes    {} with {} points", map.keyframes, map.points);
    say!(
        "loops        {} closed, {} refused; the last pose moved by {:.3} m",
        record.loops.len(),
        record.refused_loops.len(),
        map.corrected_m
    );
    let elsewhere = |row: &&LoopRow| row.test.is_some_and(LoopTest::is_elsewhere);
    let look_alikes = record.refused_loops.iter().filter(elsewhere).count();
    if look_alikes > 0 {
        say!(
            "             {look_alikes} of the refused fit, but lie beyond what the odometry may have drifted, at several poses, or where \
             what both saw does not make up for a doubtful way: they look alike"
        );
    }
    let memory = cost.peak_memory_bytes.map_or(String::new(), |bytes| format!(", {} MiB", bytes >> 20));
    say!(
        "time         {:.1} s, {:.1} scans/s; {:.1} ms a scan (median; 99 % {:.1}){memory}",
        cost.wall_s,
        cost.scans_per_s,
        cost.median_ms,
        cost.p99_ms
    );
    say!("results      {}", out.display());
}

/// Says how often the sensor was lost, and where the scans are that see no place of the map.
fn say_losses(record: &LidarRecord) {
    if record.scans.losses == 0 {
        return;
    }
    let times = if record.scans.losses == 1 { "once" } else { &*format!("{} times", record.scans.losses) };
    let what = match &record.fragments[..] {
        [_] => "; where it went on is in the map too".to_owned(),
        [_, apart @ ..] => {
            let of = |(place, row): (usize, &FragmentRow)| {
                format!(
                    "{} scans from {:.1} to {:.1} s in map-{}.mcap",
                    row.scans,
                    row.from_s,
                    row.to_s,
                    place + 2
                )
            };
            let parts: Vec<String> = apart.iter().enumerate().map(of).collect();
            format!("; what saw no place of the map is apart: {}", parts.join(", "))
        }
        [] => String::new(),
    };
    say!("lost         {times}{what}");
}
