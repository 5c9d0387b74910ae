//! Maps of cameras of which all is fetched: merged as far as it is here, and settled beside that.

use super::keeping::{Asked, Keeper};
use super::merger::{Looking, Merger, SHARE, merged_pairs};
use super::optimisation::{Job, Outcome, optimise};
use super::planning::Planner;
use super::schedule::Schedule;
use super::step::Step;
use super::worker::Worker;
use crate::fleet::agents::{Inputs, Maps};
use crate::fleet::common_listener::CommonListener;
use crate::fleet::common_maps::Failed;
use crate::fleet::components::Components;
use crate::fleet::merge_results::found;
use crate::fleet::remembering::Content;
use crate::merging::{Input, Looked, pairs};
use crate::results::Results;
use crate::store::{Sharing, Store};
use anyhow::Result;
use fleet::merge_results::MergeResults;
use map::{Identity, SensorKind};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// What is known by whole maps.
pub(super) struct Whole {
    /// The maps, those of LiDARs too.
    pub maps: Maps,
    /// What was found by cameras' maps.
    pub found: MergeResults,
    /// Merges that the joint pose graph took back, and why.
    undone: Vec<([Identity; 2], String)>,
    /// The maps of which the agents' places were told last.
    published_maps: Vec<Content>,
    /// Whether pairs are left to be looked at, and whether some of them may give an agent its place.
    pub is_left: bool,
    pub may_join: bool,
    /// Something came, or is to be seen anew, that is not merged yet.
    pub is_new: bool,
    /// Where verdicts on maps that will not change any more are kept.
    verdicts: PathBuf,
    /// The store that maps and verdicts are shared in, if there is one.
    sharing: Option<Sharing>,
    asked: Asked,
    optimiser: Worker<Outcome>,
    /// Where the common map is written; away while it is settled.
    results: Option<Results>,
    states: States,
}

/// States of the merging by number: each differs from the one before by a map or by what a pair made of each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct States {
    /// As it is now.
    now: u64,
    /// That of which the joint pose graph was made last, or was tried.
    optimised: u64,
    /// That which was written last.
    written: u64,
}

/// How whole maps are merged this time.
pub(super) struct Round<'a> {
    pub optimise_when: OptimiseWhen,
    /// Whether all that is here of the maps is taken in.
    pub is_taken: bool,
    /// Whether something is more urgent than agents that have their places, whatever comes.
    pub is_awaited: bool,
    /// Who hangs together by all that was found.
    pub components: &'a Components,
    pub step: &'a Step<'a>,
}

/// Where what the pairs made of each other is settled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OptimiseWhen {
    /// In a thread beside, when it is due.
    Background,
    /// In the thread that calls, now.
    Now,
    /// Later.
    Later,
}

