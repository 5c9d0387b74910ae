//! The maps of all agents that are told here, merged as they come.
//!
//! What is there of each map is put together and all of them are merged anew, as `loopbox merge` would: so what comes of
//! it does not depend on the order in which things came, and once all is there it is what a merge of the agents' own
//! files is, bit by bit.

use super::agents::{Agent, Place};
use super::courtesy::Courtesy;
use super::findings::Found;
use super::remembering::{Content, Memory};
use super::sketching::{Met, Plan, Sketches};
use crate::merging::{Input, MergeRecord, Merging, MergingParams, Names, merge_knowing, write_results};
use crate::results::{Owner, Results};
use crate::run::give_way;
use anyhow::{Context, Result, anyhow};
use fleet::node::Heard;
use fleet::service::Service;
use map::{Identity, KeyframeId};
use place_recog::Vocabulary;
use sources::Stop;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between merges at the least, and of the time that one took.
const PAUSE: Duration = Duration::from_millis(250);
const PAUSE_FACTOR: u32 = 2;
/// How often the common map is written while maps still grow.
const WRITE_INTERVAL: Duration = Duration::from_secs(30);
/// The folder of the agents' own maps.
const AGENTS: &str = "agents";

/// Merges maps as they come.
pub(super) struct Collector {
    /// The folder of the agents' own maps.
    folder: PathBuf,
    results: Results,
    vocabulary: Arc<Vocabulary>,
    params: MergingParams,
    /// Threads that give way to all others, where they do.
    pool: Option<rayon::ThreadPool>,
    agents: BTreeMap<Identity, Agent>,
    sketches: Sketches,
    courtesy: Courtesy,
    memory: Memory,
    merged: Instant,
    took: Duration,
    written: Option<Instant>,
    /// Something came that is not merged yet, or merged and not written.
    is_new: bool,
    to_write: bool,
}

