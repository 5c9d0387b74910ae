//! The metadata records at the start of a map's file, as text: the version, the agents, and where the map came from.
//! Numbers have as many digits as it takes to read them back.

use super::{
    AGENT_METADATA, FORMAT_VERSION, MAP_METADATA, MERGE_METADATA, NAMELESS_FORMAT, PROVENANCE_METADATA,
    SINGLE_AGENT_FORMAT, SINGLE_AGENT_PROVENANCE_METADATA,
};
use crate::{AgentId, AgentInfo, Identity, Map, OwnMap, Sensor, Uuid, check};
use geometry::Pinhole;
use mcap::records::Metadata;
use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

/// What stands under `sensor` for a LiDAR. An agent with a camera has its camera instead.
const LIDAR: &str = "lidar";

/// Entries of a metadata record.
pub(super) type Entries = BTreeMap<String, String>;

/// What is said of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct About {
    /// The agents; the poses of their own maps are not written here.
    pub agents: BTreeMap<AgentId, AgentInfo>,
    /// How their maps came together.
    pub merge_provenance: Entries,
    /// Whether it is of a version from before agents had identities.
    nameless: bool,
}

/// Why a metadata record cannot be taken.
#[derive(Debug)]
pub(super) enum AboutError {
    /// The map is of this format.
    Version(String),
    /// The record contradicts itself.
    Invalid(String),
}

impl About {
    /// What there is to say of a map.
    pub(super) fn of(map: &Map) -> Self {
        Self { agents: map.agents.clone(), merge_provenance: map.merge_provenance.clone(), nameless: false }
    }

    /// What there is to say of one agent's map that grows.
    pub(super) fn of_agent(agent: &AgentInfo) -> Self {
        Self { agents: [(AgentId::default(), agent.clone())].into(), ..Self::default() }
    }

    /// The agents that have no identity because the file is of a version without any.
    pub(super) fn unknown(&self) -> Vec<AgentId> {
        let unknown = self.agents.iter().filter(|(_, info)| self.nameless && info.identity.is_none());
        unknown.map(|(id, _)| *id).collect()
    }

    /// Width and height of the cameras' images, pixels.
    pub(super) fn image_sizes(&self) -> Vec<(usize, usize)> {
        let cameras = self.agents.values().filter_map(AgentInfo::camera);
        cameras.map(|camera| (camera.width, camera.height)).collect()
    }

    /// The records to write.
    pub(super) fn records(&self) -> Vec<Metadata> {
        let format = [("format".to_owned(), FORMAT_VERSION.to_string())].into();
        let mut records = vec![record(MAP_METADATA.into(), format)];
        for (id, info) in &self.agents {
            records.push(record(format!("{AGENT_METADATA}{}", id.0), agent_to_text(info)));
        }
        records.extend(self.provenance());
        if !self.merge_provenance.is_empty() {
            records.push(record(MERGE_METADATA.into(), self.merge_provenance.clone()));
        }
        records
    }

