//! The maps of all agents that are told here, merged as they come.
//!
//! What is there of each map is put together and all of them are merged anew, as `loopbox merge` would: so what comes of
//! it does not depend on the order in which things came, and once all is there it is what a merge of the agents' own
//! files is, bit by bit.

use super::agents::{Inputs, Maps, NotTaken, Place};
use super::courtesy::Courtesy;
use super::findings::found;
use super::listening::CommonListener;
use super::remembering::Content;
use super::scans::ScanCollector;
use super::sketching::{Met, Plan, Sketches};
use crate::merging::{Input, MergeRecord, Merging, MergingParams, Names, merge_knowing, write_results};
use crate::results::{Owner, Results, is_of_the_disk};
use crate::run::give_way;
use anyhow::{Context, Result, anyhow};
use fleet::findings::Found;
use fleet::node::Heard;
use fleet::service::Service;
use map::{Identity, KeyframeId, SensorKind};
use place_recog::Vocabulary;
use sources::Stop;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between merges at the least, and of the time that one took while maps grow.
const PAUSE: Duration = Duration::from_millis(250);
const PAUSE_FACTOR: u32 = 2;
/// How often the common map is written while maps still grow.
pub(super) const WRITE_INTERVAL: Duration = Duration::from_secs(30);
/// How long nothing is tried again after the disk was full.
const RETRY: Duration = Duration::from_secs(5);
/// The folder of the agents' own maps.
const AGENTS: &str = "agents";

/// Merges maps as they come.
pub(super) struct Collector {
    /// The folder of the agents' own maps.
    folder: PathBuf,
    results: Results,
    /// The maps of LiDARs.
    scans: ScanCollector,
    vocabulary: Arc<Vocabulary>,
    params: MergingParams,
    /// Threads that give way to all others, where they do.
    pool: Option<rayon::ThreadPool>,
    /// Maps of which all is fetched, as far as it is here.
    maps: Maps,
    /// Parts of maps by which it is seen whether they met.
    parts: Maps,
    sketches: Sketches,
    courtesy: Courtesy,
    /// What was found by cameras' maps, the parts aside.
    found: Found,
    /// Whether parts were merged last.
    looked: bool,
    merged: Instant,
    took: Duration,
    written: Option<Instant>,
    /// Something of cameras' came that is not merged yet, or merged and not written.
    is_new: bool,
    to_write: bool,
    /// When it is tried again to write what the disk had no room for.
    retried: Option<Instant>,
    /// Who hears of the common maps.
    listeners: Vec<Box<dyn CommonListener>>,
}