impl Whole {
    /// Of nobody yet; what comes of them is written as these results, and verdicts into a folder.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn new(results: Results, verdicts: PathBuf, in_background: bool) -> Result<Self> {
        let (maps, found, undone, published_maps, states) = Default::default();
        let (is_left, may_join, is_new) = Default::default();
        let (optimiser, results) = (Worker::new(in_background)?, Some(results));
        Ok(Self {
            maps,
            found,
            undone,
            published_maps,
            is_left,
            may_join,
            is_new,
            verdicts,
            sharing: None,
            asked: Asked::default(),
            optimiser,
            results,
            states,
        })
    }

    /// The same, with a store that maps of runs which have ended and verdicts on them are shared in; `warn` is told what goes wrong with it.
    ///
    /// # Errors
    /// When the store cannot be used, or a thread not be started.
    pub fn share(&mut self, store: Store, warn: impl Fn(&str) + Send + 'static) -> Result<()> {
        self.sharing = Some(Sharing::start(store, &self.verdicts, warn)?);
        Ok(())
    }

    /// Has the maps of runs which have ended put into the store.
    pub fn offer(&self) {
        if let Some(sharing) = &self.sharing {
            sharing.offer(self.maps.written());
        }
    }

    /// Puts what is left into the store, for no longer than `patience`; whether all is there.
    pub fn end_sharing(&mut self, patience: Duration) -> bool {
        self.sharing.take().is_none_or(|mut sharing| sharing.finish(patience))
    }

    /// Something came.
    pub fn came(&mut self) {
        self.is_new = true;
        self.states.now += 1;
    }

    /// Whether all is merged and written.
    pub fn is_done(&self) -> bool {
        let is_settled = self.states.optimised == self.states.now && self.optimiser.is_idle();
        !self.is_new && !self.is_left && is_settled && self.states.written == self.states.now
    }

    /// Has what is not written merged again.
    pub fn request_write(&mut self) {
        self.is_new = self.states.written != self.states.now;
    }

    /// Has all merged again where the joint pose graph of it is due.
    pub fn look_after(&mut self, table: &Schedule, now: Instant) {
        let at_rest = !self.is_left && self.maps.at_rest(SensorKind::Camera);
        let is_due =
            self.states.optimised != self.states.now && (at_rest || table.may_optimise(self.is_left, now));
        self.is_new |= is_due && self.optimiser.is_idle();
        self.is_new |= self.sharing.as_ref().is_some_and(Sharing::has_come);
    }

    /// Merges what is new or left; whether anything is to be told.
    ///
    /// # Errors
    /// When the maps cannot be merged, or the results not be written where that is done in this thread.
    pub fn merge(
        &mut self,
        merger: &Merger,
        round: &Round,
        table: &mut Schedule,
        planner: &mut Planner,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        (self.is_new, self.is_left) = (false, false);
        let maps = self.maps.of_cameras();
        let contents = &maps.contents;
        if maps.inputs.is_empty() {
            (self.states.optimised, self.states.written) = (self.states.now, self.states.now);
            return Ok(true);
        }
        let exactly = round.is_taken && self.maps.at_rest(SensorKind::Camera);
        let looked = self.look(&maps, exactly, merger, round, planner)?;
        let (writes, optimises) = self.due(exactly, round.optimise_when, table);
        let is_published =
            !looked.has_changed && self.published_maps == *contents && !table.may_report(Instant::now());
        if self.is_left && is_published && !optimises {
            return Ok(false);
        }
        let undone = self.undone_of(contents);
        let merging = merger.placed(&maps, looked.pair_results, &undone);
        let merging = merging.map_err(|error| self.not_merged(error))?;
        table.mark_published(Instant::now());
        self.published_maps.clone_from(contents);
        let open = self.open(&maps);
        self.found = found(&maps.inputs, &merging, &maps.whole, |pair| open.contains(&pair));
        planner.prefetcher.mark_merged(&merged_pairs(&merging, contents));
        let Some(results) = self.results.take_if(|_| optimises) else { return Ok(true) };
        let (revision, params) = (self.states.now, merger.params.clone());
        let job = Job { revision, maps, open, pair_results: merging.pair_results, params, results, writes };
        if round.optimise_when == OptimiseWhen::Background {
            self.optimiser.start(move || optimise(job)).map_err(Failed::Write)?;
        } else {
            let outcome = merger.on_pool(|| optimise(job));
            self.adopt(outcome, table, listeners)?;
        }
        Ok(true)
    }

    /// Looks at a share of the pairs of these maps of which nothing is known, and takes note of what came of it; `exactly` where all
    /// of the maps is here that is to come.
    fn look(
        &mut self,
        maps: &Inputs<Input>,
        exactly: bool,
        merger: &Merger,
        round: &Round,
        planner: &mut Planner,
    ) -> Result<Looked, Failed> {
        let Round { step, components, .. } = *round;
        let (contents, folder) = (&maps.contents, self.verdicts.clone());
        let keeper = Keeper { folder: &folder, maps, params: &merger.params, warn: step.warn };
        let has_come = self.sharing.as_ref().is_some_and(|sharing| {
            keeper.ask(&self.maps.memory, sharing, &mut self.asked, exactly);
            sharing.take_come()
        });
        let is_recalled = (exactly || has_come) && keeper.recall(&mut self.maps.memory);
        let places = self.maps.memory.remove_places(contents);
        let look = |comes: &(dyn Fn() -> bool + Sync)| {
            let is_awaited = || round.is_awaited || comes();
            let looking = Looking { wanted: None, places, share: SHARE, exactly, is_awaited: &is_awaited };
            merger.look(maps, &self.maps.memory, components, looking, step.stop)
        };
        let looked = match round.optimise_when {
            OptimiseWhen::Background => planner.meanwhile(step, components, merger, &BTreeSet::new(), look),
            OptimiseWhen::Now | OptimiseWhen::Later => look(&|| false),
        };
        let mut looked = looked.map_err(|error| self.not_merged(error))?;
        self.maps.memory.keep(contents, looked.now());
        if exactly {
            keeper.keep(&self.maps.memory, &looked.pair_results);
        }
        self.maps.memory.keep_places(contents, std::mem::take(&mut looked.places));
        let is_changed = is_recalled || looked.now().next().is_some() || self.published_maps != *contents;
        self.states.now += u64::from(is_changed);
        (self.is_left, self.may_join) = (!looked.left.is_empty(), looked.may_join);
        Ok(looked)
    }

    /// Whether the common map is to be written by now, and its joint pose graph to be made, where all of the maps is here that is to
    /// come, or is not, as `exactly` says.
    fn due(&self, exactly: bool, optimise_when: OptimiseWhen, table: &Schedule) -> (bool, bool) {
        let now = Instant::now();
        let is_due = exactly && !self.is_left || optimise_when == OptimiseWhen::Now;
        let writes = self.states.written != self.states.now && (is_due || table.may_write(self.is_left, now));
        let optimises =
            self.states.optimised != self.states.now && (is_due || table.may_optimise(self.is_left, now));
        let may_optimise = self.optimiser.is_idle() && optimise_when != OptimiseWhen::Later;
        (writes, (optimises || writes) && may_optimise)
    }

    /// The maps cannot be merged, which is not tried again before something changes.
    fn not_merged(&mut self, error: anyhow::Error) -> Failed {
        self.states.optimised = self.states.now;
        Failed::Merge(error)
    }

    /// Adopts the common map that was optimised beside, once it is made, or waits for it where that is asked for; whether anything is to be told.
    ///
    /// # Errors
    /// When the maps cannot be merged or the results not be written.
    pub fn adopt_finished(
        &mut self,
        waits: bool,
        table: &mut Schedule,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        let outcome = if waits { self.optimiser.wait() } else { self.optimiser.done() };
        match outcome.map_err(Failed::Write)? {
            Some(outcome) => self.adopt(outcome, table, listeners),
            None => Ok(false),
        }
    }

    /// Adopts an optimised common map: all of it if nothing changed since; else what the joint pose graph took back, and it is told
    /// anew where the agents are without that.
    fn adopt(
        &mut self,
        outcome: Outcome,
        table: &mut Schedule,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        let now = Instant::now();
        self.results = Some(outcome.results);
        table.optimised(outcome.took, now);
        self.states.optimised = outcome.revision;
        let optimised = outcome.optimised.map_err(Failed::Merge)?;
        let is_current = outcome.revision == self.states.now;
        if is_current {
            self.found = optimised.found;
        } else {
            self.is_new |= self.undone != optimised.undone;
        }
        self.undone = optimised.undone;
        listeners.iter_mut().for_each(|listener| listener.cameras(&optimised.fused));
        match optimised.written {
            Some(Err(error)) => return Err(Failed::Write(error)),
            Some(Ok(())) => table.written(now),
            None => {}
        }
        if optimised.written.is_some() || !optimised.has_met {
            self.states.written = outcome.revision;
        }
        Ok(is_current)
    }

    /// The pairs of these maps of which more is to be looked at: a map still grows, or what was looked at is not all that is to
    /// last.
    fn open(&self, maps: &Inputs<Input>) -> BTreeSet<[usize; 2]> {
        let is_settled = |pair: [usize; 2]| {
            let is_over = pair.iter().all(|map| maps.over[*map]);
            let known = self.maps.memory.recall(&maps.contents, pair, true);
            is_over && known.is_some_and(|known| !known.is_due)
        };
        let open = pairs(maps.inputs.len()).filter(|pair| !is_settled(*pair));
        open.flat_map(|[a, b]| [[a, b], [b, a]]).collect()
    }

    /// The merges that the joint pose graph took back, by the numbers of these maps.
    fn undone_of(&self, contents: &[Content]) -> Vec<([usize; 2], String)> {
        let number = |agent: Identity| contents.iter().position(|content| content.agent == agent);
        let numbered = |([a, b], why): &([Identity; 2], String)| {
            let (a, b) = (number(*a)?, number(*b)?);
            Some(([a.min(b), a.max(b)], why.clone()))
        };
        self.undone.iter().filter_map(numbered).collect()
    }
}

#[cfg(test)]
mod tests;
