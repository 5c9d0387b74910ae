//! The numbers of a LiDAR agent's run: what `run.json` holds and the report shows.

use super::guessed::{GuessedRow, metres};
use super::scan_row::ScanRow;
use map::{Map, SensorKind};
use scans::ScanInfo;
use serde::Serialize;
use slam_lidar::loop_verdict::LoopTest;
use slam_lidar::mapping::{Agent, Loop, MappingParams, RefusedLoop};
use std::collections::BTreeMap;

/// Everything counted and measured in one run.
#[derive(Clone, Debug, Serialize)]
pub struct LidarRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The commit that it was built from, where it is known.
    pub commit: Option<&'static str>,
    /// What the agent sees with.
    pub sensor: SensorKind,
    /// The recording.
    pub source: SourceRecord,
    /// What makes the map doubtful, for people.
    pub warnings: Vec<String>,
    /// Whence the times of points are known, or why they are not, for people; `None` where nobody looked.
    pub point_times: Option<String>,
    /// The parameters, the odometry's name among them.
    pub params: MappingParams,
    /// Whether poses were given, so that nothing was tracked.
    pub given_poses: bool,
    /// Whether the user ended the run before the recording did.
    pub interrupted: bool,
    /// Scans by what became of them.
    pub scans: ScanCounts,
    /// Time and memory.
    pub cost: Cost,
    /// The map at the end.
    pub map: MapCounts,
    /// The maps of the run, that of most scans first: more than one where the sensor was carried away and nothing joins them.
    pub fragments: Vec<FragmentRow>,
    /// Stretches of the path whose scans do not determine all of the motion: there it is guessed, and the map is doubtful.
    pub guessed: Vec<GuessedRow>,
    /// Loops closed.
    pub loops: Vec<LoopRow>,
    /// Places that were registered and refused.
    pub refused_loops: Vec<LoopRow>,
    /// The files of results, by names relative to their folder.
    pub files: Vec<String>,
    /// Each scan that was taken.
    pub rows: Vec<ScanRow>,
}

/// The recording of a run.
#[derive(Clone, Debug, Serialize)]
pub struct SourceRecord {
    /// Its path as given.
    pub path: String,
    /// Its kind, for people.
    pub kind: String,
    /// Scans in it, where the source can tell.
    pub scans: Option<u64>,
    /// Seconds from the first to the last scan, where the source can tell.
    pub duration_s: Option<f64>,
}

impl SourceRecord {
    /// That of a source.
    pub fn of(info: &ScanInfo) -> Self {
        Self {
            path: info.path.display().to_string(),
            kind: info.kind.clone(),
            scans: info.count,
            duration_s: info.duration,
        }
    }
}

/// Scans by what became of them.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ScanCounts {
    /// Scans that the source gave.
    pub offered: u64,
    /// Scans with a pose in the first map.
    pub tracked: u64,
    /// Scans with a pose in another.
    pub tracked_apart: u64,
    /// How often the sensor was lost and another map begun.
    pub losses: u64,
    /// Of all with a pose, scans whose points had times: the others were taken as rigid.
    pub timed: u64,
    /// Points that were left out since their times are not of their sweep.
    pub stale_points: u64,
    /// Of all with a pose, scans that determine a direction of the pose badly.
    pub degenerate: u64,
    /// Of all with a pose, scans of stretches in which a direction of the translation is guessed: along it the sensor is taken to keep its
    /// velocity.
    pub guessed: u64,
    /// Scans skipped, by reason.
    pub skipped: BTreeMap<&'static str, u64>,
    /// The first of each reason, in words.
    pub skipped_first: BTreeMap<&'static str, String>,
}

/// Time and memory.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Cost {
    /// Seconds from the first scan to the finished map.
    pub wall_s: f64,
    /// Scans per wall second.
    pub scans_per_s: f64,
    /// Time the agent took for a scan, half of them are faster, milliseconds.
    pub median_ms: f64,
    /// CPU time of the agent's thread for a scan, median, milliseconds; it does not depend on what else runs.
    pub median_cpu_ms: f64,
    /// 99th percentile of it.
    pub p99_ms: f64,
    /// The longest: a loop, if there was one.
    pub max_ms: f64,
    /// CPU seconds of all threads; who runs the program fills it in, as what follows.
    pub cpu_s: Option<f64>,
    /// Largest resident memory of the process, bytes.
    pub peak_memory_bytes: Option<u64>,
}

