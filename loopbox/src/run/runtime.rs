//! One run: feeds the agent and keeps the numbers.

use crate::run::Progress;
use crate::run::describing::Describer;
use crate::run::diagnosis::{ImageStatistics, Losses};
use crate::run::lens_check::LensCheck;
use crate::run::listening::Listener;
use crate::run::output::Output;
use crate::run::record::{
    Cost, Fragment, FrameCounts, FrameRow, Latency, MapCounts, RunRecord, SourceRecord,
};
use anyhow::Result;
use geometry::Pinhole;
use map::{AgentId, AgentInfo, Described, Identity, Keyframe, KeyframeId, Map, MapDelta};
use slam_direct::{Agent, Atlas, Frame};
use sources::ahead::{Ahead, Item, SkipReason};
use sources::notice::Notice;
use sources::{SourceInfo, Stop};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};
use view::process;
use view::watch::{Command, Watch};

/// How long the last optimisation may take once the user wishes to stop.
const LAST_WORK: Duration = Duration::from_secs(4);

/// A run whose frames are processed.
pub struct Run {
    atlas: Atlas,
    camera: Pinhole,
    /// Whose run it is, in the epoch of the first fragment; of a recording known from the first frame on.
    identity: Option<Identity>,
    /// Finds the keyframes' features, where that is wanted. Whoever saves on the way only looks on.
    describer: RefCell<Option<Describer>>,
    /// Asks whether the lens is the one of the images.
    check: Option<LensCheck>,
    /// Who is told how the map grows.
    listener: Listener,
    /// Keyframes with depth of whose features it was not told yet.
    undescribed: BTreeSet<KeyframeId>,
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
    /// A run that is to begin: of the agent `identity`, where that is known already.
    pub fn new(atlas: Atlas, camera: Pinhole, identity: Option<Identity>, ahead: &Ahead) -> Self {
        Self {
            atlas,
            camera,
            identity,
            describer: RefCell::default(),
            check: None,
            listener: Listener::default(),
            undescribed: BTreeSet::new(),
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

    /// The same, whose keyframes' features `describer` finds, and whose lens `check` asks after.
    pub fn with(self, describer: Option<Describer>, check: Option<LensCheck>) -> Self {
        Self { describer: RefCell::new(describer), check, ..self }
    }

    /// The same, of whose map `listener` is told.
    pub fn told_to(self, listener: Listener) -> Self {
        Self { listener, ..self }
    }

    /// Gives the agent every frame until the recording ends, the user stops it, or who watches wants a new map; calls
    /// `save` when who watches wants the results so far.
    ///
    /// # Errors
    /// When results cannot be written on the way.
    pub fn track(
        self,
        ahead: &Ahead,
        stop: &Stop,
        progress: &dyn Progress,
        output: &mut Output,
        watch: &mut Watch,
        save: &dyn Fn(&Self, &Output, &Watch),
    ) -> Result<Self> {
        let started = Instant::now();
        let mut run = self;
        let mut broken = None;
        loop {
            run.wall_s = started.elapsed().as_secs_f64();
            while !run.restart
                && let Some(command) = watch.attend(stop)
            {
                match command {
                    Command::Restart => run.restart = true,
                    _ => save(&run, output, watch),
                }
            }
            if run.restart {
                break;
            }
            let Some(item) = ahead.next_item(stop) else { break };
            match item {
                Item::Frame(frame, taken) => {
                    let process = || run.process(frame, taken, progress, ahead.dropped(), watch);
                    let Some(settled) = guarded("tracking", process, &mut broken) else { break };
                    let settled = settled?;
                    progress.lost(ahead.dropped(), ahead.missed());
                    run.describe(&settled);
                    run.tell_features(&settled);
                    output.identify(run.identity);
                    output
                        .grow(run.fragment, run.map(), &settled, &|keyframe| run.known_features(keyframe))?;
                    run.check_lens(progress);
                }
                Item::Skipped(skip) => {
                    progress.skipped(&skip);
                    *run.skipped.entry(skip.reason).or_default() += 1;
                }
                Item::Warning(text) => progress.warn(&text),
                Item::Notice(notice) => {
                    progress.notice(&notice);
                    if let Notice::Gone(_) = notice {
                        output.save(run.map(), &|keyframe| run.known_features(keyframe))?;
                    }
                }
                Item::Failed(reason) => run.failure = Some(reason),
                Item::Nothing => {}
            }
        }
        if !run.restart {
            ahead.end();
        }
        progress.stage("last optimisation");
        if broken.is_none() {
            let hurry = Instant::now();
            let stop = || stop.requested() && hurry.elapsed() > LAST_WORK;
            guarded("the last optimisation", || run.atlas.finish_until(&stop), &mut broken);
        }
        if let Some(mut check) = run.check.take() {
            // A short recording has said all it will say.
            if check.is_open() && broken.is_none() {
                check.ask(run.atlas.active().snapshot());
            }
            check.tell(progress, true);
        }
        watch.whole(run.map());
        run.is_whole = broken.is_none();
        run.failure = broken.or(run.failure);
        run.wall_s = started.elapsed().as_secs_f64();
        Ok(run)
    }

    /// Asks and tells whether the lens is the one of the images, when it is time.
    fn check_lens(&mut self, progress: &dyn Progress) {
        let Some(mut check) = self.check.take() else { return };
        check.tell(progress, false);
        if check.is_due(self.map().keyframes.len()) {
            check.ask(self.atlas.active().snapshot());
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
        let of_recording = || Identity::of_recording(&self.camera, frame.timestamp, &frame.image);
        self.identity = self.identity.or_else(|| Some(of_recording()));
        let (index, timestamp) = (frame.index, frame.timestamp);
        let started = Instant::now();
        let report = self.atlas.process(frame)?;
        if report.fragment != self.fragment {
            self.fragment = report.fragment;
            watch.begin_anew();
            self.undescribed.clear();
        }
        if let Some(identity) = self.identity.filter(|_| !report.deltas.is_empty()) {
            let identity = identity.later(self.fragment as u32);
            self.listener.tell(|listener| listener.changed(identity, report.deltas.clone()));
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

    /// Asks for the features of keyframes whose depth has come.
    fn describe(&self, settled: &[KeyframeId]) {
        let mut describer = self.describer.borrow_mut();
        let Some(describer) = describer.as_mut() else { return };
        let keyframes = settled.iter().filter_map(|id| self.map().keyframes.get(id));
        keyframes.for_each(|keyframe| describer.ask(keyframe));
    }

    /// Tells who listens of features that were found since.
    fn tell_features(&mut self, settled: &[KeyframeId]) {
        let Some(identity) = self.identity.filter(|_| self.listener.is_there()) else { return };
        self.undescribed.extend(settled);
        let waiting = self.undescribed.iter().filter_map(|id| self.map().keyframes.get(id));
        let found = |keyframe: &Keyframe| {
            Some(Described { keyframe: keyframe.id, features: self.known_features(keyframe)? })
        };
        let described: Vec<Described> = waiting.filter_map(found).collect();
        if described.is_empty() {
            return;
        }
        for described in &described {
            self.undescribed.remove(&described.keyframe);
        }
        let delta = MapDelta { described, ..MapDelta::default() };
        let identity = identity.later(self.fragment as u32);
        self.listener.tell(|listener| listener.changed(identity, vec![delta]));
    }

    /// The features of a keyframe as far as they are known.
    fn known_features(&self, keyframe: &Keyframe) -> Option<Arc<[u8]>> {
        self.describer.borrow_mut().as_mut()?.known(keyframe)
    }

    /// The same with its edges and points, to be saved while the run goes on, as that of the agent `about`.
    pub fn snapshot(&self, about: &AgentInfo) -> Map {
        let mut map = self.named(about, self.fragment, self.atlas.active().snapshot());
        if let Some(describer) = self.describer.borrow_mut().as_mut() {
            describer.give(&mut map);
        }
        map
    }

    /// The maps of all fragments of the agent `about`, in the order they were begun, with the features of their
    /// keyframes.
    pub fn maps(&mut self, about: &AgentInfo) -> Vec<Map> {
        let map = |agent: &Agent| {
            let snapshot = || guarded("the map", || agent.snapshot(), &mut None);
            let whole = if self.is_whole { None } else { snapshot() };
            whole.unwrap_or_else(|| agent.map().clone())
        };
        let maps = self.atlas.fragments().iter().map(map).enumerate();
        let maps = maps.filter(|(_, map)| !map.frames.is_empty());
        let mut maps: Vec<Map> = maps.map(|(fragment, map)| self.named(about, fragment, map)).collect();
        if let Some(mut describer) = self.describer.take() {
            guarded("finding features", || describer.complete(&mut maps), &mut self.failure);
        }
        maps
    }

    /// A map that says whose it is.
    fn named(&self, about: &AgentInfo, fragment: usize, mut map: Map) -> Map {
        let identity = self.identity.map(|first| first.later(fragment as u32));
        map.agents.insert(AgentId::default(), AgentInfo { identity, ..about.clone() });
        map
    }

    /// Who makes the maps after those of this run.
    pub fn next_identity(&self) -> Option<Identity> {
        self.identity.map(|first| first.later(self.atlas.fragments().len() as u32))
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