    /// Those of them that say where the agents' maps came from; the last of an agent holds.
    pub(super) fn provenance(&self) -> impl Iterator<Item = Metadata> + '_ {
        let name = |id: &AgentId| format!("{PROVENANCE_METADATA}{}", id.0);
        self.agents.iter().map(move |(id, info)| record(name(id), info.provenance.clone()))
    }

    /// Takes a record as it was read; those that say nothing of a map are passed over.
    pub(super) fn take(&mut self, name: &str, entries: Entries) -> Result<(), AboutError> {
        if name == MAP_METADATA {
            return self.take_format(&entries);
        }
        if name == MERGE_METADATA {
            self.merge_provenance = entries;
        } else if let Some(id) = name.strip_prefix(AGENT_METADATA).and_then(agent_id) {
            let agent = agent_from_text(&entries).and_then(|info| check::agent(&info).map(|()| info));
            let invalid = |what| AboutError::Invalid(format!("agent {}: {what}", id.0));
            self.agents.insert(id, agent.map_err(invalid)?);
        } else if let Some(id) = name.strip_prefix(PROVENANCE_METADATA).and_then(agent_id) {
            if let Some(info) = self.agents.get_mut(&id) {
                info.provenance = entries;
            }
        } else if name == SINGLE_AGENT_PROVENANCE_METADATA
            && let Some(info) = self.agents.get_mut(&AgentId::default())
        {
            name_of_source(&entries).iter().for_each(|name| info.name.clone_from(name));
            info.provenance = entries;
        }
        Ok(())
    }

    /// Takes the version. A map of the format for one agent has its camera here too, and does not name
    /// the agent.
    fn take_format(&mut self, entries: &Entries) -> Result<(), AboutError> {
        let format = entries.get("format").cloned().unwrap_or_else(|| "unknown".into());
        self.nameless = [SINGLE_AGENT_FORMAT, NAMELESS_FORMAT].iter().any(|old| format == old.to_string());
        if format == SINGLE_AGENT_FORMAT.to_string() {
            let agent = AgentInfo::unnamed(camera_from_text(entries).map_err(AboutError::Invalid)?);
            check::agent(&agent).map_err(AboutError::Invalid)?;
            self.agents.insert(AgentId::default(), agent);
        } else if !self.nameless && format != FORMAT_VERSION.to_string() {
            return Err(AboutError::Version(format));
        }
        Ok(())
    }
}

/// A metadata record.
fn record(name: String, metadata: Entries) -> Metadata {
    Metadata { name, metadata }
}

/// The id at the end of a record's name.
fn agent_id(number: &str) -> Option<AgentId> {
    number.parse().ok().map(AgentId)
}

/// The last part of the recording's path, by which people know it.
fn name_of_source(provenance: &Entries) -> Option<String> {
    let name = Path::new(provenance.get("source")?).file_name()?.to_str()?;
    Some(name.to_owned())
}

/// An agent without its provenance and the poses of its own map.
fn agent_to_text(info: &AgentInfo) -> Entries {
    let sensor = match &info.sensor {
        Sensor::Camera(camera) => camera_to_text(camera),
        Sensor::Lidar => vec![("sensor", LIDAR.to_owned())],
    };
    let own = info
        .own
        .iter()
        .flat_map(|own| [("own_name", own.name.clone()), ("first_keyframe", own.first_keyframe.to_string())]);
    let identity = info.identity.iter();
    let identity = identity
        .flat_map(|identity| [("uuid", identity.uuid.to_string()), ("epoch", identity.epoch.to_string())]);
    [("name", info.name.clone())]
        .into_iter()
        .chain(sensor)
        .chain(identity)
        .chain(own)
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}

/// A camera, under the names that make it one.
fn camera_to_text(camera: &Pinhole) -> Vec<(&'static str, String)> {
    vec![
        ("width", camera.width.to_string()),
        ("height", camera.height.to_string()),
        ("fx", camera.fx.to_string()),
        ("fy", camera.fy.to_string()),
        ("cx", camera.cx.to_string()),
        ("cy", camera.cy.to_string()),
    ]
}