impl Cost {
    /// Of scans that took so long each, by the clock and of the CPU, and the whole.
    pub fn of(mut ms: Vec<f64>, mut cpu_ms: Vec<f64>, wall_s: f64) -> Self {
        ms.sort_by(f64::total_cmp);
        cpu_ms.sort_by(f64::total_cmp);
        let at = |of: &[f64], percent: usize| {
            of.get((of.len() * percent).div_ceil(100).saturating_sub(1)).copied().unwrap_or(0.0)
        };
        Self {
            wall_s,
            scans_per_s: if wall_s > 0.0 { ms.len() as f64 / wall_s } else { 0.0 },
            median_ms: at(&ms, 50),
            median_cpu_ms: at(&cpu_ms, 50),
            p99_ms: at(&ms, 99),
            max_ms: at(&ms, 100),
            ..Self::default()
        }
    }
}

/// The map in numbers.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MapCounts {
    /// Keyframes.
    pub keyframes: usize,
    /// Points of their scans.
    pub points: usize,
    /// Length of the way, metres.
    pub path_m: f64,
    /// How far the loops moved the last pose, metres.
    pub corrected_m: f64,
    /// Metres of the path that are guessed, before loops.
    pub guessed_m: f64,
}

impl MapCounts {
    /// Those of a map, the agent that made it, and the stretches of its path that are guessed.
    pub fn of(map: &Map, agent: &Agent, guessed: &[GuessedRow]) -> Self {
        let scans = map.keyframes.values().filter_map(|keyframe| keyframe.scan.as_ref());
        let (smoothed, tracked) = (agent.trajectory(), agent.odometry());
        let ends = smoothed.last().zip(tracked.last());
        Self {
            keyframes: map.keyframes.len(),
            points: scans.map(|scan| scan.len()).sum(),
            path_m: map.summary(None).path_length,
            corrected_m: ends.map_or(0.0, |((_, a), (_, b))| (a.translation - b.translation).norm()),
            guessed_m: metres(guessed),
        }
    }
}

/// A map of a run.
#[derive(Clone, Debug, Serialize)]
pub struct FragmentRow {
    /// Scans with a pose in it.
    pub scans: usize,
    /// Instants of the first and the last of them, seconds.
    pub from_s: f64,
    /// See `from_s`.
    pub to_s: f64,
    /// Its keyframes.
    pub keyframes: usize,
    /// How many maps that a loss ended are joined in it.
    pub joined: usize,
}

impl FragmentRow {
    /// That of a map.
    pub fn of(map: &Map) -> Self {
        let time = |frame: Option<&map::FramePose>| frame.map_or(0.0, |frame| frame.timestamp);
        Self {
            scans: map.frames.len(),
            from_s: time(map.frames.first()),
            to_s: time(map.frames.last()),
            keyframes: map.keyframes.len(),
            joined: map.agents.len(),
        }
    }
}

/// A place that was found again, or that was not believed to be the same.
#[derive(Clone, Debug, Serialize)]
pub struct LoopRow {
    /// The earlier keyframe.
    pub from: usize,
    /// The later one.
    pub to: usize,
    /// Share of points on surfaces of the other, 0–1.
    pub overlap: f64,
    /// Share of the points that agree with them.
    #[serde(rename = "agreeing")]
    pub inlier_ratio: f64,
    /// Share of the points in space that the other saw free.
    pub violated: f64,
    /// Root mean square distance from surfaces, metres.
    pub rmse_m: f64,
    /// Distance of the two keyframes, metres.
    pub distance_m: f64,
    /// Of a place that is refused: the test that it fails.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub test: Option<LoopTest>,
    /// The same in words, with the test's figure and its bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl LoopRow {
    /// That of a loop.
    pub fn of(found: &Loop) -> Self {
        let evidence = &found.alignment.evidence;
        Self {
            from: found.from,
            to: found.to,
            overlap: evidence.overlap,
            inlier_ratio: evidence.inlier_ratio,
            violated: evidence.violated,
            rmse_m: evidence.rmse,
            distance_m: found.alignment.target_from_source.translation.norm(),
            test: None,
            reason: None,
        }
    }

    /// That of a place that is refused.
    pub fn of_refused(refused: &RefusedLoop) -> Self {
        let RefusedLoop { candidate, line } = refused;
        Self { test: Some(line.test), reason: Some(line.to_string()), ..Self::of(candidate) }
    }
}
