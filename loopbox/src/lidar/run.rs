//! A recording of scans into a map.

use super::fragments::joined;
use super::guessed::{GuessedRow, doubtful};
use super::mapper::{Mapper, NotMapped};
use super::outlook::{Ranges, too_far, too_few_scans};
use super::poses::GivenPoses;
use super::record::{Cost, FragmentRow, LidarRecord, LoopRow, MapCounts, ScanCounts, SourceRecord};
use super::scan_row::ScanRow;
use anyhow::{Result, bail};
use map::{AgentInfo, Map, SensorKind};
use rustix::time::{ClockId, clock_gettime};
use scans::{NextScan, ScanError, ScanInfo, ScanSource};
use slam_lidar::mapping::{Agent, MappingParams};
use std::cmp::Ordering;
use std::ops::ControlFlow;
use std::time::Instant;

/// What a run is to do.
pub struct RunOptions {
    /// Whose map it is; its sensor is a LiDAR.
    pub about: AgentInfo,
    /// How it is made.
    pub params: MappingParams,
    /// Poses to build it on, in place of tracking.
    pub poses: Option<GivenPoses>,
    /// Only scans with stamps from here, seconds after the first one's.
    pub start: Option<f64>,
    /// Only scans up to here.
    pub end: Option<f64>,
}

/// What happens during a run.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// A scan was taken; the map is as it is now.
    Scan {
        /// The scan.
        row: &'a ScanRow,
        /// Which fragment grows, from 0.
        fragment: usize,
        /// Its map.
        map: &'a Map,
    },
    /// A scan was skipped.
    Skipped {
        /// Its index in the recording.
        index: u64,
        /// The kind of reason.
        reason: &'static str,
        /// The reason in words.
        detail: &'a str,
    },
}

/// What came of a run.
pub struct LidarRun {
    /// The map that most scans have a pose in, then what does not hang together with it, each in a world of its own.
    pub maps: Vec<Map>,
    /// The agent that made most of the first.
    pub agent: Agent,
    /// The numbers; CPU time, memory and files are not filled in.
    pub record: LidarRecord,
}