impl Collector {
    /// One that writes into `out`; beside others it works on one core, and gives way to them until the end.
    ///
    /// # Errors
    /// When the folder cannot be written to, or holds results of something else.
    pub fn new(out: &Path, force: bool, beside: bool) -> Result<Self> {
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).start_handler(|_| give_way());
        let pool = beside.then(|| one.build()).transpose();
        let vocabulary = Vocabulary::shipped();
        Ok(Self {
            pool: pool.context("cannot start threads")?,
            folder: out.join(AGENTS),
            results: Results::create(out, &Owner::Merge, force)?,
            scans: ScanCollector::new(out, force)?,
            sketches: Sketches::new(Arc::clone(&vocabulary)),
            vocabulary,
            params: MergingParams::default(),
            maps: Maps::default(),
            parts: Maps::default(),
            courtesy: Courtesy::default(),
            found: Found::default(),
            looked: false,
            merged: Instant::now(),
            took: Duration::ZERO,
            written: None,
            is_new: false,
            to_write: false,
            retried: None,
            listeners: Vec::new(),
        })
    }

    /// The same, with who is told of the common maps.
    pub fn heard_by(self, listeners: Vec<Box<dyn CommonListener>>) -> Self {
        Self { listeners, ..self }
    }

    /// Tells those who hear of the common maps that some time went by.
    pub fn remind(&mut self) {
        self.listeners.iter_mut().for_each(|listener| listener.remind());
    }

    /// Takes in what is new and merges it, where it is time. What was found, if anything was looked at; `told` is what
    /// others found. Where the disk is full it waits for room.
    ///
    /// # Errors
    /// When the results cannot be written, for another reason than that.
    pub fn step(
        &mut self,
        service: &Service,
        told: &[Found],
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        match self.go_on(service, told, warn, stop) {
            Err(error) if is_of_the_disk(&error) => {
                warn(&format!("it is waited until there is room on the disk: {error:#}"));
                self.retried = Some(Instant::now() + RETRY);
                // Merged or not, all that is not written is merged anew.
                self.urge();
                Ok(None)
            }
            done => done,
        }
    }

    /// Has all that is not written merged and written next.
    fn urge(&mut self) {
        (self.is_new, self.written) = (self.to_write, None);
        self.scans.urge();
    }

    /// As [`step`](Self::step), but for full disks.
    fn go_on(
        &mut self,
        service: &Service,
        told: &[Found],
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        let all = heard(service);
        let plan = self.plan(&all, service, told, warn);
        if self.retried.is_some_and(|when| Instant::now() < when) {
            return Ok(None);
        }
        // Who waits for runs that are over takes no time from any.
        let is_over = all.iter().all(|heard| heard.finished && heard.missing == 0);
        let pause = if is_over { PAUSE } else { PAUSE.max(self.took * PAUSE_FACTOR) };
        let is_due = self.merged.elapsed() >= pause;
        // In turns, so that neither waits for the other for long.
        if let Some(only) = plan.ready.as_ref().filter(|_| !std::mem::take(&mut self.looked) || !is_due) {
            self.looked = true;
            return self.look_at(only, &all, service, warn, stop);
        }
        if self.sketches.pending().is_empty() {
            self.parts.clear();
        }
        if !is_due {
            return Ok(None);
        }
        self.take_all(&all, &plan.released, service, warn)?;
        if !self.is_new && !self.scans.has_new() {
            let Some(only) = &plan.ready else { return Ok(None) };
            self.looked = true;
            return self.look_at(only, &all, service, warn, stop);
        }
        let start = Instant::now();
        let found = self.merge(warn, stop);
        (self.merged, self.took) = (Instant::now(), start.elapsed());
        found
    }

    /// Has fetched what is worth fetching next.
    fn plan(&mut self, all: &[Heard], service: &Service, told: &[Found], warn: &dyn Fn(&str)) -> Plan {
        let store = service.store();
        let own: Vec<Identity> = service.own().iter().map(|heard| heard.agent).collect();
        let known: Vec<Identity> = all.iter().map(|heard| heard.agent).collect();
        let elsewhere = self.courtesy.left_to_others(&known, &own, told);
        let sketches = &mut self.sketches;
        let mut plan = on_pool(self.pool.as_ref(), || sketches.plan(all, &own, &*store, &elsewhere));
        for (agent, (objects, rest)) in std::mem::take(&mut plan.wanted) {
            service.prefer(agent, objects, rest);
        }
        for (agent, reason) in std::mem::take(&mut plan.wrong) {
            leave_out(agent, reason, service, warn);
        }
        plan
    }

    /// Looks at the parts of the maps by which it is to be seen who met whom. What was found, beside what is known of all
    /// maps; nothing is said yet of those that are to be looked at more closely.
    fn look_at(
        &mut self,
        only: &BTreeMap<Identity, BTreeSet<KeyframeId>>,
        all: &[Heard],
        service: &Service,
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        let store = service.store();
        let place = Place { store: &*store, folder: &self.folder, vocabulary: &self.vocabulary };
        for heard in all {
            let Some(only) = only.get(&heard.agent) else { continue };
            let parts = &mut self.parts;
            match on_pool(self.pool.as_ref(), || parts.take(heard, Some(only), &place)) {
                Ok(_) => {}
                Err(NotTaken::Wrong(reason)) => leave_out(heard.agent, reason, service, warn),
                Err(NotTaken::Unwritten(error)) => return Err(error),
            }
        }
        let lent = self.parts.lend();
        // Parts may have too little depth to be looked at.
        let is_any = lent.inputs.len() > 1;
        let merged = is_any.then(|| self.merged_anew(&lent, &self.parts, false, stop)).transpose();
        let found = match merged {
            Ok(None) | Err(_) => {
                self.sketches.judged(&[], &*store);
                if let (Err(error), false) = (merged, stop.requested()) {
                    warn(&format!("parts of the maps are not merged: {error:#}"));
                }
                None
            }
            Ok(Some(merging)) => {
                self.parts.memory.keep(&lent.contents, &merging.encounters, false);
                self.sketches.judged(&met(&merging, &lent.contents), &*store);
                Some(found(&lent.inputs, &merging, &lent.whole))
            }
        };
        self.parts.take_back(lent);
        let found = found.map(|found| self.pending(found.beside(&self.known())));
        Ok(found)
    }

    /// What was found by all maps.
    fn known(&self) -> Found {
        self.found.clone().and(self.scans.found().clone())
    }

    /// What was found, where nothing is said yet of pairs that are looked at more closely.
    fn pending(&self, mut found: Found) -> Found {
        let pending = self.sketches.pending();
        let names: Vec<[String; 2]> =
            pending.into_iter().map(|pair| pair.map(|agent| agent.to_string())).collect();
        found.postpone(|agents| names.iter().any(|names| agents.iter().all(|agent| names.contains(agent))));
        found
    }

    /// Puts together what is there of the maps of which all is fetched, and writes those that are whole.
    fn take_all(
        &mut self,
        all: &[Heard],
        released: &BTreeSet<Identity>,
        service: &Service,
        warn: &dyn Fn(&str),
    ) -> Result<()> {
        // An agent's own map alone is in its folder already.
        let has_own = !service.own().is_empty();
        if all.len() < 2 && (has_own || !all.iter().any(|heard| heard.finished && heard.missing == 0)) {
            return Ok(());
        }
        let store = service.store();
        let place = Place { store: &*store, folder: &self.folder, vocabulary: &self.vocabulary };
        for heard in all.iter().filter(|heard| released.contains(&heard.agent)) {
            let maps = &mut self.maps;
            match on_pool(self.pool.as_ref(), || maps.take(heard, None, &place)) {
                Ok(Some(SensorKind::Camera)) => (self.is_new, self.to_write) = (true, true),
                Ok(Some(SensorKind::Lidar)) => self.scans.came(),
                Ok(None) => {}
                Err(NotTaken::Wrong(reason)) => leave_out(heard.agent, reason, service, warn),
                Err(NotTaken::Unwritten(error)) => return Err(error),
            }
        }
        Ok(())
    }

    /// Whether so many agents' maps are whole and will not change any more, and all is merged and written.
    pub fn is_done(&self, agents: usize) -> bool {
        self.maps.done() >= agents && !self.is_new && !self.to_write && self.scans.is_done()
    }

    /// Merges and writes what is not yet, in the thread that calls it. What was found, if anything was.
    ///
    /// # Errors
    /// When that cannot be done.
    pub fn finish(&mut self, service: &Service, warn: &dyn Fn(&str)) -> Result<Option<Found>> {
        let all = heard(service);
        let agents = all.iter().map(|heard| heard.agent).collect();
        self.take_all(&all, &agents, service, warn)?;
        self.pool = None;
        self.urge();
        self.merge(warn, &Stop::default())
    }

    /// Merges the maps of either kind of which something is new, and writes what came of it where it is time. What was
    /// found, if anything was merged.
    fn merge(&mut self, warn: &dyn Fn(&str), stop: &Stop) -> Result<Option<Found>> {
        let mut done = Vec::new();
        if std::mem::take(&mut self.is_new) {
            let lent = self.maps.lend();
            done.push(self.merge_lent(&lent, stop));
            self.maps.take_back(lent);
        }
        if self.scans.has_new() {
            let (lent, at_rest) = (self.maps.lend_scans(), self.maps.at_rest(SensorKind::Lidar));
            let (scans, listeners) = (&mut self.scans, &mut self.listeners);
            done.push(on_pool(self.pool.as_ref(), || scans.merge(&lent, at_rest, listeners, stop)));
            self.maps.take_scans_back(lent);
        }
        let mut is_merged = false;
        for result in done {
            match result {
                Ok(()) => is_merged = true,
                Err(Failed::Merge(_)) if stop.requested() => {}
                // What is wrong with these maps may be mended by more of them.
                Err(Failed::Merge(error)) => warn(&format!("the maps are not merged: {error:#}")),
                Err(Failed::Write(error)) => return Err(error),
            }
        }
        Ok(is_merged.then(|| self.pending(self.known())))
    }

    /// Merges maps that were lent by `maps`, but for the pairs that these remember.
    fn merged_anew(&self, lent: &Inputs<Input>, maps: &Maps, exactly: bool, stop: &Stop) -> Result<Merging> {
        let go_on = || if stop.requested() { Err(anyhow!("interrupted")) } else { Ok(()) };
        let known = |pair: [usize; 2]| maps.memory.recall(&lent.contents, pair, exactly);
        let merge = || merge_knowing(&lent.inputs, &self.vocabulary, &self.params, &known, &mut |_| go_on());
        on_pool(self.pool.as_ref(), merge)
    }

    fn merge_lent(&mut self, lent: &Inputs<Input>, stop: &Stop) -> Result<(), Failed> {
        let Inputs { inputs, contents, whole } = lent;
        if inputs.is_empty() {
            self.to_write = false;
            return Ok(());
        }
        let at_rest = self.maps.at_rest(SensorKind::Camera);
        let merging = self.merged_anew(lent, &self.maps, at_rest, stop).map_err(Failed::Merge)?;
        self.maps.memory.keep(contents, &merging.encounters, at_rest);
        self.sketches.met(&met(&merging, contents));
        self.found = found(inputs, &merging, whole);
        self.listeners.iter_mut().for_each(|listener| listener.cameras(&merging.fused));
        let is_due = self.written.is_none_or(|written| written.elapsed() > WRITE_INTERVAL);
        if merging.anything_met() && (at_rest || is_due) {
            let mut write = || -> Result<()> {
                let names = Names::new(&merging.common);
                let mut record = MergeRecord::new(inputs, &merging, &self.params, &names)?;
                write_results(&mut self.results, inputs, &merging, &names, &mut record)?;
                self.results.commit()
            };
            write().map_err(Failed::Write)?;
            self.written = Some(Instant::now());
            self.to_write = false;
        }
        if !merging.anything_met() {
            self.to_write = false;
        }
        Ok(())
    }
}

