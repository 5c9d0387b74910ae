//! One run: feeds the agent and keeps the numbers.

mod finishing;
mod items;

use crate::describing::Describer;
use crate::listeners::{Listeners, ProcessedFrame};
use crate::run::Progress;
use crate::run::diagnosis::{ImageStatistics, Losses};
use crate::run::lens_check::LensCheck;
use crate::run::milestones::{Milestones, Standing};
use crate::run::output::Output;
use crate::run::record::FrameRow;
use crate::run::resuming::Kept;
use anyhow::Result;
use geometry::Pinhole;
use map::{Identity, Map, MapDelta};
use slam_direct::{Atlas, Frame, FrameReport, ScaleBreak, TrackingState};
use sources::Stop;
use sources::ahead::{Ahead, Item, SkipReason};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;
use view::watch::{Command, Watch};

/// Rows that are kept of a run that nobody looks after: those of the last hours.
const ROWS_ALONE: usize = 1 << 18;

/// What a run is fed by, who stops it, and whom it tells.
#[derive(Clone, Copy)]
pub struct Feed<'f> {
    pub ahead: &'f Ahead,
    pub stop: &'f Stop,
    pub progress: &'f dyn Progress,
}

/// A run whose frames are processed.
pub struct Run<'a> {
    atlas: Atlas,
    /// The map of an earlier run that this one goes on in.
    kept: Option<&'a Kept>,
    camera: Pinhole,
    /// Whose run it is, in the epoch of the first fragment; of a recording known from the first frame on.
    identity: Option<Identity>,
    /// Finds the keyframes' features, where that is wanted.
    describer: Option<Describer>,
    /// Asks whether the lens is the one of the images.
    check: Option<LensCheck>,
    /// Who are told how the map grows.
    listeners: Listeners,
    /// The fragment that the newest frame was given to.
    fragment: usize,
    rows: Vec<FrameRow>,
    /// Rows of frames before those of `rows`, which are not kept.
    forgotten_rows: u64,
    /// Whether nobody looks after the run.
    is_alone: bool,
    skipped: BTreeMap<SkipReason, u64>,
    /// What was wrong with the first frame that was skipped.
    first_skip: Option<String>,
    losses: Losses,
    has_tracked: bool,
    /// Whether the agent ended its map itself.
    is_whole: bool,
    /// Why a part of the run could not be done.
    broken: Option<String>,
    /// Whether the map waits for room on the disk.
    waits_for_room: bool,
    milestones: Milestones,
    statistics: ImageStatistics,
    last_reason: Option<&'static str>,
    wall_s: f64,
    dropped_before: u64,
    restart: bool,
    /// Why a live source ended though nobody wished it.
    failure: Option<String>,
    /// Where the scale of a map was not carried on, by the first frame of the map that is made of the rest.
    scale_breaks: BTreeMap<u64, ScaleBreak>,
    /// Standard deviations of the logarithm of the scale that is carried on behind keyframes, by the index of the keyframe's frame.
    scale_deviations: BTreeMap<u64, f64>,
}

impl<'a> Run<'a> {
    /// A run that is to begin: of the agent `identity`, where that is known already. `dropped_before` frames were dropped for the runs before.
    pub fn new(atlas: Atlas, camera: Pinhole, identity: Option<Identity>, dropped_before: u64) -> Self {
        Self {
            atlas,
            kept: None,
            camera,
            identity,
            describer: None,
            check: None,
            listeners: Listeners::default(),
            fragment: 0,
            rows: Vec::new(),
            forgotten_rows: 0,
            is_alone: false,
            skipped: BTreeMap::new(),
            first_skip: None,
            losses: Losses::default(),
            has_tracked: false,
            is_whole: true,
            broken: None,
            waits_for_room: false,
            milestones: Milestones::default(),
            statistics: ImageStatistics::default(),
            last_reason: None,
            wall_s: 0.0,
            dropped_before,
            restart: false,
            failure: None,
            scale_breaks: BTreeMap::new(),
            scale_deviations: BTreeMap::new(),
        }
    }

    /// The same, whose keyframes' features `describer` finds, and whose lens `check` asks after.
    pub fn with(self, describer: Option<Describer>, check: Option<LensCheck>) -> Self {
        Self { describer, check, ..self }
    }

    /// The same, which goes on in `kept`, as its atlas does.
    pub fn within(self, kept: Option<&'a Kept>) -> Self {
        Self { kept, ..self }
    }

    /// The same, of whose map `listeners` are told.
    pub fn with_listeners(self, listeners: Listeners) -> Self {
        Self { listeners, ..self }
    }

    /// The same, after which nobody looks if `is_alone`.
    pub fn left_alone(self, is_alone: bool) -> Self {
        Self { is_alone, ..self }
    }

    /// Gives the agent every frame until the recording ends, the user stops it, or who watches wants a new map; calls
    /// `save` when who watches wants the results so far.
    ///
    /// # Errors
    /// When results cannot be written on the way.
    pub fn track(
        mut self,
        feed: Feed,
        output: &mut Output,
        watch: &mut Watch,
        save: &dyn Fn(&Self, &Output, &Watch),
    ) -> Result<Self> {
        let Feed { ahead, stop, progress } = feed;
        let started = Instant::now();
        loop {
            self.wall_s = started.elapsed().as_secs_f64();
            while !self.restart
                && let Some(command) = watch.attend(stop)
            {
                match command {
                    Command::Restart => self.restart = true,
                    _ => save(&self, output, watch),
                }
            }
            if self.restart {
                break;
            }
            let Some(item) = ahead.next_item(stop) else { break };
            let flow = match item {
                Item::Frame(frame, taken) => self.take_frame((frame, taken), feed, output, watch)?,
                Item::Notice(notice) => self.take_notice(&notice, progress, output),
                other => self.note(other, progress),
            };
            if flow.is_break() {
                break;
            }
        }
        if !self.restart {
            ahead.end();
        }
        self.end_map(feed, output, watch);
        self.wall_s = started.elapsed().as_secs_f64();
        Ok(self)
    }

