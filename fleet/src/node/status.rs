//! How things are, for people.

use super::{Heard, Node};
use crate::assembling::entries_of;
use crate::manifest::Manifest;
use map::{Identity, SensorKind};
use std::time::Duration;

/// How things are.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// Whom one knows.
    pub neighbours: Vec<NeighbourStatus>,
    /// Maps of others.
    pub agents: Vec<AgentStatus>,
}

/// A neighbour.
#[derive(Clone, Debug)]
pub struct NeighbourStatus {
    /// What people call it.
    pub name: String,
    /// Whether it is a station.
    pub is_station: bool,
    /// Where it is; nothing while there is no link.
    pub address: Option<String>,
    /// Time since it was last heard.
    pub silent: Option<Duration>,
    /// Bytes of objects that came from it.
    pub received: u64,
    /// Bytes of them that were here already.
    pub useless: u64,
    /// Objects to be fetched from it.
    pub wanted: usize,
    /// The measured rate, bytes a second.
    pub rate: f64,
    /// Objects of own maps that it lacks; nothing while it has not said.
    pub lacks: Option<u64>,
}

/// A map of another.
#[derive(Clone, Debug)]
pub struct AgentStatus {
    /// Whose.
    pub agent: Identity,
    /// Who tells it, by name; nothing of one that was here when the program began.
    pub teller: Option<String>,
    /// The kind of its sensor; nothing while no keyframe is told of.
    pub sensor: Option<SensorKind>,
    /// Keyframes of its newest version.
    pub keyframes: usize,
    /// Objects of it that are not here yet.
    pub missing: usize,
    /// Whether the run has ended.
    pub finished: bool,
}

impl Node {
    /// How things are at `now`.
    pub fn status(&self, now: Duration) -> Status {
        let neighbour = |neighbour: &super::Neighbour| {
            let link = neighbour.link.and_then(|link| self.links.get(&link));
            let lacks = self.own.iter().map(|(agent, own)| match neighbour.holds.get(agent) {
                Some((version, _)) if *version == own.offer.version() => Some(0),
                Some((_, missing)) => Some(u64::from(*missing)),
                None => None,
            });
            NeighbourStatus {
                name: neighbour.name.clone(),
                is_station: neighbour.is_station,
                address: link.map(|link| link.address.clone()),
                silent: link.map(|link| now.saturating_sub(link.heard)),
                received: neighbour.fetch.received,
                useless: neighbour.fetch.useless,
                wanted: neighbour.fetch.wanted(),
                rate: neighbour.fetch.rate(),
                lacks: lacks.sum(),
            }
        };
        let agent = |told: &super::Told| AgentStatus {
            agent: told.offer.agent,
            teller: self.neighbours.get(&told.teller).map(|neighbour| neighbour.name.clone()),
            sensor: told.sensor(),
            keyframes: told.keyframes(),
            missing: told.missing(),
            finished: told.is_finished(),
        };
        Status {
            neighbours: self.neighbours.values().map(neighbour).collect(),
            agents: self.told.values().map(agent).collect(),
        }
    }

    /// Whether all neighbours that are there hold all own maps as they are by now; false without a neighbour.
    pub fn is_held(&self) -> bool {
        let linked = self.neighbours.values().filter(|neighbour| neighbour.link.is_some());
        let mut linked = linked.peekable();
        let holds = |neighbour: &super::Neighbour| {
            self.own.iter().all(|(agent, own)| {
                neighbour.holds.get(agent).is_some_and(|(version, _)| *version == own.offer.version())
            })
        };
        linked.peek().is_some() && linked.all(holds)
    }

    /// Own maps, which are whole.
    pub fn own_maps(&self) -> Vec<Heard> {
        let heard = |own: &super::Own| {
            let manifest = Manifest::from_bytes(&self.store.get(&own.offer.hash)?).ok()?;
            let entries = entries_of(&manifest, &*self.store).ok()??.into();
            let Manifest { agent, begun, finished, .. } = manifest;
            Some(Heard { agent, begun, entries, missing: 0, came: 0, finished, is_near: true })
        };
        self.own.values().filter_map(heard).collect()
    }
}
