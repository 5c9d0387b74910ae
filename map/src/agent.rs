//! Agents: whose keyframes a map holds.

use crate::{Identity, KeyframeId, Sensor};
use geometry::{Pinhole, Sim3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The name of an agent that was given none.
const DEFAULT_NAME: &str = "agent";

/// Where an agent's map came from: its unit, and that unit where it is known.
const UNIT: &str = "unit";
const METRE: &str = "metre";

/// Names an agent within its map; 0 is the only agent of a map that was not merged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct AgentId(pub u16);

/// An agent whose keyframes are in a map.
#[derive(Clone, Debug, PartialEq)]
pub struct AgentInfo {
    /// Its name, the recording's for example; unique within the map and not empty.
    pub name: String,
    /// Its sensor.
    pub sensor: Sensor,
    /// Its identity and the epoch of this map; unique within the map. `None` if it has no identity: such an agent is
    /// known by its keyframes alone.
    pub identity: Option<Identity>,
    /// Where its map came from: free `key → value` text (source, program version, parameters, …).
    pub provenance: BTreeMap<String, String>,
    /// In a united map: what it takes to get the agent's own map back. `None` in that own map.
    pub own: Option<OwnMap>,
}

impl AgentInfo {
    /// An agent that sees with `sensor`, a LiDAR or the camera of which its images are; of no identity yet.
    pub fn new(name: impl Into<String>, sensor: impl Into<Sensor>) -> Self {
        let (name, sensor) = (name.into(), sensor.into());
        Self { name, sensor, identity: None, provenance: BTreeMap::new(), own: None }
    }

    /// The pinhole camera its keyframes' images were undistorted to; `None` of a LiDAR.
    pub fn camera(&self) -> Option<&Pinhole> {
        match &self.sensor {
            Sensor::Camera(camera) => Some(camera),
            Sensor::Lidar => None,
        }
    }

    /// Whether its own world is in metres: that of a LiDAR is, that of a camera if the user gave it metres.
    pub fn is_metric(&self) -> bool {
        self.sensor == Sensor::Lidar || self.provenance.get(UNIT).is_some_and(|unit| unit == METRE)
    }

    /// Sets that its own world is in metres.
    pub fn set_metric(&mut self) {
        self.provenance.insert(UNIT.to_owned(), METRE.to_owned());
    }

    /// An agent that nobody named.
    pub(crate) fn unnamed(camera: Pinhole) -> Self {
        Self::new(DEFAULT_NAME, camera)
    }
}

/// The part of an agent's own map that uniting it with others changed.
///
/// Everything else is relative to the keyframes, and in the united map as it was.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnMap {
    /// The agent's name there.
    pub name: String,
    /// The first id of the agent's range, which ends where that of another agent begins: keyframe `id` of
    /// the united map is keyframe `id − first_keyframe` of the own one.
    pub first_keyframe: u32,
    /// Poses in the own world, by the ids of the united map.
    pub world_from_keyframe: BTreeMap<KeyframeId, Sim3>,
}

/// The agent of a united map in whose range an id lies, whether there is such a keyframe or not; in a map
/// that is not united, its only agent.
pub(crate) fn owner(agents: &BTreeMap<AgentId, AgentInfo>, id: KeyframeId) -> Option<AgentId> {
    let begun = agents.iter().filter_map(|(agent, info)| {
        let first = info.own.as_ref().map_or(0, |own| own.first_keyframe);
        (first <= id.0).then_some((first, *agent))
    });
    // Of two that begin at one id the former has no ids at all.
    begun.max().map(|(_, agent)| agent)
}

/// The agents' names made safe for files, topics and coordinate frames: letters, digits, `.`, `-` and `_`,
/// still unique.
pub(crate) fn labels(agents: &BTreeMap<AgentId, AgentInfo>) -> BTreeMap<AgentId, String> {
    let mut taken = BTreeSet::new();
    let label = |(id, info): (&AgentId, &AgentInfo)| {
        let safe = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        let name: String = info.name.chars().map(safe).collect();
        let name = name.trim_matches('.');
        (*id, unique(if name.is_empty() { DEFAULT_NAME } else { name }, &mut taken))
    };
    agents.iter().map(label).collect()
}

/// The name itself or, where it is taken, with the first free number from 2 on; it is taken then.
pub(crate) fn unique(name: &str, taken: &mut BTreeSet<String>) -> String {
    let mut found = name.to_owned();
    let mut number = 2;
    while !taken.insert(found.clone()) {
        found = format!("{name}-{number}");
        number += 1;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };

    #[test]
    fn labels_are_safe_and_unique() {
        let names = ["yard", "a/b", "a b", "..", "früh 2", "yard-2", "agent"];
        let agents = names.iter().zip(0..).map(|(n, i)| (AgentId(i), AgentInfo::new(*n, CAMERA))).collect();
        let found: Vec<String> = labels(&agents).into_values().collect();
        assert_eq!(found, ["yard", "a_b", "a_b-2", "agent", "früh_2", "yard-2", "agent-2"]);
    }

    #[test]
    fn every_id_from_the_first_on_has_an_owner() {
        let agent = |first: u32| AgentInfo {
            own: Some(OwnMap {
                name: String::new(),
                first_keyframe: first,
                world_from_keyframe: BTreeMap::new(),
            }),
            ..AgentInfo::unnamed(CAMERA)
        };
        let agents = [0, 7, 7, 20].into_iter().zip(0..).map(|(f, i)| (AgentId(i), agent(f))).collect();
        let owner = |id| owner(&agents, KeyframeId(id)).map(|agent| agent.0);
        assert_eq!([0, 6, 7, 19, 20, u32::MAX].map(owner), [0, 0, 2, 2, 3, 3].map(Some));
    }
}