    /// How it goes.
    fn standing(&self, ahead: &Ahead) -> Standing {
        Standing {
            wall_s: self.wall_s,
            frames: self.forgotten_rows + self.rows.len() as u64,
            dropped: ahead.dropped() - self.dropped_before,
            keyframes: self.map().keyframes.len(),
            losses: self.losses.count,
            memory: view::process::memory_bytes(),
        }
    }

    /// Asks and tells whether the lens is the one of the images, when it is time.
    fn check_lens(&mut self, progress: &dyn Progress) {
        let Some(mut check) = self.check.take() else { return };
        check.report(progress, false);
        if check.is_due(self.map().keyframes.len()) {
            check.ask(self.atlas.active().snapshot());
        }
        self.check = Some(check);
    }

    fn process(
        &mut self,
        mut frame: Frame,
        taken: Option<Instant>,
        progress: &dyn Progress,
        dropped: u64,
        watch: &mut Watch,
    ) -> Result<Vec<MapDelta>> {
        // Once a frame was tracked, nobody will ask why none was.
        if !self.has_tracked {
            self.statistics.add(&frame.image);
        }
        frame.index += self.first_index();
        watch.before(&frame);
        let of_recording = || Identity::of_recording(&self.camera, frame.timestamp, &frame.image);
        if self.identity.is_none() {
            let identity = of_recording();
            if let Some(kept) = self.kept {
                kept.refuse_again(&identity)?;
            }
            self.identity = Some(identity);
        }
        self.adopt_features();
        let (index, timestamp) = (frame.index, frame.timestamp);
        let started = Instant::now();
        let mut report = self.atlas.process(frame)?;
        self.has_tracked |= report.state == TrackingState::Tracking;
        if report.fragment != self.fragment {
            self.fragment = report.fragment;
            watch.begin_anew();
            self.note_break(report.scale_break);
        }
        let latency_ms = taken.map(|taken| taken.elapsed().as_secs_f64() * 1e3);
        let ms = started.elapsed().as_secs_f64() * 1e3;
        let row = FrameRow { latency_ms, ..FrameRow::new(index, timestamp, ms, &report) };
        self.last_reason = report.reason.or(self.last_reason);
        progress.frame(&row, self.map().keyframes.len(), report.matched_points);
        self.losses.add(&report, &row, progress);
        let deltas = std::mem::take(&mut report.deltas);
        let map = self.atlas.active().map();
        if let Some(agent) = self.identity_of(self.fragment) {
            let frame = processed((agent, timestamp), &report, &deltas, map);
            self.listeners.notify(|listener| listener.processed(&frame));
        }
        watch.after((index, timestamp, row.ms), latency_ms, report, (&deltas, map), dropped);
        self.keep(row);
        Ok(deltas)
    }

    /// Notes why the fragment begins that the newest frame was given to, if that is because the scale of the one before it is not carried on.
    fn note_break(&mut self, found: Option<ScaleBreak>) {
        let first = self.map().keyframes.values().next().map(|first| first.frame_index);
        self.scale_breaks.extend(first.zip(found));
    }

    /// Keeps the row of a frame; of a run that may go on for ever, those of the last hours.
    fn keep(&mut self, row: FrameRow) {
        if self.is_alone && self.rows.len() >= ROWS_ALONE {
            self.rows.drain(..ROWS_ALONE / 2);
            self.forgotten_rows += (ROWS_ALONE / 2) as u64;
        }
        self.rows.push(row);
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
    fn describe(&self, deltas: &[MapDelta]) {
        let Some(describer) = &self.describer else { return };
        let settled = deltas.iter().flat_map(|delta| &delta.settled);
        let keyframes = settled.filter_map(|settled| self.map().keyframes.get(&settled.keyframe));
        keyframes.for_each(|keyframe| describer.ask(keyframe));
    }

    /// Notifies the listeners of what changed in the map. Who only localises has no map of its own to tell of.
    fn notify_changed(&self, deltas: &[MapDelta]) {
        if let Some(identity) = self.identity_of(self.fragment)
            && self.listeners.are_there()
            && !deltas.is_empty()
            && !self.localises()
        {
            self.listeners.notify(|listener| listener.changed(identity, deltas.to_vec()));
        }
    }

    /// Gives the agent the features that were found meanwhile.
    fn adopt_features(&mut self) {
        let Self { describer, atlas, .. } = self;
        let found = describer.iter().flat_map(Describer::described);
        found.for_each(|found| atlas.describe(found.keyframe, &found.image, &found.features));
    }
}

/// What listeners are told of a frame.
fn processed<'a>(
    (agent, timestamp): (Identity, f64),
    report: &FrameReport,
    deltas: &'a [MapDelta],
    map: &'a Map,
) -> ProcessedFrame<'a> {
    let FrameReport { world_from_camera, covariance, state, reason, scale_break, .. } = *report;
    ProcessedFrame {
        agent,
        timestamp,
        world_from_camera,
        covariance,
        state,
        reason,
        scale_break,
        deltas,
        map,
    }
}

/// Does a part of the run; a panic in it, or in a thread that it waited for, becomes the reason why it did not.
fn guarded<T>(what: &str, work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let why = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("no reason was given");
        format!("internal error in {what}, please report it: {why}")
    })
}
