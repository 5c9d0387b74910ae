//! One run: feeds the agent and keeps the numbers.

use crate::run::Progress;
use crate::run::diagnosis::{ImageStatistics, Losses};
use crate::run::lens_check::LensCheck;
use crate::run::output::Output;
use crate::run::record::{
    Cost, Fragment, FrameCounts, FrameRow, Latency, MapCounts, RunRecord, SourceRecord,
};
use anyhow::Result;
use geometry::Pinhole;
use map::{KeyframeId, Map};
use slam_direct::{Agent, Atlas, Frame};
use sources::ahead::{Ahead, Item, SkipReason};
use sources::notice::Notice;
use sources::{SourceInfo, Stop};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};
use view::process;
use view::watch::{Command, Watch};

/// How long the last optimisation may take once the user wishes to stop.
const LAST_WORK: Duration = Duration::from_secs(4);

/// A run whose frames are processed.
pub struct Run {
    atlas: Atlas,
    check: Option<LensCheck>,
    /// The fragment that the newest frame was given to.
    fragment: usize,
    rows: Vec<FrameRow>,
    skipped: BTreeMap<SkipReason, u64>,
    losses: Losses,
    /// Whether the agent ended its map itself.
    is_whole: bool,
    statistics: ImageStatistics,
    last_reason: Option<&'static str>,
    wall_s: f64,
    dropped_before: u64,
    restart: bool,
    /// Why a live source ended though nobody wished it.
    failure: Option<String>,
}

impl Run {
    /// A run of `atlas` over what comes from `ahead`; `check` asks whether the lens is the one of the images.
    pub fn new(atlas: Atlas, ahead: &Ahead, check: Option<LensCheck>) -> Self {
        Self {
            atlas,
            check,
            fragment: 0,
            rows: Vec::new(),
            skipped: BTreeMap::new(),
            losses: Losses::default(),
            is_whole: true,
            statistics: ImageStatistics::default(),
            last_reason: None,
            wall_s: 0.0,
            dropped_before: ahead.dropped(),
            restart: false,
            failure: None,
        }
    }

    /// Gives the agent every frame until the recording ends, the user stops it, or who watches wants a new map; calls
    /// `save` when who watches wants the results so far.
    ///
    /// # Errors
    /// When results cannot be written on the way.
    pub fn track(
        &mut self,
        ahead: &Ahead,
        stop: &Stop,
        progress: &dyn Progress,
        output: &mut Output,
        watch: &mut Watch,
        save: &dyn Fn(&Self, &Output, &Watch),
    ) -> Result<()> {
        let started = Instant::now();
        let mut broken = None;
        loop {
            self.wall_s = started.elapsed().as_secs_f64();
            while !self.restart
                && let Some(command) = watch.attend(stop)
            {
                match command {
                    Command::Restart => self.restart = true,
                    _ => save(self, output, watch),
                }
            }
            if self.restart {
                break;
            }
            let Some(item) = ahead.next_item(stop) else { break };
            match item {
                Item::Frame(frame, taken) => {
                    let process = || self.process(frame, taken, progress, ahead.dropped(), watch);
                    let Some(settled) = guarded("tracking", process, &mut broken) else { break };
                    let settled = settled?;
                    progress.lost(ahead.dropped(), ahead.missed());
                    output.grow(self.fragment, self.map(), &settled)?;
                    self.check_lens(progress);
                }
                Item::Skipped(skip) => {
                    progress.skipped(&skip);
                    *self.skipped.entry(skip.reason).or_default() += 1;
                }
                Item::Warning(text) => progress.warn(&text),
                Item::Notice(notice) => {
                    progress.notice(&notice);
                    if let Notice::Gone(_) = notice {
                        output.save(self.map())?;
                    }
                }
                Item::Failed(reason) => self.failure = Some(reason),
                Item::Nothing => {}
            }
        }
        if !self.restart {
            ahead.end();
        }
        progress.stage("last optimisation");
        if broken.is_none() {
            let hurry = Instant::now();
            let stop = || stop.requested() && hurry.elapsed() > LAST_WORK;
            guarded("the last optimisation", || self.atlas.finish_until(&stop), &mut broken);
        }
        if let Some(mut check) = self.check.take() {
            // A short recording has said all it will say.
            if check.is_open() && broken.is_none() {
                check.ask(self.snapshot());
            }
            check.tell(progress, true);
        }
        watch.whole(self.map());
        self.is_whole = broken.is_none();
        self.failure = broken.or(self.failure.take());
        self.wall_s = started.elapsed().as_secs_f64();
        Ok(())
    }

