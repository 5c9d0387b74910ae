//! What a run leaves: its maps, whose they are, and its numbers.

use super::{Feed, Run, guarded};
use crate::run::fragment_record::Fragment;
use crate::run::output::Output;
use crate::run::record::{
    Cost, FrameCounts, Latency, LeftOutRecord, MapCounts, RunRecord, Setup, ShutterRecord, SourceRecord,
};
use crate::run::resuming::Kept;
use map::{AgentId, AgentInfo, FramePose, Identity, KeyframeId, Map, StampedPose};
use slam_direct::{Agent, CarriedScale, ResumeMode};
use sources::Stop;
use sources::ahead::Ahead;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};
use view::process;
use view::watch::Watch;

/// How long the last optimisation may take once the user wishes to stop.
const LAST_WORK: Duration = Duration::from_secs(4);
/// The same where nobody looks after the run, and the machine may be about to be switched off.
const LAST_WORK_ALONE: Duration = Duration::from_secs(1);
/// Keyframes of a map that takes some seconds to write.
const LARGE: usize = 500;

impl Run<'_> {
    /// The last optimisation, and what it changes.
    pub(super) fn end_map(
        &mut self,
        Feed { stop, progress, .. }: Feed,
        output: &mut Output,
        watch: &mut Watch,
    ) {
        progress.stage("last optimisation");
        if self.broken.is_none() {
            let hurry = Instant::now();
            let patience = if self.is_alone { LAST_WORK_ALONE } else { LAST_WORK };
            let is_large = self.is_large();
            let stop = || stop.requested() && (is_large || hurry.elapsed() > patience);
            self.broken = guarded("the last optimisation", || self.atlas.finish_until(&stop)).err();
        }
        if let Some(mut check) = self.check.take() {
            check.report(progress, true);
            if check.is_due_at_the_end(self.map().keyframes.len(), self.losses.count > 0)
                && self.broken.is_none()
            {
                check.ask(self.atlas.active().snapshot());
            }
            check.report(progress, true);
        }
        let last = self.atlas.take_deltas();
        watch.finished(&last, self.map());
        if self.leaves_its_maps(stop) && self.broken.is_none() {
            let fragment = self.atlas.active_index();
            output.identify(self.identity_of(fragment));
            if let Err(error) = output.grow(fragment, self.map(), last) {
                self.failure = Some(format!("{error:#}"));
            }
        }
        self.is_whole = self.broken.is_none();
        self.failure = self.broken.take().or(self.failure.take());
    }

    /// The same with its edges and points, to be saved while the run goes on, as that of the agent `about`.
    pub fn snapshot(&self, about: &AgentInfo) -> Map {
        self.named(about, self.fragment, self.atlas.active().snapshot())
    }

    /// Whether the maps are left as they have grown, because the run is to end soon: nobody looks after it, or the map is
    /// [large](Self::is_large). Of a common map that is extended only the agent's own part grows.
    pub fn leaves_its_maps(&self, stop: &Stop) -> bool {
        (self.is_alone || self.is_large()) && stop.requested() && !self.localises() && !self.joins()
    }

    /// Whether optimising and writing the map as a whole takes longer than somebody waits who wishes to stop.
    pub(super) fn is_large(&self) -> bool {
        let [only] = self.atlas.fragments() else { return false };
        only.map().keyframes.len() > LARGE
    }

    /// Gives away the maps of all fragments of the agent `about`, in the order they were begun. In place of the first there is the common map
    /// with it, if it went on in one. `complete`: with the features of all of their keyframes, and each in parts where its scale is not
    /// carried on.
    pub fn maps(&mut self, about: &AgentInfo, complete: bool) -> Vec<Map> {
        let is_whole = self.is_whole;
        let first = self.atlas.fragments().first().filter(|first| !first.map().frames.is_empty());
        let joint = first.and_then(|first| guarded("the map", || first.joint()).ok()).flatten();
        let map = |agent: &mut Agent| {
            let snapshot = || guarded("the map", || agent.snapshot()).ok();
            let carried = || guarded("the scale", || agent.carried_scale()).ok();
            let carried = if complete { carried().unwrap_or_default() } else { CarriedScale::default() };
            let as_it_stands = if is_whole { None } else { snapshot() };
            let map = agent.take_map();
            (as_it_stands.unwrap_or(map), carried)
        };
        let maps: Vec<_> = self.atlas.fragments_mut().iter_mut().map(map).collect();
        let maps = self.parts(maps).into_iter().map(|(fragment, map)| self.named(about, fragment, map));
        let mut maps: Vec<Map> = maps.filter(|map| !map.frames.is_empty()).collect();
        if let Some(mut describer) = self.describer.take().filter(|_| complete) {
            let found = guarded("finding features", || describer.complete(&mut maps));
            self.failure = found.err().or(self.failure.take());
        }
        if let (Some(kept), Some(joint), Some(own)) = (self.kept, joint, maps.first_mut()) {
            match kept.joined(joint, own.clone()) {
                Ok(common) => *own = common,
                Err(error) => self.failure = Some(error.to_string()),
            }
        }
        maps
    }

    /// The maps in parts whose scale is carried throughout, each by the number of a fragment: the first part of a map by its own.
    fn parts(&mut self, maps: Vec<(Map, CarriedScale)>) -> Vec<(usize, Map)> {
        let mut parts = Vec::new();
        let mut next = maps.len();
        for (fragment, (map, CarriedScale { breaks, deviations })) in maps.into_iter().enumerate() {
            let known = deviations
                .iter()
                .filter_map(|known| Some((map.keyframes.get(&known.before)?.frame_index, known.deviation)));
            self.scale_deviations.extend(known);
            let ends: Vec<KeyframeId> = breaks.iter().map(|one| one.before).collect();
            for (part, map) in map.cut_behind(&ends).into_iter().enumerate() {
                let Some(found) = part.checked_sub(1).map(|before| breaks[before]) else {
                    parts.push((fragment, map));
                    continue;
                };
                if let Some(first) = map.keyframes.values().next() {
                    self.scale_breaks.insert(first.frame_index, found);
                }
                parts.push((next, map));
                next += 1;
            }
        }
        parts
    }

    /// Whether the run goes on in a common map, as one more of its agents.
    fn joins(&self) -> bool {
        self.kept.is_some_and(Kept::is_joined)
    }

    /// Whether a frame of a map is this run's, and not of the map that it went on in.
    fn is_own(&self, map: &Map, frame: &FramePose) -> bool {
        if !self.joins() {
            return frame.frame_index >= self.first_index();
        }
        map.keyframes
            .get(&frame.reference)
            .is_some_and(|keyframe| self.is_of_run(map.agents.get(&keyframe.agent)))
    }

    /// Whether an agent is this run's, in whichever of its maps.
    fn is_of_run(&self, agent: Option<&AgentInfo>) -> bool {
        let uuid = |identity: Identity| identity.uuid;
        let agent = agent.and_then(|about| about.identity).map(uuid);
        agent.is_some() && agent == self.identity.map(uuid)
    }

    /// The trajectory of a map: of a common one that was extended, this run's.
    pub fn trajectory(&self, map: &Map) -> Vec<StampedPose> {
        if !self.joins() {
            return map.trajectory();
        }
        map.trajectory_by(|keyframe| self.is_of_run(map.agents.get(&keyframe.agent)))
    }

    /// The maps that others are told of: of common ones those of this run's agents.
    pub fn own_maps<'m>(&self, maps: &'m [Map]) -> Cow<'m, [Map]> {
        if !self.joins() {
            return Cow::Borrowed(maps);
        }
        let is_own = |map: &Map| map.agents.values().any(|about| self.is_of_run(Some(about)));
        Cow::Owned(maps.iter().flat_map(Map::split).filter(is_own).collect())
    }

    /// A map that says whose it is. A common map does.
    fn named(&self, about: &AgentInfo, fragment: usize, mut map: Map) -> Map {
        if map.agents.len() > 1 {
            return map;
        }
        let about = self.continued(fragment).unwrap_or(about);
        let mut about = AgentInfo { identity: self.identity_of(fragment), ..about.clone() };
        // The agent says what it found out of itself.
        let own = map.agents.remove(&AgentId::default());
        about.provenance.extend(own.into_iter().flat_map(|own| own.provenance));
        map.agents.insert(AgentId::default(), about);
        map
    }

    /// Who makes the map of a fragment: the first goes on in a map that was kept, the others are this run's own.
    pub(super) fn identity_of(&self, fragment: usize) -> Option<Identity> {
        match self.continued(fragment) {
            Some(about) => about.identity,
            None => self.identity.map(|first| first.later(fragment as u32)),
        }
    }

    /// The agent whose map that was kept a fragment goes on in; none goes on in a common one as one of its agents.
    fn continued(&self, fragment: usize) -> Option<&AgentInfo> {
        self.kept.filter(|_| fragment == 0)?.about()
    }

    /// The index of the run's first frame.
    pub(super) fn first_index(&self) -> u64 {
        self.kept.map_or(0, |kept| kept.first_index)
    }

    /// Whether frames only get poses in a map that was kept.
    pub fn localises(&self) -> bool {
        self.kept.is_some_and(|kept| kept.mode == ResumeMode::Localising)
    }

    /// Whether a map was begun and left while something moved, and may be of that alone.
    pub fn holds_what_moves(&self, map: &Map) -> bool {
        let ends = map.frames.first().zip(map.frames.last());
        ends.is_some_and(|(first, last)| self.losses.are_of_what_moves(first.frame_index, last.frame_index))
    }

    /// Takes out of the maps the one that was to be gone on in, if no frame of this run is in it: it lies where it lay.
    /// Says so, if what was tracked is in another one.
    pub fn leave_out_kept(&self, maps: &mut Vec<Map>) -> Option<String> {
        let kept = self.kept?;
        maps.retain(|map| map.frames.iter().any(|frame| self.is_own(map, frame)));
        let is_in = self.localises()
            || maps.iter().any(|map| map.frames.iter().any(|frame| !self.is_own(map, frame)));
        let why = match self.rows.iter().filter(|row| row.on_trial).count() {
            0 => "no frame was found in",
            _ => "what is seen resembles a part of, and does not confirm that it is the place of,",
        };
        (!is_in && !maps.is_empty()).then(|| {
            format!(
                "{why} {}, which is as it was; what was tracked is a map of its own\nhint: a recording goes on \
                 in a map where it shows a place of it, from about where the camera was and in a light that still matches",
                kept.record().map
            )
        })
    }

    /// Who makes the maps after those of this run.
    pub fn next_identity(&self) -> Option<Identity> {
        self.identity
            .map(|first| first.later((self.atlas.fragments().len() + self.scale_breaks.len()) as u32))
    }

    /// Why a live source ended though nobody wished it.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Why the map is empty, for people.
    pub fn why_nothing_was_tracked(&self) -> String {
        let doubted = self.rows.iter().filter(|row| row.on_trial).count();
        if let Some(kept) = self.kept.filter(|_| doubted > 0) {
            return format!(
                "{doubted} frames resemble a part of {}, and what they see does not confirm that it is that place: it may be another \
                 one that shares things with it\nhint: show more of the place, from about where the camera was when it was mapped",
                kept.record().map
            );
        }
        let why = self.statistics.why_nothing_was_tracked(self.last_reason, self.first_skip.as_deref());
        match self.kept {
            Some(kept) => format!("{why}\nnone was found in {}", kept.record().map),
            None => why,
        }
    }

    /// Frames that were found where no motion leads to, and have a pose in none of the maps.
    fn doubted(&self, maps: &[Map]) -> u64 {
        let on_trial = self.rows.iter().filter(|row| row.on_trial).map(|row| row.index);
        let mut doubted: BTreeSet<u64> = on_trial.collect();
        if !doubted.is_empty() {
            let own = maps.iter().flat_map(|map| map.frames.iter().filter(|frame| self.is_own(map, frame)));
            own.for_each(|frame| {
                doubted.remove(&frame.frame_index);
            });
        }
        doubted.len() as u64
    }

    /// Frames with a pose in a map that had none when they were processed.
    fn found_later(&self, map: &Map) -> u64 {
        let row = |index: u64| self.rows.binary_search_by_key(&index, |row| row.index).ok();
        let had_none = |index| row(index).is_some_and(|row| self.rows[row].handed_out.is_none());
        let own = map.frames.iter().filter(|frame| self.is_own(map, frame));
        own.filter(|frame| had_none(frame.frame_index)).count() as u64
    }

    /// The numbers of the run.
    pub fn record(&self, setup: &Setup, ahead: &Ahead, interrupted: bool, maps: &[Map]) -> RunRecord {
        let processed = self.forgotten_rows + self.rows.len() as u64;
        let dropped_late = ahead.dropped() - self.dropped_before;
        let offered = processed + dropped_late + self.skipped.values().sum::<u64>();
        let fragments: Vec<Fragment> = maps
            .iter()
            .enumerate()
            .map(|(place, map)| Fragment::new(place, map, &self.scale_breaks, &self.scale_deviations))
            .collect();
        let own = |map: &Map| map.frames.iter().filter(|frame| self.is_own(map, frame)).count() as u64;
        let tracked = maps.first().map_or(0, own);
        let found_later = maps.iter().map(|map| self.found_later(map)).sum();
        let doubted = self.doubted(maps);
        let ms = self.rows.iter().map(|row| row.ms).collect();
        RunRecord {
            version: env!("CARGO_PKG_VERSION"),
            commit: crate::program::commit(),
            source: SourceRecord::new(&setup.source),
            camera: setup.camera,
            calibration: setup.calibration.clone(),
            params: setup.params.clone(),
            left_out: LeftOutRecord::new(self.atlas.active().left_out()),
            resumed: self.kept.map(Kept::record),
            interrupted,
            frames: FrameCounts {
                offered,
                processed,
                dropped_late,
                missed_by_driver: ahead.missed(),
                skipped: self.skipped.clone(),
                tracked,
                tracked_apart: maps.iter().skip(1).map(own).sum(),
                found_later,
                doubted,
                tracked_share: tracked as f64 / (offered - dropped_late).max(1) as f64,
                losses: self.losses.count,
                losses_of_scale: self.losses.of_scale,
                losses_of_motion: self.losses.of_motion.len() as u64,
                scale_breaks: self.scale_breaks.len() as u64,
                scale_doubts: fragments.iter().map(|one| one.scale_doubts.len() as u64).sum(),
            },
            cost: Cost {
                latency_ms: Latency::of(self.rows.iter().filter_map(|row| row.latency_ms).collect()),
                ..Cost::new(ms, self.wall_s, process::cpu_seconds(), process::peak_memory_bytes())
            },
            shutter: maps.first().and_then(ShutterRecord::new),
            map: maps.first().map(MapCounts::new).unwrap_or_default(),
            fragments,
            revisits: Vec::new(),
            files: Vec::new(),
            rows: self.rows.clone(),
        }
    }
}
