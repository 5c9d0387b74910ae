//! How things are, for people.

use super::publishing::Own;
use super::{Lists, MapSnapshot, Node};
use map::{Identity, SensorKind};
use std::sync::Arc;
use std::time::Duration;

/// How things are.
#[derive(Clone, Debug, Default)]
pub struct Status {
    /// Whom one knows.
    pub neighbours: Vec<NeighbourStatus>,
    /// Where nobody answers who is dialled, since when and why.
    pub unanswered: Vec<(String, Duration, String)>,
    /// Maps of others.
    pub agents: Vec<AgentStatus>,
    /// How many of these are whole here, and not on the disk yet and acknowledged.
    pub unkept: usize,
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
    /// For how long it has been there, or has not.
    pub since: Duration,
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
    pub publisher: Option<String>,
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
            let published = self.own.iter().filter(|(_, own)| own.version().is_some());
            let lacks = published
                .map(|(agent, _)| neighbour.stored.get(agent).map(|(_, missing)| u64::from(*missing)));
            // It does not know yet how many.
            let lacks = lacks.map(|missing| missing.filter(|missing| *missing < u64::from(u32::MAX)));
            NeighbourStatus {
                name: neighbour.name.clone(),
                is_station: neighbour.is_station,
                address: link.map(|link| link.address.clone()),
                since: now.saturating_sub(neighbour.changed),
                silent: link.map(|link| now.saturating_sub(link.last_received)),
                received: neighbour.fetch.received,
                useless: neighbour.fetch.useless,
                wanted: neighbour.fetch.queued(),
                rate: neighbour.fetch.rate(),
                lacks: lacks.sum(),
            }
        };
        let agent = |remote: &super::RemoteMap| AgentStatus {
            agent: remote.version.agent,
            publisher: self.neighbours.get(&remote.publisher).map(|neighbour| neighbour.name.clone()),
            sensor: remote.sensor(),
            keyframes: remote.load().keyframes,
            missing: remote.missing(),
            finished: remote.is_finished(),
        };
        let unanswered = |(address, (since, reason)): (&String, &(Duration, String))| {
            (address.clone(), now.saturating_sub(*since), reason.clone())
        };
        Status {
            unanswered: self.unanswered.iter().map(unanswered).collect(),
            neighbours: self.neighbours.values().map(neighbour).collect(),
            agents: self.remote_maps.values().map(agent).collect(),
            unkept: self.remote_maps.values().filter(|remote| remote.is_unkept()).count(),
        }
    }

    /// Whether all neighbours that are there hold all own maps as they are by now, and lack nothing of them; false without a
    /// neighbour.
    pub fn is_acknowledged(&self) -> bool {
        let linked = self.neighbours.values().filter(|neighbour| neighbour.link.is_some());
        let mut linked = linked.peekable();
        let stores_all = |neighbour: &super::Neighbour| {
            self.own.iter().all(|(agent, own)| {
                let whole = own.version().map(|version| (version.order(), 0));
                whole.is_some() && neighbour.stored.get(agent) == whole.as_ref()
            })
        };
        linked.peek().is_some() && self.own.values().all(Own::is_published) && linked.all(stores_all)
    }

    /// How many things neighbours said are remembered.
    #[cfg(test)]
    pub fn remembered(&self) -> usize {
        self.neighbours.values().map(|neighbour| neighbour.stored.len() + neighbour.later.len()).sum()
    }

    /// How many objects were looked at when versions of maps came and went.
    #[cfg(test)]
    pub fn looked_at(&self) -> usize {
        self.of_remote.touched
    }

    /// Whether stations hold all own maps.
    #[cfg(test)]
    pub fn is_acknowledged_by_station(&self) -> bool {
        let mut stations = self.neighbours.values().filter(|neighbour| neighbour.is_station).peekable();
        let whole = |own: &Own| own.version().map(|version| (version.order(), 0));
        stations.peek().is_some()
            && stations.all(|station| {
                self.own.iter().all(|(agent, own)| station.stored.get(agent).copied() == whole(own))
            })
    }

    /// Own maps, which are whole.
    pub fn own_maps(&self) -> Vec<MapSnapshot> {
        let snapshot = |lists: &Lists| {
            let (agent, begun) = (lists.map_version.agent, lists.map_version.begun);
            let (entries, finished) = (Arc::clone(&lists.entries), lists.manifest.finished);
            MapSnapshot { agent, begun, entries, missing: 0, came: 0, finished, is_near: true }
        };
        self.own.values().filter_map(Own::lists).map(snapshot).collect()
    }
}