    /// Asks and tells whether the lens is the one of the images, when it is time.
    fn check_lens(&mut self, progress: &dyn Progress) {
        let Some(mut check) = self.check.take() else { return };
        check.tell(progress, false);
        if check.is_due(self.map().keyframes.len()) {
            check.ask(self.snapshot());
        }
        self.check = Some(check);
    }

    fn process(
        &mut self,
        frame: Frame,
        taken: Option<Instant>,
        progress: &dyn Progress,
        dropped: u64,
        watch: &mut Watch,
    ) -> Result<Vec<KeyframeId>> {
        // Once there is a map, nobody will ask why there is none.
        if self.map().frames.is_empty() {
            self.statistics.add(&frame.image);
        }
        watch.before(&frame);
        let (index, timestamp) = (frame.index, frame.timestamp);
        let started = Instant::now();
        let report = self.atlas.process(frame)?;
        if report.fragment != self.fragment {
            self.fragment = report.fragment;
            watch.begin_anew();
        }
        let latency_ms = taken.map(|taken| taken.elapsed().as_secs_f64() * 1e3);
        let ms = started.elapsed().as_secs_f64() * 1e3;
        let row = FrameRow { latency_ms, ..FrameRow::new(index, timestamp, ms, &report) };
        self.last_reason = report.reason.or(self.last_reason);
        progress.frame(&row, self.map().keyframes.len(), report.matched_points);
        self.losses.take_in(&report, &row, progress);
        let settled = report.settled_keyframes.clone();
        watch.after((index, timestamp, row.ms), latency_ms, report, self.atlas.active().map(), dropped);
        self.rows.push(row);
        Ok(settled)
    }

    /// Whether who watches wants a new map.
    pub fn is_to_restart(&self) -> bool {
        self.restart
    }

    /// The map of the fragment that the newest frame was given to, as it stands.
    fn map(&self) -> &Map {
        self.atlas.active().map()
    }

    /// The same with its edges and points, to be saved while the run goes on.
    pub fn snapshot(&self) -> Map {
        self.atlas.active().snapshot()
    }

    /// The maps of all fragments, in the order they were begun.
    pub fn maps(&self) -> Vec<Map> {
        let map = |agent: &Agent| {
            let snapshot = || guarded("the map", || agent.snapshot(), &mut None);
            let whole = if self.is_whole { None } else { snapshot() };
            whole.unwrap_or_else(|| agent.map().clone())
        };
        self.atlas.fragments().iter().map(map).filter(|map| !map.frames.is_empty()).collect()
    }

    /// Why a live source ended though nobody wished it.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Why the map is empty, for people.
    pub fn why_nothing_was_tracked(&self) -> String {
        self.statistics.why_nothing_was_tracked(self.last_reason)
    }

    /// The numbers of the run.
    pub fn record(
        &self,
        source: &SourceInfo,
        camera: Pinhole,
        ahead: &Ahead,
        interrupted: bool,
        maps: &[Map],
    ) -> RunRecord {
        let (processed, dropped_late) = (self.rows.len() as u64, ahead.dropped() - self.dropped_before);
        let offered = processed + dropped_late + self.skipped.values().sum::<u64>();
        let fragments: Vec<Fragment> =
            maps.iter().enumerate().map(|(place, map)| Fragment::new(place, map)).collect();
        let tracked = fragments.first().map_or(0, |first| first.frames);
        let ms = self.rows.iter().map(|row| row.ms).collect();
        RunRecord {
            version: env!("CARGO_PKG_VERSION"),
            source: SourceRecord {
                path: source.path.display().to_string(),
                kind: source.kind.to_owned(),
                frames: source.frame_count,
                duration_s: source.duration,
            },
            camera,
            interrupted,
            frames: FrameCounts {
                offered,
                processed,
                dropped_late,
                missed_by_driver: ahead.missed(),
                skipped: self.skipped.clone(),
                tracked,
                tracked_apart: fragments.iter().skip(1).map(|fragment| fragment.frames).sum(),
                tracked_share: tracked as f64 / (offered - dropped_late).max(1) as f64,
                losses: self.losses.count,
            },
            cost: Cost {
                latency_ms: Latency::of(self.rows.iter().filter_map(|row| row.latency_ms).collect()),
                ..Cost::new(ms, self.wall_s, process::cpu_seconds(), process::peak_memory_bytes())
            },
            map: maps.first().map(MapCounts::new).unwrap_or_default(),
            fragments,
            files: Vec::new(),
            rows: self.rows.clone(),
        }
    }
}

/// Does a part of the run; a panic in it, or in a thread that it waited for, becomes the reason in `broken`.
fn guarded<T>(what: &str, work: impl FnOnce() -> T, broken: &mut Option<String>) -> Option<T> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(value) => Some(value),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let why = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("no reason was given");
            *broken = Some(format!("{what} broke down, which is a fault of loopbox: {why}"));
            None
        }
    }
}