/// Maps a recording. `observe` is told of every scan; it ends the run with `Break`, and what there is then is the result.
///
/// # Errors
/// When no scan could be used, saying why, or `observe` fails.
pub fn run(
    source: &mut dyn ScanSource,
    options: RunOptions,
    observe: &mut dyn FnMut(Event<'_>) -> Result<ControlFlow<()>>,
) -> Result<LidarRun> {
    let RunOptions { about, params, poses, start, end } = options;
    let (begin, given_poses) = (Instant::now(), poses.is_some());
    let mut span = Span { start, end, first: None };
    let mut intake = Intake {
        mapper: Mapper::new(about, params, poses),
        ranges: Ranges::default(),
        farthest: params.odometry.range.1,
        scans: ScanCounts::default(),
        rows: Vec::new(),
    };
    let mut interrupted = false;
    while let Some(next) = source.next_scan() {
        match span.place(&next) {
            Ordering::Less => continue,
            Ordering::Greater => break,
            Ordering::Equal => {}
        }
        if intake.take(next, observe)?.is_break() {
            interrupted = true;
            break;
        }
    }
    let wall_s = begin.elapsed().as_secs_f64();
    let mut result = intake.into_result(source.info(), wall_s, params)?;
    (result.record.given_poses, result.record.interrupted) = (given_poses, interrupted);
    Ok(result)
}

/// Which scans of a recording are asked for.
struct Span {
    start: Option<f64>,
    end: Option<f64>,
    /// Stamp of the first scan.
    first: Option<f64>,
}

impl Span {
    /// Whether a scan is before, within or after it.
    fn place(&mut self, next: &NextScan) -> Ordering {
        // A scan that is none has no time that others count from.
        let after = match next.scan {
            Ok(_) => next.stamp - *self.first.get_or_insert(next.stamp),
            Err(_) => self.first.map_or(0.0, |first| next.stamp - first),
        };
        if self.start.is_some_and(|start| after < start) {
            Ordering::Less
        } else if self.end.is_some_and(|end| after > end) {
            Ordering::Greater
        } else {
            Ordering::Equal
        }
    }
}

/// Scans on their way into a map, and what became of them.
struct Intake {
    mapper: Mapper,
    ranges: Ranges,
    /// Farthest points that are used, metres.
    farthest: f32,
    scans: ScanCounts,
    rows: Vec<ScanRow>,
}

impl Intake {
    /// Adds a scan to the map or skips it, and tells so.
    fn take(
        &mut self,
        next: NextScan,
        observe: &mut dyn FnMut(Event<'_>) -> Result<ControlFlow<()>>,
    ) -> Result<ControlFlow<()>> {
        self.scans.offered += 1;
        let index = next.index;
        if let Ok(scan) = &next.scan {
            self.scans.stale_points += scan.stale as u64;
            if self.ranges.count() < RANGED {
                self.ranges.add(scan, self.farthest);
            }
        }
        let far = next.scan.as_ref().ok().filter(|_| self.ranges.are_mostly_beyond());
        let taken = match far.and_then(|scan| too_far(scan, self.farthest)) {
            Some(detail) => Err(Skip { reason: "too_few_points", detail }),
            None => map_scan(&mut self.mapper, next, &mut self.scans),
        };
        match taken {
            Ok(row) => {
                self.rows.push(row);
                let (fragment, map) = self.mapper.active_map();
                observe(Event::Scan { row: &row, fragment, map })
            }
            Err(Skip { reason, detail }) => {
                *self.scans.skipped.entry(reason).or_default() += 1;
                self.scans.skipped_first.entry(reason).or_insert_with(|| detail.clone());
                observe(Event::Skipped { index, reason, detail: &detail })
            }
        }
    }

    /// The maps and the numbers of a run that took `wall_s` seconds.
    fn into_result(self, info: &ScanInfo, wall_s: f64, params: MappingParams) -> Result<LidarRun> {
        let Self { mapper, ranges, farthest, mut scans, rows } = self;
        if rows.is_empty() {
            let why = scans.skipped_first.values().next().map_or("there is no scan".to_owned(), Clone::clone);
            bail!("{}: no scan could be used: {why}", info.path.display());
        }
        let fragments = mapper.into_fragments();
        scans.losses = fragments.len() as u64 - 1;
        let (maps, agents): (Vec<Map>, Vec<Agent>) = fragments.into_iter().map(|f| (f.map, f.agent)).unzip();
        let maps = joined(maps);
        let most = agents.into_iter().reduce(|a, b| if b.sweeps().len() > a.sweeps().len() { b } else { a });
        let (Some((map, apart)), Some(agent)) = (maps.split_first(), most) else { bail!("there is no map") };
        scans.tracked_apart = apart.iter().map(|map| map.frames.len() as u64).sum();
        scans.tracked -= scans.tracked_apart;
        let stale = (scans.stale_points > 0).then(|| {
            format!("{} points were left out, whose times are not of their sweep", scans.stale_points)
        });
        let guessed = GuessedRow::of(&rows);
        let warnings = ranges.warning(farthest).into_iter().chain(too_few_scans(&scans)).chain(stale);
        let (ms, cpu_ms) = rows.iter().map(|row| (row.ms, row.cpu_ms)).unzip();
        let record = LidarRecord {
            warnings: warnings.chain(doubtful(&guessed)).collect(),
            point_times: None,
            version: env!("CARGO_PKG_VERSION"),
            commit: crate::program::commit(),
            sensor: SensorKind::Lidar,
            source: SourceRecord::of(info),
            params,
            given_poses: false,
            interrupted: false,
            scans,
            cost: Cost::of(ms, cpu_ms, wall_s),
            map: MapCounts::of(map, &agent, &guessed),
            guessed,
            fragments: maps.iter().map(FragmentRow::of).collect(),
            loops: agent.loops().iter().map(LoopRow::of).collect(),
            refused_loops: agent.refused().iter().map(LoopRow::of_refused).collect(),
            files: Vec::new(),
            rows,
        };
        Ok(LidarRun { maps, agent, record })
    }
}

/// So many scans tell in what unit lengths are.
const RANGED: usize = 20;

/// Why a scan was skipped.
struct Skip {
    reason: &'static str,
    detail: String,
}

impl From<ScanError> for Skip {
    fn from(error: ScanError) -> Self {
        let reason = match error {
            ScanError::Io { .. } => "unreadable",
            ScanError::Format { .. } => "damaged",
            ScanError::TooFew { .. } => "too_few_points",
            ScanError::Flat { .. } => "one_ring",
            ScanError::Mistimed { .. } => "out_of_order",
        };
        Self { reason, detail: error.to_string() }
    }
}

impl From<NotMapped> for Skip {
    fn from(error: NotMapped) -> Self {
        let reason = match error {
            NotMapped::NoRings(_) => "no_rings",
            NotMapped::OutOfOrder(..) => "out_of_order",
            NotMapped::Lost => "lost",
            NotMapped::NoPose(_) => "no_pose",
        };
        Self { reason, detail: error.to_string() }
    }
}

/// Adds a scan to the map.
fn map_scan(mapper: &mut Mapper, next: NextScan, scans: &mut ScanCounts) -> Result<ScanRow, Skip> {
    let scan = next.scan?;
    let (begin, cpu) = (Instant::now(), thread_cpu_seconds());
    let taken = mapper.add_scan(next.index, &scan)?;
    let took = [begin.elapsed().as_secs_f64(), thread_cpu_seconds() - cpu].map(|seconds| 1e3 * seconds);
    scans.tracked += 1;
    scans.timed += u64::from(!scan.times.is_empty());
    scans.degenerate += u64::from(taken.sweep.conditioning.weak > 0);
    scans.guessed += u64::from(taken.sweep.guess.directions > 0);
    Ok(ScanRow::of(next.index, scan.points.len(), took, &taken))
}

/// CPU time of this thread so far, seconds.
fn thread_cpu_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}
