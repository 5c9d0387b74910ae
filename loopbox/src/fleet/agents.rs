//! The maps of the agents that are told here, as far as they came.

use super::remembering::{Content, Memory};
use crate::merging::Input;
use anyhow::Result;
use fleet::assembling::Assembler;
use fleet::hash::ObjectHash;
use fleet::node::Heard;
use fleet::store::Store;
use map::{AgentId, Identity, KeyframeId, Map};
use place_recog::Vocabulary;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Keyframes with which a map is looked at: three adjacent ones are what a closure rests on.
const FEWEST: usize = 3;

/// Maps that are merged with each other.
#[derive(Default)]
pub(super) struct Maps {
    /// Whose.
    agents: BTreeMap<Identity, Agent>,
    /// What pairs of them made of each other.
    pub memory: Memory,
}

/// The map of an agent.
struct Agent {
    assembler: Assembler,
    /// When it began to be told: the eldest comes first.
    begun: u64,
    /// What it was put together of.
    seen: Option<Seen>,
    /// All of it that merging looks at, as it was put together.
    content: Option<ObjectHash>,
    /// Whether all of it is here.
    whole: bool,
    /// Whether the agent's run is over.
    finished: bool,
    /// The map to be merged; nothing while there is too little of it.
    input: Option<Input>,
}

/// What a map was put together of.
#[derive(PartialEq)]
struct Seen {
    entries: Arc<[fleet::manifest::Entry]>,
    came: u64,
    missing: usize,
    finished: bool,
    only: Option<BTreeSet<KeyframeId>>,
}

/// Where maps are put together.
pub(super) struct Place<'a> {
    /// Where the objects are.
    pub store: &'a dyn Store,
    /// The folder of the agents' own maps.
    pub folder: &'a Path,
    /// By whose words places are recognised.
    pub vocabulary: &'a Vocabulary,
}

impl Maps {
    /// Takes in what there is of a map, of images and depths those of the keyframes `only`. Whether there is anything
    /// new to merge.
    ///
    /// # Errors
    /// When what was told is no map, or it cannot be written.
    pub fn take(
        &mut self,
        heard: &Heard,
        only: Option<&BTreeSet<KeyframeId>>,
        place: &Place,
    ) -> Result<bool, String> {
        self.agents.entry(heard.agent).or_insert_with(|| Agent::new(heard.begun)).take(heard, only, place)
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// How many maps are whole, their runs over.
    pub fn done(&self) -> usize {
        self.agents.values().filter(|agent| agent.whole && agent.finished).count()
    }

    /// Whether all maps are whole and their runs over.
    pub fn at_rest(&self) -> bool {
        self.done() == self.agents.len()
    }

    /// Takes the maps out of which there is enough: those in metres first, as `loopbox merge` has it, then the eldest.
    pub fn lend(&mut self) -> Inputs {
        let is_metric = |agent: &Agent| agent.input.as_ref().is_some_and(|input| input.map.is_metric());
        let order = self.agents.iter().map(|(identity, agent)| (!is_metric(agent), agent.begun, *identity));
        let mut order: Vec<_> = order.collect();
        order.sort();
        let mut all = Inputs { inputs: Vec::new(), contents: Vec::new(), whole: Vec::new() };
        for (.., identity) in order {
            let Some(agent) = self.agents.get_mut(&identity) else { continue };
            let Some((hash, mut input)) = agent.content.zip(agent.input.take()) else { continue };
            input.name_apart_from(&all.inputs);
            all.inputs.push(input);
            all.contents.push(Content { agent: identity, hash });
            all.whole.push(agent.whole);
        }
        all
    }

    /// Takes the maps back.
    pub fn take_back(&mut self, lent: Inputs) {
        for (content, input) in lent.contents.into_iter().zip(lent.inputs) {
            if let Some(agent) = self.agents.get_mut(&content.agent) {
                agent.input = Some(input);
            }
        }
    }
}

/// The maps to be merged, in their order.
pub(super) struct Inputs {
    /// The maps.
    pub inputs: Vec<Input>,
    /// Whose they are, and what stands for them.
    pub contents: Vec<Content>,
    /// Whether each is all of an agent's map.
    pub whole: Vec<bool>,
}

impl Agent {
    /// One of whom nothing is here yet.
    fn new(begun: u64) -> Self {
        let (assembler, seen, content, input) = Default::default();
        Self { assembler, begun, seen, content, whole: false, finished: false, input }
    }

    /// Puts the map together of what is there. A map whose run is over is written once it is whole.
    fn take(
        &mut self,
        heard: &Heard,
        only: Option<&BTreeSet<KeyframeId>>,
        place: &Place,
    ) -> Result<bool, String> {
        let Heard { missing, came, finished, .. } = *heard;
        (self.begun, self.finished) = (heard.begun, finished);
        let entries = Arc::clone(&heard.entries);
        let seen = Some(Seen { entries, came, missing, finished, only: only.cloned() });
        if self.seen == seen {
            return Ok(false);
        }
        let made = self.assembler.assemble(heard.agent, &heard.entries, place.store, only)?;
        let Some(made) = made else { return Ok(false) };
        self.seen = seen;
        // Frames are no matter for merging, and are written once the run is over.
        let is_done = made.whole && finished;
        if self.content == Some(made.content) && self.whole == made.whole && !is_done {
            return Ok(false);
        }
        (self.content, self.whole) = (Some(made.content), made.whole);
        let path = place.folder.join(label(heard.agent, &made.map)).join("map.mcap");
        if is_done {
            save(&path, &made.map).map_err(|error| error.to_string())?;
        }
        let with_depth = made.map.keyframes.values().filter(|keyframe| !keyframe.semi_dense.is_empty());
        self.input = match with_depth.count() < FEWEST {
            true => None,
            false => Input::of(made.map, &path, place.vocabulary).ok(),
        };
        Ok(self.input.is_some())
    }
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
fn save(path: &PathBuf, map: &Map) -> Result<()> {
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    Ok(map::save_map(path, map)?)
}
