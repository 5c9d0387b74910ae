//! The maps of all agents that are told here, merged as they come.
//!
//! What is there of each map is assembled, and all maps are merged anew. So the result does not depend on the order in which things
//! came, and once all is there it is byte for byte that of `loopbox merge --no-optimise` on the agents' own files. Pairs are verified
//! in batches ([`Share`](crate::merging::Share)): after each batch the agents are told where they are.
//!
//! `parts` looks at parts of maps before all of them is here, `whole` merges all that is here, both by the `merger`;
//! `schedule` says what is due and when. The joint pose graph, which takes seconds of many maps, and the writing of the common
//! map are done in a thread beside that (`optimise_when`). `keeping` keeps verdicts for those who merge the same maps again.

mod keeping;
mod merger;
mod optimisation;
mod parts;
mod planning;
mod schedule;
mod step;
mod whole;
mod worker;

use super::agents::NotUpdated;
use super::common_listener::CommonListener;
use super::components::Components;
use super::prefetch::Plan;
use super::scans::ScanCollector;
use super::waiting::Waits;
use crate::results::{Owner, Results, is_of_the_disk};
use crate::store::Store;
use anyhow::Result;
use fleet::merge_results::MergeResults;
use fleet::service::Service;
use map::{Identity, SensorKind};
use merger::Merger;
use parts::Parts;
use planning::Planner;
use schedule::{Load, Schedule};
use sources::Stop;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use step::Step;
use whole::{OptimiseWhen, Round, Whole};

/// How long maps are taken in before they are merged.
const TAKING: Duration = Duration::from_millis(500);
/// How long pairs that are left are looked at in the end.
const ENDING: Duration = Duration::from_secs(10);
/// The folder of the agents' own maps.
const AGENTS: &str = "agents";
/// The folder of verdicts on pairs of them, as `loopbox merge --verdicts` has it.
const VERDICTS: &str = "verdicts";

/// Merges maps as they come.
pub(super) struct Collector {
    /// The folder of the agents' own maps.
    folder: PathBuf,
    merger: Merger,
    parts: Parts,
    whole: Whole,
    /// The maps of LiDARs.
    scans: ScanCollector,
    planner: Planner,
    /// Who hangs together by all that was found.
    components: Components,
    table: Schedule,
    /// Who hears of the common maps.
    listeners: Vec<Box<dyn CommonListener>>,
}

impl Collector {
    /// One that writes into `out`; beside others it works on one core, and gives way to them until the end.
    ///
    /// # Errors
    /// When the folder cannot be written to, or holds results of something else.
    pub fn new(out: &Path, force: bool, in_background: bool) -> Result<Self> {
        let merger = Merger::new(in_background)?;
        let (parts, components, listeners) = Default::default();
        Ok(Self {
            folder: out.join(AGENTS),
            parts,
            planner: Planner::new(merger.vocabulary.clone()),
            merger,
            whole: Whole::new(
                Results::create(out, &Owner::Merge, force)?,
                out.join(VERDICTS),
                in_background,
            )?,
            scans: ScanCollector::new(out, force)?,
            components,
            table: Schedule::new(Instant::now()),
            listeners,
        })
    }

    /// The same, with who is told of the common maps.
    pub fn with_listeners(self, listeners: Vec<Box<dyn CommonListener>>) -> Self {
        Self { listeners, ..self }
    }

    /// The same, with a store that maps of runs which have ended and verdicts on them are shared in; `warn` is told what goes wrong with it.
    ///
    /// # Errors
    /// When the store cannot be used, or a thread not be started.
    pub fn sharing(mut self, store: &Path, warn: impl Fn(&str) + Send + 'static) -> Result<Self> {
        self.whole.share(Store::at(store)?, warn)?;
        Ok(self)
    }

    /// Tells those who hear of the common maps that some time went by.
    pub fn tick(&mut self) {
        self.listeners.iter_mut().for_each(|listener| listener.tick());
    }

    /// Takes in what is new and merges it, where it is time. What was found, if anything was looked at; `remote_results` is what
    /// others found. Where the disk is full it waits for room.
    ///
    /// # Errors
    /// When the results cannot be written, for another reason than that.
    pub fn step(
        &mut self,
        service: &Service,
        remote_results: &[Arc<MergeResults>],
        warn: &(dyn Fn(&str) + Sync),
        stop: &Stop,
    ) -> Result<Option<MergeResults>> {
        match self.merge_step(&Step::new(service, remote_results, warn, stop)) {
            Err(error) if is_of_the_disk(&error) => {
                warn(&format!("it is waited until there is room on the disk: {error:#}"));
                self.table.found_full(Instant::now());
                // Merged or not, all that is not written is merged anew.
                self.request_write();
                Ok(None)
            }
            done => {
                if let Ok(Some(found)) = &done {
                    self.components = Components::of(found);
                    self.planner.waits.mark_placed(&self.components, Instant::now());
                }
                done
            }
        }
    }