/// Does something where merging is done.
fn on_pool<T: Send>(pool: Option<&rayon::ThreadPool>, work: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(work),
        None => work(),
    }
}

/// What went wrong.
pub(super) enum Failed {
    /// Maps cannot be merged.
    Merge(anyhow::Error),
    /// Results cannot be written.
    Write(anyhow::Error),
}

/// All maps that are here, whole or in part.
fn heard(service: &Service) -> Vec<Heard> {
    service.heard().into_iter().chain(service.own()).collect()
}

/// Has nothing more to do with whoever told a map that is none.
fn leave_out(agent: Identity, reason: String, service: &Service, warn: &dyn Fn(&str)) {
    warn(&format!("the map of {agent} is left out: {reason}"));
    service.distrust(agent, reason);
}

/// The pairs that met, and whose merge stands.
fn met<'a>(merging: &'a Merging, contents: &[Content]) -> Vec<Met<'a>> {
    let standing = merging.encounters.iter().filter(|encounter| merging.stands(encounter));
    let met = standing.filter_map(|encounter| {
        let agents = [encounter.target, encounter.source].map(|map| contents[map].agent);
        let motion = encounter.accepted()?.closure.motion.a_from_b;
        Some(Met { agents, motion, edges: &encounter.joined.as_ref()?.edges })
    });
    met.collect()
}