/// The inverse of [`agent_to_text`]; says what is missing.
fn agent_from_text(entries: &Entries) -> Result<AgentInfo, String> {
    let text = |key: &str| entries.get(key).cloned().unwrap_or_default();
    let own = match (entries.get("own_name"), entries.get("first_keyframe")) {
        (None, None) => None,
        (name, first) => Some(OwnMap {
            name: name.cloned().unwrap_or_default(),
            first_keyframe: first
                .and_then(|first| first.parse().ok())
                .ok_or("the first keyframe of its own map is missing or no number")?,
            world_from_keyframe: BTreeMap::new(),
        }),
    };
    let identity = match (entries.get("uuid"), entries.get("epoch")) {
        (None, None) => None,
        (uuid, epoch) => Some(Identity {
            uuid: uuid
                .and_then(|uuid| Uuid::try_parse(uuid).ok())
                .ok_or("its identity's uuid is missing or none")?,
            epoch: epoch
                .and_then(|epoch| epoch.parse().ok())
                .ok_or("its identity's epoch is missing or no number")?,
        }),
    };
    let sensor = match entries.get("sensor").map(String::as_str) {
        None => Sensor::Camera(camera_from_text(entries)?),
        Some(LIDAR) => Sensor::Lidar,
        Some(other) => return Err(format!("its sensor \"{other}\" is unknown")),
    };
    Ok(AgentInfo { own, identity, ..AgentInfo::new(text("name"), sensor) })
}

/// The camera from its text.
fn camera_from_text(entries: &Entries) -> Result<Pinhole, String> {
    fn number<T: FromStr>(entries: &Entries, key: &str) -> Result<T, String> {
        let text = entries.get(key).ok_or_else(|| format!("the camera's {key} is missing"))?;
        text.parse().map_err(|_| format!("the camera's {key} is \"{text}\", which is no number"))
    }
    Ok(Pinhole {
        width: number(entries, "width")?,
        height: number(entries, "height")?,
        fx: number(entries, "fx")?,
        fy: number(entries, "fy")?,
        cx: number(entries, "cx")?,
        cy: number(entries, "cy")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{sample_map, united};

    fn entries<const N: usize>(pairs: [(&str, &str); N]) -> Entries {
        pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).into()
    }

    #[test]
    fn records_say_all_but_the_poses_of_own_maps() {
        let map = united();
        let mut about = About::default();
        for record in About::of(&map).records() {
            about.take(&record.name, record.metadata).unwrap();
        }
        let mut expected = About::of(&map);
        expected.agents.values_mut().filter_map(|info| info.own.as_mut()).for_each(|own| {
            own.world_from_keyframe.clear();
        });
        assert_eq!(about, expected);
    }

    #[test]
    fn a_map_of_the_format_for_one_agent_has_the_name_of_its_recording() {
        let camera = [
            ("width", "24"),
            ("height", "18"),
            ("fx", "20.1"),
            ("fy", "20.3"),
            ("cx", "11.4"),
            ("cy", "8.7"),
        ];
        let mut about = About::default();
        let mut format = entries(camera);
        format.insert("format".into(), "1".into());
        about.take("loopbox.map", format).unwrap();
        let mut agent = sample_map(0).agents.remove(&AgentId(0)).unwrap();
        (agent.name, agent.provenance, agent.identity) = ("agent".into(), Entries::new(), None);
        assert_eq!(about.agents, [(AgentId(0), agent.clone())].into());
        let origin = entries([("source", "/recordings/yard/"), ("parameters", "defaults")]);
        about.take("loopbox.provenance", origin.clone()).unwrap();
        (agent.name, agent.provenance) = ("yard".into(), origin);
        assert_eq!(about.agents, [(AgentId(0), agent)].into());
    }

    #[test]
    fn what_is_missing_is_named() {
        let good = agent_to_text(&united().agents[&AgentId(1)]);
        let cases = [
            ("fx", "camera's fx is missing"),
            ("name", "no name"),
            ("first_keyframe", "first keyframe"),
            ("uuid", "uuid"),
            ("epoch", "epoch"),
        ];
        for (key, words) in cases {
            let mut entries = good.clone();
            entries.remove(key);
            let error = About::default().take("loopbox.agent.1", entries).unwrap_err();
            assert!(matches!(&error, AboutError::Invalid(what) if what.contains(words)), "{error:?}");
        }
        let newer = entries([("format", "4")]);
        let error = About::default().take("loopbox.map", newer).unwrap_err();
        assert!(matches!(error, AboutError::Version(found) if found == "4"));
    }
}