    /// How long agents waited for their places.
    pub fn waits(&self) -> &Waits {
        &self.planner.waits
    }

    /// Whether there is more to do, whatever comes.
    pub fn has_more(&self) -> bool {
        self.table.has_more
    }

    /// Whether so many agents' maps are whole and will not change any more, and all is merged and written.
    pub fn is_done(&self, agents: usize) -> bool {
        self.whole.maps.done() >= agents && self.whole.is_done() && self.scans.is_done()
    }

    /// Merges what is not yet, for some seconds at the most, and writes it, in the thread that calls it, once what is on its way is
    /// done. What was found, if anything was.
    ///
    /// # Errors
    /// When that cannot be done.
    pub fn finish(
        &mut self,
        service: &Service,
        warn: &(dyn Fn(&str) + Sync),
    ) -> Result<Option<MergeResults>> {
        let stop = Stop::default();
        let step = Step::new(service, &[], warn, &stop);
        let optimised = match self.optimised(&step, true) {
            // It is written again.
            Err(error) if is_of_the_disk(&error) => true,
            optimised => optimised?,
        };
        let agents = step.all.iter().map(|snapshot| snapshot.agent).collect();
        self.update_all(&step, &agents, None)?;
        self.merger.make_haste();
        // Whoever ends it does not wait for hundreds of pairs: they are looked at when it goes on.
        let begun = Instant::now();
        self.request_write();
        let mut merged = self.merge(&step, OptimiseWhen::Later, true, false)?;
        while self.whole.is_left && begun.elapsed() < ENDING {
            merged = self.merge(&step, OptimiseWhen::Later, true, false)?.or(merged);
        }
        self.request_write();
        merged = self.merge(&step, OptimiseWhen::Now, true, false)?.or(merged);
        if !self.whole.end_sharing(ENDING) {
            warn(
                "not all is in the store yet\nhint: start the station again in this folder, and it puts the rest",
            );
        }
        Ok(merged.or_else(|| optimised.then(|| self.all_found())))
    }

    /// Has all that is not written merged and written next.
    fn request_write(&mut self) {
        self.table.request_write();
        self.whole.request_write();
        self.scans.request_write();
    }

    /// As [`step`](Self::step), but for full disks.
    fn merge_step(&mut self, step: &Step) -> Result<Option<MergeResults>> {
        let optimised = self.optimised(step, false)?;
        let merged = self.merge_next(step)?;
        Ok(merged.or_else(|| optimised.then(|| self.all_found())))
    }

    /// Merges what is next, where it is time.
    fn merge_next(&mut self, step: &Step) -> Result<Option<MergeResults>> {
        let (planner, components) = (&mut self.planner, &self.components);
        let plan = self.merger.on_pool(|| planner.plan(step, components));
        let waits_for_room = self.table.waits_for_room(Instant::now());
        self.table.has_more = plan.is_cut && !waits_for_room;
        if waits_for_room {
            return Ok(None);
        }
        let load = self.load(step, &plan);
        if load.is_deferred() {
            return Ok(None);
        }
        let is_due = self.table.may_merge(load, Instant::now());
        if plan.ready.is_some() && self.table.are_parts_next(is_due) {
            return self.look_at(step, &plan);
        }
        if self.planner.prefetcher.pending().is_empty() {
            self.parts.tidy();
        }
        if !is_due {
            return Ok(None);
        }
        let is_taken = self.update_all(step, &plan.released, Some(TAKING))?;
        self.whole.look_after(&self.table, Instant::now());
        if !self.whole.is_new && !self.whole.is_left && !self.scans.has_new() {
            return if plan.ready.is_none() { Ok(None) } else { self.look_at(step, &plan) };
        }
        let start = Instant::now();
        let is_awaited = plan.ready.is_some() || plan.is_cut;
        let found = self.merge(step, OptimiseWhen::Background, is_taken, is_awaited);
        self.table.merged(start, Instant::now());
        // What is not taken in yet may be as it was, and yet none of it was merged as that which is to last.
        self.whole.is_new |= !is_taken;
        // One may wait for the other.
        let is_next = self.whole.is_left && self.table.pause(self.load(step, &plan)).is_zero();
        self.table.has_more |= !is_taken || plan.ready.is_some() || is_next;
        found
    }