/// The keyframes of each agent whose images and depths are merged; all, where nothing is said.
type Only = BTreeMap<Identity, BTreeSet<KeyframeId>>;

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
            sketches: Sketches::new(Arc::clone(&vocabulary)),
            vocabulary,
            params: MergingParams::default(),
            agents: BTreeMap::new(),
            courtesy: Courtesy::default(),
            memory: Memory::default(),
            merged: Instant::now(),
            took: Duration::ZERO,
            written: None,
            is_new: false,
            to_write: false,
        })
    }

    /// Takes in what is new and merges it, where it is time. What was found, if anything was looked at; `told` is what
    /// others found.
    ///
    /// # Errors
    /// When the results cannot be written.
    pub fn step(
        &mut self,
        service: &Service,
        told: &[Found],
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        let all = heard(service);
        let plan = self.plan(&all, service, told, warn);
        if let Some(only) = plan.ready {
            // As long as there is more to be fetched than what is looked at, no more than that is looked at.
            return self.look_at((!plan.all_released).then_some(&only), &all, service, warn, stop);
        }
        if !plan.all_released || self.merged.elapsed() < PAUSE.max(self.took * PAUSE_FACTOR) {
            return Ok(None);
        }
        self.take_all(&all, None, service, warn);
        if !std::mem::take(&mut self.is_new) {
            return Ok(None);
        }
        let start = Instant::now();
        let found = self.merge(false, service, warn, stop);
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
        let mut plan = match &self.pool {
            Some(pool) => pool.install(|| sketches.plan(all, &*store, &elsewhere)),
            None => sketches.plan(all, &*store, &elsewhere),
        };
        for (agent, (objects, rest)) in std::mem::take(&mut plan.wanted) {
            service.prefer(agent, objects, rest);
        }
        for (agent, reason) in std::mem::take(&mut plan.wrong) {
            leave_out(agent, reason, service, warn);
        }
        plan
    }

    /// Looks at the parts of the maps by which it is to be seen who met whom. What was found; nothing is said yet of
    /// those that are to be looked at more closely.
    fn look_at(
        &mut self,
        only: Option<&Only>,
        all: &[Heard],
        service: &Service,
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        self.take_all(all, only, service, warn);
        let mut found = self.merge(true, service, warn, stop)?;
        self.is_new = true;
        if let Some(found) = &mut found {
            let names = |agents: &[String; 2]| {
                let known = all.iter().map(|heard| heard.agent);
                let mut names: Vec<Identity> =
                    known.filter(|agent| agents.contains(&agent.to_string())).collect();
                names.sort();
                <[Identity; 2]>::try_from(names).ok()
            };
            found.postpone(|agents| names(agents).is_some_and(|names| self.sketches.is_pending(names)));
        }
        Ok(found)
    }

    /// Puts together what is there of all maps.
    fn take_all(&mut self, all: &[Heard], only: Option<&Only>, service: &Service, warn: &dyn Fn(&str)) {
        // An agent's own map alone is in its folder already.
        let is_beside = self.pool.is_some();
        if all.len() < 2 && (is_beside || !all.iter().any(|heard| heard.finished && heard.missing == 0)) {
            return;
        }
        let (store, none) = (service.store(), BTreeSet::new());
        let place = Place { store: &*store, folder: &self.folder, vocabulary: &self.vocabulary };
        for heard in all {
            let agent = self.agents.entry(heard.agent).or_insert_with(|| Agent::new(heard.begun));
            let only = only.map(|only| only.get(&heard.agent).unwrap_or(&none));
            let mut take = || agent.take(heard, only, &place);
            let taken = match &self.pool {
                Some(pool) => pool.install(take),
                None => take(),
            };
            match taken {
                Ok(is_new) => {
                    self.is_new |= is_new;
                    self.to_write |= is_new;
                }
                Err(reason) => leave_out(heard.agent, reason, service, warn),
            }
        }
    }

    /// Whether so many agents' maps are whole and will not change any more, and all is merged and written.
    pub fn is_done(&self, agents: usize) -> bool {
        let ended = self.agents.values().filter(|agent| agent.whole && agent.finished).count();
        ended >= agents && !self.is_new && !self.to_write
    }

    /// Merges and writes what is not yet, in the thread that calls it. What was found, if anything was.
    ///
    /// # Errors
    /// When that cannot be done.
    pub fn finish(&mut self, service: &Service, warn: &dyn Fn(&str)) -> Result<Option<Found>> {
        self.take_all(&heard(service), None, service, warn);
        self.pool = None;
        if self.to_write || self.is_new {
            (self.written, self.is_new) = (None, false);
            self.to_write = false;
            return self.merge(false, service, warn, &Stop::default());
        }
        Ok(None)
    }

    /// Does something where merging is done.
    fn on_pool<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Merges all maps, and writes what came of it where it is time; nothing of a sketch.
    fn merge(
        &mut self,
        is_sketch: bool,
        service: &Service,
        warn: &dyn Fn(&str),
        stop: &Stop,
    ) -> Result<Option<Found>> {
        let mut inputs = Inputs::taken_from(&mut self.agents);
        let result = self.merge_inputs(&mut inputs, is_sketch, service, stop);
        let is_interrupted = result.is_err() && stop.requested();
        inputs.back_to(&mut self.agents);
        match result {
            Err(Failed::Merge(_)) if is_interrupted => Ok(None),
            // What is wrong with these maps may be mended by more of them.
            Err(Failed::Merge(error)) => {
                self.sketches.judged(&[], &*service.store());
                warn(&format!("the maps are not merged: {error:#}"));
                Ok(None)
            }
            Err(Failed::Write(error)) => Err(error),
            Ok(found) => Ok(Some(found)),
        }
    }

    fn merge_inputs(
        &mut self,
        inputs: &mut Inputs,
        is_sketch: bool,
        service: &Service,
        stop: &Stop,
    ) -> Result<Found, Failed> {
        let go_on = || if stop.requested() { Err(anyhow!("interrupted")) } else { Ok(()) };
        let Inputs { inputs, contents, whole } = inputs;
        if inputs.is_empty() {
            self.sketches.judged(&[], &*service.store());
            return Ok(Found::default());
        }
        let at_rest = self.agents.values().all(|agent| agent.whole && agent.finished);
        let (vocabulary, params, memory) = (&self.vocabulary, &self.params, &self.memory);
        let known = |pair: [usize; 2]| memory.recall(contents, pair, at_rest);
        let merged = self.on_pool(|| merge_knowing(inputs, vocabulary, params, &known, &mut |_| go_on()));
        let merging = merged.map_err(Failed::Merge)?;
        let recalled: Vec<[usize; 2]> = merging
            .encounters
            .iter()
            .map(|encounter| encounter.as_given())
            .filter(|pair| memory.recall(contents, *pair, at_rest).is_some())
            .collect();
        self.memory.keep(contents, &merging.encounters, |pair| recalled.contains(&pair));
        let found = Found::of(inputs, &merging, whole);
        let met = met(&merging, contents);
        if is_sketch {
            self.sketches.judged(&met, &*service.store());
            return Ok(found);
        }
        self.sketches.met(&met);
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
        Ok(found)
    }
}

/// The maps to be merged, in their order.
struct Inputs {
    inputs: Vec<Input>,
    contents: Vec<Content>,
    whole: Vec<bool>,
}

impl Inputs {
    /// Of all agents of whom there is enough: those in metres first, as `loopbox merge` has it, then the eldest.
    fn taken_from(agents: &mut BTreeMap<Identity, Agent>) -> Self {
        let is_metric = |agent: &Agent| agent.input.as_ref().is_some_and(|input| input.map.is_metric());
        let order = agents.iter().map(|(identity, agent)| (!is_metric(agent), agent.begun, *identity));
        let mut order: Vec<_> = order.collect();
        order.sort();
        let mut all = Self { inputs: Vec::new(), contents: Vec::new(), whole: Vec::new() };
        for (.., identity) in order {
            let Some(agent) = agents.get_mut(&identity) else { continue };
            let Some(content) = agent.content(identity) else { continue };
            let Some(mut input) = agent.input.take() else { continue };
            input.name_apart_from(&all.inputs);
            all.inputs.push(input);
            all.contents.push(content);
            all.whole.push(agent.whole);
        }
        all
    }

    /// Gives the agents their maps back.
    fn back_to(self, agents: &mut BTreeMap<Identity, Agent>) {
        for (content, input) in self.contents.into_iter().zip(self.inputs) {
            if let Some(agent) = agents.get_mut(&content.agent) {
                agent.input = Some(input);
            }
        }
    }
}

/// What went wrong.
enum Failed {
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
