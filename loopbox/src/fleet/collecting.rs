//! The maps of all agents that are told here, merged as they come.
//!
//! What is there of each map is put together and all of them are merged anew, as `loopbox merge` would: so what comes of
//! it does not depend on the order in which things came, and once all is there it is what a merge of the agents' own
//! files is, bit by bit.

use super::findings::Found;
use super::sketching::{Sketch, likely};
use crate::merging::{Input, MergeRecord, MergingParams, Names, merge, write_results};
use crate::results::{Owner, Results};
use crate::run::give_way;
use anyhow::{Context, Result, anyhow};
use fleet::assembling::Assembler;
use fleet::node::Heard;
use fleet::service::Service;
use fleet::store::Store;
use map::{AgentId, Identity, Map};
use place_recog::Vocabulary;
use sources::Stop;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Keyframes with which a map is looked at: three adjacent ones are what a closure rests on.
const FEWEST: usize = 3;
/// Time between merges at the least, and of the time that one took.
const PAUSE: Duration = Duration::from_millis(250);
const PAUSE_FACTOR: u32 = 2;
/// How often the common map is written while maps still grow.
const WRITE_INTERVAL: Duration = Duration::from_secs(30);
/// The folder of the agents' own maps.
const AGENTS: &str = "agents";

/// Merges maps as they come.
pub(super) struct Collector {
    out: PathBuf,
    results: Results,
    vocabulary: Arc<Vocabulary>,
    params: MergingParams,
    /// Threads that give way to all others, where they do.
    pool: Option<rayon::ThreadPool>,
    agents: BTreeMap<Identity, Agent>,
    /// Of all agents, as long as some of a map is missing.
    sketches: BTreeMap<Identity, Sketch>,
    merged: Instant,
    took: Duration,
    written: Option<Instant>,
    /// Something came that is not merged yet, or merged and not written.
    is_new: bool,
    to_write: bool,
}

/// The map of an agent.
struct Agent {
    assembler: Assembler,
    /// When it began to be told: the eldest comes first.
    begun: u64,
    /// The objects listed and how many of them are missing, as it was put together.
    seen: (Arc<[fleet::manifest::Entry]>, usize),
    /// Its place on disk, once it is whole.
    path: PathBuf,
    whole: bool,
    finished: bool,
    input: Option<Input>,
}