    /// What there is to do.
    fn load(&self, step: &Step, plan: &Plan) -> Load {
        Load {
            is_over: step.is_over(),
            is_alone: self.merger.is_alone(),
            is_left: self.whole.is_left,
            may_join: self.whole.may_join,
            may_place: plan.pairs.iter().any(|(names, _)| !self.components.are_connected(names)),
            is_coming: !self.scans.has_new() && self.planner.waits.is_coming(Instant::now()),
        }
    }

    /// Looks at the parts of the maps by which it is to be seen who met whom. What was found, beside what is known of all
    /// maps.
    fn look_at(&mut self, step: &Step, plan: &Plan) -> Result<Option<MergeResults>> {
        self.table.parts_looked_at();
        self.parts.take_in(plan, &self.merger, &self.folder, step)?;
        let has_changed = self.parts.look(plan, &self.components, &self.merger, step, &mut self.planner);
        Ok(has_changed.then(|| self.all_found()))
    }

    /// What was found by all maps and beside that by parts, as it is told.
    fn all_found(&self) -> MergeResults {
        let known = self.whole.found.clone().and(self.scans.found().clone());
        self.parts.overlaid_by(&known, self.planner.prefetcher.pending())
    }

    /// Puts together what is there of the maps of which all is fetched, and writes those that are whole; no further one once
    /// that took so long. Whether all are.
    fn update_all(
        &mut self,
        step: &Step,
        released: &BTreeSet<Identity>,
        time: Option<Duration>,
    ) -> Result<bool> {
        let all = &step.all;
        // An agent's own map alone is in its folder already.
        let has_own = !step.service.own().is_empty();
        if all.len() < 2
            && (has_own || !all.iter().any(|snapshot| snapshot.finished && snapshot.missing == 0))
        {
            return Ok(true);
        }
        let begun = Instant::now();
        let place = step.place(&self.folder, &self.merger.vocabulary);
        for snapshot in all.iter().filter(|snapshot| released.contains(&snapshot.agent)) {
            if time.is_some_and(|time| begun.elapsed() >= time) {
                return Ok(false);
            }
            match self.merger.on_pool(|| self.whole.maps.update(snapshot, None, &place)) {
                Ok(Some(SensorKind::Camera)) => self.whole.came(),
                Ok(Some(SensorKind::Lidar)) => self.scans.came(),
                Ok(None) => {}
                Err(NotUpdated::Wrong(reason)) => step.leave_out(snapshot.agent, reason),
                Err(NotUpdated::Unwritten(error)) => return Err(error),
            }
            self.whole.offer();
        }
        Ok(true)
    }

    /// Merges the maps of either kind of which something is new, of cameras' a share of what is left, and writes what
    /// came of it where it is time. What was found, if anything was that is to be told. Not all of the maps may be `is_taken`
    /// in; it `is_awaited` where something else is more urgent than agents that have their places.
    fn merge(
        &mut self,
        step: &Step,
        optimise_when: OptimiseWhen,
        is_taken: bool,
        is_awaited: bool,
    ) -> Result<Option<MergeResults>> {
        let mut done = Vec::new();
        if self.whole.is_new || self.whole.is_left {
            let round = Round { optimise_when, is_taken, is_awaited, components: &self.components, step };
            let (table, planner) = (&mut self.table, &mut self.planner);
            let merged = self.whole.merge(&self.merger, &round, table, planner, &mut self.listeners);
            if let Ok(true) = merged {
                self.parts.supersede(&self.whole.found, self.whole.is_left);
            }
            done.push(merged);
        }
        if self.scans.has_new() {
            let at_rest = self.whole.maps.at_rest(SensorKind::Lidar);
            let lent = self.whole.maps.lend_scans();
            let (scans, listeners) = (&mut self.scans, &mut self.listeners);
            let merged = self.merger.on_pool(|| scans.merge(&lent, at_rest, listeners, step.stop));
            done.push(merged.map(|()| true));
            self.whole.maps.return_scans(lent);
        }
        let mut is_merged = false;
        for result in done {
            is_merged |= step.merged(result)?;
        }
        Ok(is_merged.then(|| self.all_found()))
    }

    /// Takes the common map that was made beside, if it is, or waits for it. Whether anything is to be told.
    fn optimised(&mut self, step: &Step, waits: bool) -> Result<bool> {
        step.merged(self.whole.adopt_finished(waits, &mut self.table, &mut self.listeners))
    }
}
