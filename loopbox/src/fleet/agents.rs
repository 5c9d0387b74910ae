//! The maps of the agents that are told here, as far as they came.

use super::remembering::{Content, Memory};
use crate::lidar::merging::Input as ScanInput;
use crate::merging::Input;
use crate::verdicts::MapDigest;
use anyhow::Result;
use fleet::assembling::Assembler;
use fleet::hash::ObjectHash;
use fleet::node::MapSnapshot;
use fleet::store::Objects;
use map::{AgentId, Identity, KeyframeId, Map, SensorKind};
use place_recog::Vocabulary;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Keyframes with which a camera's map is looked at: three adjacent ones are what a closure rests on.
pub(super) const FEWEST: usize = 3;

/// Maps that are merged with each other.
#[derive(Default)]
pub(super) struct Maps {
    /// Whose.
    agents: BTreeMap<Identity, Agent>,
    /// What pairs of cameras' made of each other.
    pub memory: Memory,
}

/// The map of an agent.
struct Agent {
    assembler: Assembler,
    /// When it began to be told: the eldest comes first.
    begun: u64,
    /// The kind of its sensor, once that is known.
    sensor: Option<SensorKind>,
    /// What it was put together of.
    seen: Option<Seen>,
    /// All of it that merging looks at, as it was put together.
    content: Option<ObjectHash>,
    /// Whether all of it is here.
    whole: bool,
    /// Whether the agent's run is over.
    finished: bool,
    /// Its file, once that is written.
    file: Option<(PathBuf, MapDigest)>,
    /// A camera's map to be merged; nothing while there is too little of it.
    images: Option<Input>,
    /// The same of a LiDAR's; nothing while it is lent.
    scans: Option<ScanInput>,
}

/// Why a map was not taken in.
pub(super) enum NotUpdated {
    /// What was told is none.
    Wrong(String),
    /// It cannot be written here.
    Unwritten(anyhow::Error),
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
    pub store: &'a dyn Objects,
    /// The folder of the agents' own maps.
    pub folder: &'a Path,
    /// By whose words places are recognised.
    pub vocabulary: &'a Vocabulary,
}

impl Maps {
    /// Takes in what there is of a map, of images and depths those of the keyframes `only`. Of which sensors' maps there is
    /// something new to merge, if of any.
    ///
    /// # Errors
    /// When what was told is no map, or it cannot be written.
    pub fn update(
        &mut self,
        snapshot: &MapSnapshot,
        only: Option<&BTreeSet<KeyframeId>>,
        place: &Place,
    ) -> Result<Option<SensorKind>, NotUpdated> {
        let agent = self.agents.entry(snapshot.agent).or_insert_with(|| Agent::new(snapshot.begun));
        let updated = agent.update(snapshot, only, place);
        if updated.is_err() {
            self.agents.remove(&snapshot.agent);
        }
        updated
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// How many maps are whole, their runs over.
    pub fn done(&self) -> usize {
        self.agents.values().filter(|agent| agent.whole && agent.finished).count()
    }

    /// Whether all maps of such sensors are whole and their runs over.
    pub fn at_rest(&self, sensor: SensorKind) -> bool {
        // One of which nothing is known yet may be of any.
        let mut such = self.agents.values().filter(|agent| agent.sensor.is_none_or(|kind| kind == sensor));
        such.all(|agent| agent.whole && agent.finished)
    }

    /// The files of the maps that are written: those that will not change any more.
    pub fn written(&self) -> impl Iterator<Item = (&Path, &MapDigest)> {
        self.agents.values().filter_map(|agent| agent.file.as_ref().map(|(path, digest)| (&**path, digest)))
    }

    /// The cameras' maps of which there is enough: those in metres first, as `loopbox merge` has it, then the eldest.
    pub fn of_cameras(&self) -> Inputs<Input> {
        let of_agents = self.agents.iter().filter_map(|(identity, agent)| {
            let (hash, input) = agent.content.zip(agent.images.clone())?;
            let key = (!input.map.is_metric(), agent.begun);
            Some((key, Content { agent: *identity, hash }, agent.state(), input))
        });
        let mut all = Inputs::in_order(of_agents);
        let file = |content: &Content| Some(self.agents.get(&content.agent)?.file.as_ref()?.1.clone());
        all.files = all.contents.iter().map(file).collect();
        for number in 1..all.inputs.len() {
            let (before, after) = all.inputs.split_at_mut(number);
            after[0].name_apart_from(before);
        }
        all
    }

    /// Takes the LiDARs' maps out, the eldest first.
    pub fn lend_scans(&mut self) -> Inputs<ScanInput> {
        let of_agents = self.agents.iter_mut().filter_map(|(identity, agent)| {
            let state = agent.state();
            let (hash, input) = agent.content.zip(agent.scans.take())?;
            Some((agent.begun, Content { agent: *identity, hash }, state, input))
        });
        let mut all = Inputs::in_order(of_agents);
        ScanInput::name_apart(&mut all.inputs);
        all
    }

    /// Takes LiDARs' maps back.
    pub fn return_scans(&mut self, lent: Inputs<ScanInput>) {
        for (content, input) in lent.contents.into_iter().zip(lent.inputs) {
            if let Some(agent) = self.agents.get_mut(&content.agent) {
                agent.scans = Some(input);
            }
        }
    }
}

/// The maps to be merged, in their order.
pub(super) struct Inputs<T> {
    /// The maps.
    pub inputs: Vec<T>,
    /// Whose they are, and what stands for them.
    pub contents: Vec<Content>,
    /// Whether each is all of an agent's map.
    pub whole: Vec<bool>,
    /// Whether each is, and will not change any more.
    pub over: Vec<bool>,
    /// The files of cameras' maps that are written: those that will not change any more.
    pub files: Vec<Option<MapDigest>>,
}

impl<T> Inputs<T> {
    /// Those of agents by their keys, of equal ones the smaller identity first; each with what stands for it, whether it
    /// is whole and whether it is over.
    fn in_order<K: Ord>(all: impl Iterator<Item = (K, Content, [bool; 2], T)>) -> Self {
        let mut all: Vec<_> = all.collect();
        all.sort_by(|(a, of_a, ..), (b, of_b, ..)| a.cmp(b).then(of_a.agent.cmp(&of_b.agent)));
        let (inputs, contents, whole, over, files) = Default::default();
        let mut ordered = Self { inputs, contents, whole, over, files };
        for (_, content, [whole, over], input) in all {
            ordered.inputs.push(input);
            ordered.contents.push(content);
            ordered.whole.push(whole);
            ordered.over.push(over);
        }
        ordered
    }
}

impl Agent {
    /// One of whom nothing is here yet.
    fn new(begun: u64) -> Self {
        let (assembler, sensor, seen, content, file, images, scans) = Default::default();
        Self { assembler, begun, sensor, seen, content, whole: false, finished: false, file, images, scans }
    }