impl Collector {
    /// One that writes into `out`; beside others it works on one core, and gives way to them until the end.
    ///
    /// # Errors
    /// When the folder cannot be written to, or holds results of something else.
    pub fn new(out: &Path, force: bool, beside: bool) -> Result<Self> {
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).start_handler(|_| give_way());
        let pool = beside.then(|| one.build()).transpose();
        Ok(Self {
            pool: pool.context("cannot start threads")?,
            out: out.to_owned(),
            results: Results::create(out, &Owner::Merge, force)?,
            vocabulary: Vocabulary::shipped(),
            params: MergingParams::default(),
            agents: BTreeMap::new(),
            sketches: BTreeMap::new(),
            merged: Instant::now(),
            took: Duration::ZERO,
            written: None,
            is_new: false,
            to_write: false,
        })
    }

    /// Takes in what is new and merges it, where it is time. What was found, if anything was looked at.
    ///
    /// # Errors
    /// When the results cannot be written.
    pub fn step(&mut self, service: &Service, warn: &dyn Fn(&str), stop: &Stop) -> Result<Option<Found>> {
        if self.merged.elapsed() < PAUSE.max(self.took * PAUSE_FACTOR) {
            return Ok(None);
        }
        self.take_all(service, warn);
        if !std::mem::take(&mut self.is_new) {
            return Ok(None);
        }
        let start = Instant::now();
        let found = self.merge(warn, stop);
        (self.merged, self.took) = (Instant::now(), start.elapsed());
        found
    }

    /// Puts together what is there of all maps.
    fn take_all(&mut self, service: &Service, warn: &dyn Fn(&str)) {
        let store = service.store();
        let all: Vec<Heard> = service.heard().into_iter().chain(service.own()).collect();
        // An agent's own map alone is in its folder already.
        let is_beside = self.pool.is_some();
        if all.len() < 2 && (is_beside || !all.iter().any(|heard| heard.finished && heard.missing == 0)) {
            return;
        }
        self.ask_for_the_likely(&all, service);
        for heard in all {
            if let Err(reason) = self.take(&heard, &*store) {
                warn(&format!("the map of {} is left out: {reason}", heard.agent));
                service.distrust(heard.agent, reason);
            }
        }
    }

    /// Has keyframes fetched first at which agents may have met, as long as some are missing.
    fn ask_for_the_likely(&mut self, all: &[Heard], service: &Service) {
        if all.iter().all(|heard| heard.missing == 0) {
            self.sketches.clear();
            return;
        }
        let store = service.store();
        for heard in all {
            let sketch = self.sketches.entry(heard.agent).or_default();
            sketch.take(heard, &*store, &self.vocabulary);
        }
        for (agent, keyframes) in likely(&self.sketches, &self.vocabulary) {
            service.prefer(agent, keyframes.into_iter().map(|id| id.0).collect());
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
        self.take_all(service, warn);
        self.pool = None;
        if self.to_write || self.is_new {
            (self.written, self.is_new) = (None, false);
            self.to_write = false;
            return self.merge(warn, &Stop::default());
        }
        Ok(None)
    }

    /// Puts a map together of what is there of it.
    fn take(&mut self, heard: &Heard, store: &dyn Store) -> Result<(), String> {
        let agent = self.agents.entry(heard.agent).or_insert_with(|| Agent {
            assembler: Assembler::default(),
            begun: heard.begun,
            seen: (Arc::new([]), usize::MAX),
            path: PathBuf::new(),
            whole: false,
            finished: false,
            input: None,
        });
        agent.begun = heard.begun;
        let has_ended = agent.finished != heard.finished;
        agent.finished = heard.finished;
        let is_known = *agent.seen.0 == *heard.entries && agent.seen.1 == heard.missing;
        if is_known && !has_ended {
            return Ok(());
        }
        let Some(made) = agent.assembler.assemble(heard.agent, &heard.entries, store)? else { return Ok(()) };
        let before = agent.input.as_ref().map(|input| &input.map);
        agent.seen = (Arc::clone(&heard.entries), heard.missing);
        let is_same = agent.whole == made.whole
            && before.is_some_and(|before| before.keyframes.len() == made.map.keyframes.len())
            && !made.whole
            && !has_ended;
        if is_same {
            return Ok(());
        }
        agent.whole = made.whole;
        agent.path = self.out.join(AGENTS).join(label(heard.agent, &made.map)).join("map.mcap");
        if made.whole && heard.finished {
            save(&agent.path, &made.map).map_err(|error| error.to_string())?;
        }
        let with_depth = made.map.keyframes.values().filter(|keyframe| !keyframe.semi_dense.is_empty());
        if with_depth.count() < FEWEST {
            return Ok(());
        }
        let (path, vocabulary, map) = (&agent.path, &self.vocabulary, made.map);
        let input = || Input::of(map, path, vocabulary).ok();
        agent.input = match &self.pool {
            Some(pool) => pool.install(input),
            None => input(),
        };
        self.is_new = true;
        self.to_write = true;
        Ok(())
    }

    /// Does something where merging is done.
    fn on_pool<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Merges all maps, and writes what came of it where it is time.
    fn merge(&mut self, warn: &dyn Fn(&str), stop: &Stop) -> Result<Option<Found>> {
        let mut order: Vec<(u64, Identity)> =
            self.agents.iter().map(|(identity, agent)| (agent.begun, *identity)).collect();
        order.sort();
        let (mut inputs, mut whole, mut taken) = (Vec::new(), Vec::new(), Vec::new());
        for (_, identity) in order {
            let Some(agent) = self.agents.get_mut(&identity) else { continue };
            let Some(mut input) = agent.input.take() else { continue };
            input.name_apart_from(&inputs);
            inputs.push(input);
            whole.push(agent.whole);
            taken.push(identity);
        }
        let result = self.merge_inputs(&inputs, &whole, stop);
        let is_interrupted = result.is_err() && stop.requested();
        for (identity, input) in taken.into_iter().zip(inputs) {
            if let Some(agent) = self.agents.get_mut(&identity) {
                agent.input = Some(input);
            }
        }
        match result {
            Err(Failed::Merge(_)) if is_interrupted => Ok(None),
            // What is wrong with these maps may be mended by more of them.
            Err(Failed::Merge(error)) => {
                warn(&format!("the maps are not merged: {error:#}"));
                Ok(None)
            }
            Err(Failed::Write(error)) => Err(error),
            Ok(found) => Ok(Some(found)),
        }
    }

    fn merge_inputs(&mut self, inputs: &[Input], whole: &[bool], stop: &Stop) -> Result<Found, Failed> {
        let go_on = || if stop.requested() { Err(anyhow!("interrupted")) } else { Ok(()) };
        if inputs.is_empty() {
            return Ok(Found::default());
        }
        let (vocabulary, params) = (&self.vocabulary, &self.params);
        let merged = self.on_pool(|| merge(inputs, vocabulary, params, &mut |_| go_on()));
        let merging = merged.map_err(Failed::Merge)?;
        let found = Found::of(inputs, &merging, whole);
        let at_rest = self.agents.values().all(|agent| agent.whole && agent.finished);
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

/// What went wrong.
enum Failed {
    /// Maps cannot be merged.
    Merge(anyhow::Error),
    /// Results cannot be written.
    Write(anyhow::Error),
}

/// What an agent's folder is called, which no other one's is.
fn label(agent: Identity, map: &Map) -> String {
    let name = map.agent_labels().remove(&AgentId::default()).unwrap_or_default();
    let uuid = agent.uuid.simple().to_string();
    match agent.epoch {
        0 => format!("{name}-{}", &uuid[..8]),
        epoch => format!("{name}-{}-{epoch}", &uuid[..8]),
    }
}

/// Writes an agent's own map.
fn save(path: &Path, map: &Map) -> Result<()> {
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    Ok(map::save_map(path, map)?)
}
