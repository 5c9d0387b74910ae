//! The maps of all agents that are told here, merged as they come.
//!
//! What is there of each map is put together and all of them are merged anew, as `loopbox merge` would: so what comes of
//! it does not depend on the order in which things came, and once all is there it is what a merge of the agents' own
//! files is, bit by bit. That is done in goes ([`Share`]): a few pairs are looked at, the agents are told where they are by
//! then, and the next few follow.

use super::agents::{Inputs, Maps, NotTaken, Place};
use super::company::Company;
use super::courtesy::Courtesy;
use super::findings::found;
use super::listening::CommonListener;
use super::remembering::Content;
use super::scans::ScanCollector;
use super::sketching::{Met, Plan, Sketches};
use crate::merging::{
    Encounter, Go, Groups, Input, Looked, MergeRecord, Merging, MergingParams, Names, Places, Share,
    common_map, look, write_results,
};
use crate::results::{Owner, Results, is_of_the_disk};
use crate::run::give_way;
use anyhow::{Context, Result, anyhow};
use fleet::findings::{Found, FoundAgent};
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
/// How much is looked at in a go, of whole maps and of parts.
const SHARE: Share = Share { pairs: 64, time: Duration::from_millis(500) };
/// How long maps are taken in before they are merged, and how long it is looked for what to fetch before that is fetched.
const TAKING: Duration = Duration::from_millis(500);
const PLANNING: Duration = Duration::from_millis(200);
/// How long whole maps wait where parts may give an agent its place.
const TURN: Duration = Duration::from_secs(3);
/// How often is told what moves nobody.
const TELL_INTERVAL: Duration = Duration::from_secs(2);
/// Time between joint pose graphs in terms of that which one takes, while pairs are left.
const SETTLE_FACTOR: u32 = 10;
/// How much longer neither is done where somebody waits for a place.
const PATIENCE_FACTOR: u32 = 3;
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
    /// Keyframes by which parts were looked at; what was looked at once is not taken away from them.
    only: BTreeMap<Identity, BTreeSet<KeyframeId>>,
    /// What was found by cameras' maps, the parts aside.
    found: Found,
    /// What was found by parts, beside which whole maps are looked at.
    of_parts: Found,
    /// Who hangs together by all of it.
    company: Company,
    /// Whether pairs of whole maps are left to be looked at, and whether some of them may give an agent its place.
    left: bool,
    may_join: bool,
    /// Whether there is more to do at once.
    has_more: bool,
    /// Merges that the joint pose graph took back, and why.
    undone: Vec<([Identity; 2], String)>,
    /// The maps of which the common map was made last, when it was told, and when keyframes were optimised and how long that
    /// took.
    made_of: Vec<Content>,
    told: Instant,
    settled: Instant,
    settling: Duration,
    /// Whether parts were merged last.
    looked: bool,
    merged: Instant,
    took: Duration,
    begun: Instant,
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
            only: BTreeMap::new(),
            found: Found::default(),
            of_parts: Found::default(),
            company: Company::default(),
            left: false,
            may_join: false,
            has_more: false,
            undone: Vec::new(),
            made_of: Vec::new(),
            told: Instant::now(),
            settled: Instant::now(),
            settling: Duration::ZERO,
            looked: false,
            merged: Instant::now(),
            took: Duration::ZERO,
            begun: Instant::now(),
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
        let done = self.go_on(service, told, warn, stop);
        if let Ok(Some(found)) = &done {
            self.company = Company::of(found);
        }
        match done {
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

    /// Whether there is more to do, whatever comes.
    pub fn has_more(&self) -> bool {
        self.has_more
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
        self.has_more = plan.is_cut;
        if self.retried.is_some_and(|when| Instant::now() < when) {
            self.has_more = false;
            return Ok(None);
        }
        let is_due = self.merged.elapsed() >= self.pause(&all);
        // In turns, so that neither waits for the other for long; whole maps for longer where an agent waits for its place.
        let may_place = plan.pairs.iter().any(|(names, _)| !self.company.are_one(names));
        let is_late =
            self.merged.elapsed() >= if may_place && !self.may_join { TURN } else { Duration::ZERO };
        let is_due = is_due && is_late;
        if plan.ready.is_some() && (!std::mem::take(&mut self.looked) || !is_due) {
            self.looked = true;
            return self.look_at(&plan, &all, service, warn, stop);
        }
        if self.sketches.pending().is_empty() {
            self.parts.clear();
            self.only.clear();
        }
        if !is_due {
            return Ok(None);
        }
        let is_taken = self.take_all(&all, &plan.released, Some(TAKING), service, warn)?;
        if !self.is_new && !self.left && !self.scans.has_new() {
            if plan.ready.is_none() {
                return Ok(None);
            }
            self.looked = true;
            return self.look_at(&plan, &all, service, warn, stop);
        }
        let start = Instant::now();
        let arrivals = service.arrivals();
        let is_awaited = || plan.ready.is_some() || plan.is_cut || service.arrivals() != arrivals;
        let found = self.merge(Some(SHARE), is_taken, &is_awaited, warn, stop);
        (self.merged, self.took) = (Instant::now(), start.elapsed());
        // What is not taken in yet may be as it was, and yet none of it was merged as that which is to last.
        self.is_new |= !is_taken;
        // One may wait for the other.
        self.has_more |= !is_taken || plan.ready.is_some() || self.left && self.pause(&all).is_zero();
        found
    }

    /// How long it is not merged after it was.
    fn pause(&self, all: &[Heard]) -> Duration {
        let is_alone = self.pool.is_none();
        // Who waits for runs that are over takes no time from any, and no more does a station that has pairs left which may
        // give an agent its place.
        let is_over = all.iter().all(|heard| heard.finished && heard.missing == 0);
        match self.left && (is_over || is_alone && self.may_join) {
            true => Duration::ZERO,
            false if is_over => PAUSE,
            false => PAUSE.max(self.took * PAUSE_FACTOR),
        }
    }

    /// Has fetched what is worth fetching next.
    fn plan(&mut self, all: &[Heard], service: &Service, told: &[Found], warn: &dyn Fn(&str)) -> Plan {
        let store = service.store();
        let own: Vec<Identity> = service.own().iter().map(|heard| heard.agent).collect();
        let known: Vec<Identity> = all.iter().map(|heard| heard.agent).collect();
        let elsewhere = self.courtesy.left_to_others(&known, &own, told);
        let sketches = &mut self.sketches;
        let company = &self.company;
        let begun = Instant::now();
        let mut plan = on_pool(self.pool.as_ref(), || {
            let mut plan = || sketches.plan(all, &own, &*store, &elsewhere, company);
            let mut last = plan();
            while last.is_cut && last.ready.is_none() && begun.elapsed() < PLANNING {
                last = plan();
            }
            last
        });
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
        plan: &Plan,
        all: &[Heard],
        service: &Service,
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        self.has_more = true;
        for (agent, keyframes) in plan.ready.iter().flatten() {
            self.only.entry(*agent).or_default().extend(keyframes);
        }
        let arrivals = service.arrivals();
        let is_awaited = || plan.is_cut || service.arrivals() != arrivals;
        let store = service.store();
        let place = Place { store: &*store, folder: &self.folder, vocabulary: &self.vocabulary };
        for heard in all {
            let Some(only) = self.only.get(&heard.agent) else { continue };
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
        let merged = is_any.then(|| self.looked_at(&lent, &plan.pairs, &is_awaited, stop)).transpose();
        let found = match merged {
            Ok(None) | Err(_) => {
                self.sketches.judged(&[], &BTreeSet::new(), &*store);
                if let (Err(error), false) = (merged, stop.requested()) {
                    warn(&format!("parts of the maps are not merged: {error:#}"));
                }
                None
            }
            Ok(Some((left, merging))) => {
                self.sketches.judged(&met(&merging, &lent.contents), &left, &*store);
                Some(found(&lent.inputs, &merging, &lent.whole))
            }
        };
        self.parts.take_back(lent);
        let Some(found) = found else { return Ok(None) };
        self.of_parts = found;
        Ok(Some(self.all_found()))
    }

    /// Looks at some of these pairs of parts. Those that are left, and what came of all of them.
    fn looked_at(
        &mut self,
        lent: &Inputs<Input>,
        pairs: &[([Identity; 2], f32)],
        is_awaited: &(dyn Fn() -> bool + Sync),
        stop: &Stop,
    ) -> Result<(BTreeSet<[Identity; 2]>, Merging)> {
        let numbers: BTreeMap<Identity, usize> =
            lent.contents.iter().enumerate().map(|(number, content)| (content.agent, number)).collect();
        let numbered = |(names, likeness): &([Identity; 2], f32)| {
            let (a, b) = (*numbers.get(&names[0])?, *numbers.get(&names[1])?);
            Some(([a.min(b), a.max(b)], *likeness))
        };
        let wanted = Some(pairs.iter().filter_map(numbered).collect());
        let (places, share) = (BTreeMap::new(), Some(SHARE));
        let looking = Looking { wanted, places, share, exactly: false, is_awaited };
        let looked = self.look(lent, &self.parts, looking, stop)?;
        self.parts.memory.keep(&lent.contents, looked.now());
        let left = looked.left.iter().map(|pair| {
            let [a, b] = pair.map(|map| lent.contents[map].agent);
            [a.min(b), a.max(b)]
        });
        let left = left.collect();
        let merging = self.made(lent, looked.encounters, false, &[])?;
        Ok((left, merging))
    }

    /// What was found by all maps.
    fn known(&self) -> Found {
        self.found.clone().and(self.scans.found().clone())
    }

    /// What was found by all maps and beside that by parts, as it is told.
    fn all_found(&self) -> Found {
        self.pending(self.of_parts.clone().beside(&self.known()))
    }

    /// What was found, where nothing is said yet of pairs that are looked at more closely.
    fn pending(&self, mut found: Found) -> Found {
        let pending = self.sketches.pending();
        let names: Vec<[String; 2]> =
            pending.into_iter().map(|pair| pair.map(|agent| agent.to_string())).collect();
        found.postpone(|agents| names.iter().any(|names| agents.iter().all(|agent| names.contains(agent))));
        found
    }

    /// Puts together what is there of the maps of which all is fetched, and writes those that are whole; no further one once
    /// that took so long. Whether all are.
    fn take_all(
        &mut self,
        all: &[Heard],
        released: &BTreeSet<Identity>,
        time: Option<Duration>,
        service: &Service,
        warn: &dyn Fn(&str),
    ) -> Result<bool> {
        // An agent's own map alone is in its folder already.
        let has_own = !service.own().is_empty();
        if all.len() < 2 && (has_own || !all.iter().any(|heard| heard.finished && heard.missing == 0)) {
            return Ok(true);
        }
        let begun = Instant::now();
        let store = service.store();
        let place = Place { store: &*store, folder: &self.folder, vocabulary: &self.vocabulary };
        for heard in all.iter().filter(|heard| released.contains(&heard.agent)) {
            if time.is_some_and(|time| begun.elapsed() >= time) {
                return Ok(false);
            }
            let maps = &mut self.maps;
            match on_pool(self.pool.as_ref(), || maps.take(heard, None, &place)) {
                Ok(Some(SensorKind::Camera)) => (self.is_new, self.to_write) = (true, true),
                Ok(Some(SensorKind::Lidar)) => self.scans.came(),
                Ok(None) => {}
                Err(NotTaken::Wrong(reason)) => leave_out(heard.agent, reason, service, warn),
                Err(NotTaken::Unwritten(error)) => return Err(error),
            }
        }
        Ok(true)
    }

    /// Whether so many agents' maps are whole and will not change any more, and all is merged and written.
    pub fn is_done(&self, agents: usize) -> bool {
        self.maps.done() >= agents && !self.is_new && !self.left && !self.to_write && self.scans.is_done()
    }

    /// Merges and writes what is not yet, in the thread that calls it. What was found, if anything was.
    ///
    /// # Errors
    /// When that cannot be done.
    pub fn finish(&mut self, service: &Service, warn: &dyn Fn(&str)) -> Result<Option<Found>> {
        let all = heard(service);
        let agents = all.iter().map(|heard| heard.agent).collect();
        self.take_all(&all, &agents, None, service, warn)?;
        self.pool = None;
        self.urge();
        self.merge(None, true, &|| false, warn, &Stop::default())
    }

    /// Merges the maps of either kind of which something is new, of cameras' a `share` of what is left or all, and writes what
    /// came of it where it is time. What was found, if anything was that is to be told. Not all of the maps may be `taken` in;
    /// it `is_awaited` where something else is more urgent than agents that have their places.
    fn merge(
        &mut self,
        share: Option<Share>,
        taken: bool,
        is_awaited: &(dyn Fn() -> bool + Sync),
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        let mut done = Vec::new();
        if std::mem::take(&mut self.is_new) | std::mem::take(&mut self.left) {
            let lent = self.maps.lend();
            done.push(self.merge_lent(&lent, share, taken, is_awaited, stop));
            self.maps.take_back(lent);
        }
        if self.scans.has_new() {
            let (lent, at_rest) = (self.maps.lend_scans(), self.maps.at_rest(SensorKind::Lidar));
            let (scans, listeners) = (&mut self.scans, &mut self.listeners);
            let merged = on_pool(self.pool.as_ref(), || scans.merge(&lent, at_rest, listeners, stop));
            done.push(merged.map(|()| true));
            self.maps.take_scans_back(lent);
        }
        let mut is_merged = false;
        for result in done {
            match result {
                Ok(is_news) => is_merged |= is_news,
                Err(Failed::Merge(_)) if stop.requested() => {}
                // What is wrong with these maps may be mended by more of them.
                Err(Failed::Merge(error)) => warn(&format!("the maps are not merged: {error:#}")),
                Err(Failed::Write(error)) => return Err(error),
            }
        }
        Ok(is_merged.then(|| self.all_found()))
    }

    /// Looks at pairs of maps that were lent by `maps`, but for those that these remember.
    fn look(&self, lent: &Inputs<Input>, maps: &Maps, looking: Looking, stop: &Stop) -> Result<Looked> {
        let Looking { wanted, places, share, exactly, is_awaited } = looking;
        let go_on = || if stop.requested() { Err(anyhow!("interrupted")) } else { Ok(()) };
        let known = |pair: [usize; 2]| maps.memory.recall(&lent.contents, pair, exactly);
        let agents: Vec<Identity> = lent.contents.iter().map(|content| content.agent).collect();
        let mut groups = Groups::new(agents.len());
        self.company.firsts(&agents).into_iter().enumerate().for_each(|(number, first)| {
            groups.join([first, number]);
        });
        let go = Go { known: &known, wanted, groups, places, share, is_awaited };
        on_pool(self.pool.as_ref(), || {
            look(&lent.inputs, &self.vocabulary, &self.params, go, &mut |_| go_on())
        })
    }

    /// The common map of what pairs of lent maps made of each other.
    fn made(
        &self,
        lent: &Inputs<Input>,
        encounters: Vec<Encounter>,
        optimise: bool,
        undone: &[([usize; 2], String)],
    ) -> Result<Merging> {
        on_pool(self.pool.as_ref(), || common_map(&lent.inputs, encounters, &self.params, optimise, undone))
    }

    /// Merges whole maps; whether anything is to be told.
    fn merge_lent(
        &mut self,
        lent: &Inputs<Input>,
        share: Option<Share>,
        taken: bool,
        is_awaited: &(dyn Fn() -> bool + Sync),
        stop: &Stop,
    ) -> Result<bool, Failed> {
        let Inputs { inputs, contents, whole } = lent;
        if inputs.is_empty() {
            self.to_write = false;
            return Ok(true);
        }
        let exactly = taken && self.maps.at_rest(SensorKind::Camera);
        let places = self.maps.memory.take_places(contents);
        let looking = Looking { wanted: None, places, share, exactly, is_awaited };
        let mut looked = self.look(lent, &self.maps, looking, stop).map_err(Failed::Merge)?;
        self.maps.memory.keep(contents, looked.now());
        self.maps.memory.keep_places(contents, std::mem::take(&mut looked.places));
        (self.left, self.may_join) = (!looked.left.is_empty(), looked.may_join);
        let at_rest = exactly && !self.left;
        let is_same = self.made_of == *contents;
        let is_told = !looked.is_news && is_same && self.told.elapsed() < TELL_INTERVAL;
        if self.left && is_told {
            return Ok(false);
        }
        // Whoever waits for a place is not kept waiting by what is written, unless that would be for ever.
        let is_patient = self.left && (self.may_join || is_awaited());
        let patience = WRITE_INTERVAL * if is_patient { PATIENCE_FACTOR } else { 1 };
        let is_due = match (self.left, self.written) {
            (false, None) => true,
            (_, written) => written.unwrap_or(self.begun).elapsed() > patience,
        };
        let is_settled = is_patient || self.settled.elapsed() < self.settling * SETTLE_FACTOR;
        let optimise = at_rest || is_due || !(self.left && is_settled);
        let undone = if optimise { Vec::new() } else { self.undone_of(contents) };
        let start = Instant::now();
        let merging = self.made(lent, looked.encounters, optimise, &undone).map_err(Failed::Merge)?;
        (self.told, self.made_of) = (Instant::now(), contents.clone());
        self.found = found(inputs, &merging, whole);
        self.sketches.met(&met(&merging, contents));
        // What whole maps say stands, once they were all looked at as far as their parts were.
        let is_whole = |part: &FoundAgent| {
            let mut whole = self.found.agents.iter().filter(|whole| whole.agent == part.agent);
            whole.any(|whole| whole.keyframes >= part.keyframes)
        };
        if share.is_none() || !self.left && self.of_parts.agents.iter().all(is_whole) {
            self.of_parts = Found::default();
        }
        if !optimise {
            return Ok(true);
        }
        (self.settled, self.settling) = (Instant::now(), start.elapsed());
        self.undone = undone_by(&merging, contents);
        self.listeners.iter_mut().for_each(|listener| listener.cameras(&merging.fused));
        if merging.anything_met() && (at_rest || is_due) {
            let mut write = || -> Result<()> {
                let names = Names::new(&merging.common);
                let mut record = MergeRecord::new(inputs, &merging, &self.params, &names)?;
                write_results(&mut self.results, inputs, &merging, &names, &mut record)?;
                self.results.commit()
            };
            write().map_err(Failed::Write)?;
            self.written = Some(Instant::now());
            self.to_write = self.left;
        }
        if !merging.anything_met() && !self.left {
            self.to_write = false;
        }
        Ok(true)
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

/// What is looked at, as [`Go`] has it.
struct Looking<'a> {
    wanted: Option<BTreeMap<[usize; 2], f32>>,
    places: BTreeMap<[usize; 2], Places>,
    share: Option<Share>,
    /// Whether the result is to last.
    exactly: bool,
    is_awaited: &'a (dyn Fn() -> bool + Sync),
}

/// The merges that were taken back, by whose maps they were of, and why.
fn undone_by(merging: &Merging, contents: &[Content]) -> Vec<([Identity; 2], String)> {
    let joined = merging.encounters.iter().filter(|encounter| encounter.joined.is_some());
    let undone = joined.filter_map(|encounter| {
        let why = merging.undone(encounter)?.to_owned();
        Some((encounter.as_given().map(|map| contents[map].agent), why))
    });
    undone.collect()
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