    /// Whether all of it is here, and will not change any more.
    fn state(&self) -> [bool; 2] {
        [self.whole, self.whole && self.finished]
    }

    /// Puts the map together of what is there. A map whose run is over is written once it is whole.
    fn update(
        &mut self,
        snapshot: &MapSnapshot,
        only: Option<&BTreeSet<KeyframeId>>,
        place: &Place,
    ) -> Result<Option<SensorKind>, NotUpdated> {
        let MapSnapshot { missing, came, finished, .. } = *snapshot;
        (self.begun, self.finished) = (snapshot.begun, finished);
        let entries = Arc::clone(&snapshot.entries);
        let seen = Some(Seen { entries, came, missing, finished, only: only.cloned() });
        if self.seen == seen {
            return Ok(None);
        }
        let made = self.assembler.assemble(snapshot.agent, &snapshot.entries, place.store, only);
        let made = made.map_err(NotUpdated::Wrong)?;
        let Some(made) = made else { return Ok(None) };
        self.seen = seen;
        // Frames are no matter for merging, and are written once the run is over.
        let is_done = made.whole && finished;
        if self.content == Some(made.content) && self.whole == made.whole && !is_done {
            return Ok(None);
        }
        (self.content, self.whole) = (Some(made.content), made.whole);
        let path = place.folder.join(label(snapshot.agent, &made.map)).join("map.mcap");
        self.file = None;
        if is_done {
            save(&path, &made.map).map_err(NotUpdated::Unwritten)?;
            self.file = Some((path.clone(), MapDigest::of(&path).map_err(NotUpdated::Unwritten)?));
        }
        self.sensor = made.map.sensor();
        (self.images, self.scans) = (None, None);
        if made.map.keyframes.is_empty() {
            return Ok(None);
        }
        if self.sensor == Some(SensorKind::Lidar) {
            let input = ScanInput::of(path, made.map);
            self.scans = Some(input.map_err(|error| NotUpdated::Wrong(format!("{error:#}")))?);
        } else if made.map.keyframes.values().filter(|k| !k.semi_dense.is_empty()).count() >= FEWEST {
            self.images = Input::of(made.map, &path, place.vocabulary).ok();
        }
        Ok(self.sensor.filter(|_| self.images.is_some() || self.scans.is_some()))
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
