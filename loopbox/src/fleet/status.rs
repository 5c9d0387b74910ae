//! How things are with a party of the fleet, as its file says it.

use super::waiting::{Waited, Waits};
use anyhow::Context;
use fleet::findings::{Found, FoundMeeting};
use fleet::node::{AgentStatus, NeighbourStatus};
use map::SensorKind;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use view::watch::{Meeting, Neighbour, Neighbourhood, ToldMap};

/// Maps and pairs of them that a page shows at the most: what others found may be any number.
const SHOWN: usize = 200;
/// The file that says how things are.
pub const STATUS: &str = "fleet.json";

/// How things are, as the file `fleet.json` says it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StatusFile {
    /// What people call this party.
    pub name: String,
    /// When this was written, milliseconds since 1970; every second as long as the party is at work.
    pub written_ms: u64,
    /// Whether it has ended, and was not killed.
    pub ended: bool,
    /// Where it listens.
    pub listening: Option<String>,
    /// Whom it knows.
    pub links: Vec<LinkLine>,
    /// Maps of others that are told here.
    pub agents: Vec<AgentLine>,
    /// What was found out here about where agents are.
    pub found: Found,
    /// What others found out, by their names.
    pub told: Vec<(String, ToldFound)>,
    /// The last that was refused or went wrong.
    pub trouble: Vec<String>,
}

/// What another one found out.
#[derive(Clone, Debug, Default)]
pub struct ToldFound(pub Arc<Found>);

impl Serialize for ToldFound {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(to)
    }
}

impl<'de> Deserialize<'de> for ToldFound {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Found::deserialize(from).map(|found| Self(found.into()))
    }
}

/// A neighbour.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkLine {
    /// What people call it.
    pub name: String,
    /// Where it is; nothing while there is no link.
    pub address: Option<String>,
    /// Seconds for which it has been there, or has not.
    pub since_s: f64,
    /// Why it is not there, of one that is dialled and does not answer.
    pub why: Option<String>,
    /// Seconds since it was last heard; nothing while there is no link.
    pub silent_s: Option<f64>,
    /// Bytes of objects that came from it.
    pub received: u64,
    /// Bytes of them that were here already.
    pub useless: u64,
    /// Objects that are to be fetched from it by now.
    pub wanted: usize,
    /// The measured rate at which it sends them, bytes a second.
    pub rate: f64,
    /// Objects of own maps that it has not acknowledged; nothing while it has not said.
    pub lacks: Option<u64>,
}

/// Another's map.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct AgentLine {
    /// Its identity, `UUID/EPOCH`.
    pub agent: String,
    /// Who tells it; nothing of one that was here when the program began.
    pub teller: Option<String>,
    /// The kind of its sensor; nothing while no keyframe is told of.
    pub sensor: Option<SensorKind>,
    /// Keyframes of its newest version.
    pub keyframes: usize,
    /// Objects of it that are not here yet.
    pub missing: usize,
    /// Whether its run has ended.
    pub finished: bool,
    /// Seconds from hearing of it until it was told its place; nothing while it has none.
    pub heard_to_place_s: Option<f64>,
    /// The same from having the parts of its map by which its place was to be seen; nothing where all of it was here first.
    pub parts_to_place_s: Option<f64>,
}

impl LinkLine {
    /// Of a neighbour.
    pub(super) fn of(neighbour: &NeighbourStatus) -> Self {
        Self {
            name: neighbour.name.clone(),
            address: neighbour.address.clone(),
            since_s: neighbour.since.as_secs_f64(),
            why: None,
            silent_s: neighbour.silent.map(|silent| silent.as_secs_f64()),
            received: neighbour.received,
            useless: neighbour.useless,
            wanted: neighbour.wanted,
            rate: neighbour.rate,
            lacks: neighbour.lacks,
        }
    }

    /// Of an address at which nobody answers.
    pub(super) fn unanswered((address, since, reason): &(String, Duration, String)) -> Self {
        let (name, why) = (address.clone(), Some(reason.clone()));
        Self { name, why, since_s: since.as_secs_f64(), ..Self::default() }
    }
}

impl AgentLine {
    /// Of an agent.
    pub(super) fn of(agent: &AgentStatus, waits: &Waits) -> Self {
        let Waited { heard_s, parts_s } = waits.of(&agent.agent);
        Self {
            agent: agent.agent.to_string(),
            teller: agent.teller.clone(),
            sensor: agent.sensor,
            keyframes: agent.keyframes,
            missing: agent.missing,
            finished: agent.finished,
            heard_to_place_s: heard_s,
            parts_to_place_s: parts_s,
        }
    }
}

/// How old a status is that a party at work has written: longer, and nobody is there to write it.
const STALE: Duration = Duration::from_secs(10);

impl StatusFile {
    /// Seconds since it was written.
    pub fn age_s(&self) -> f64 {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        now.saturating_sub(Duration::from_millis(self.written_ms)).as_secs_f64()
    }

    /// Whether the party was at work and gives no sign of life: it was killed, or stands still.
    pub fn is_stale(&self) -> bool {
        !self.ended && self.age_s() > STALE.as_secs_f64()
    }

    /// What people call a map: by the name of its agent, once it was looked at, else by who tells it, else by its identity.
    pub fn name_of<'a>(&'a self, line: &'a AgentLine) -> &'a str {
        let about = self.all().find_map(|found| found.agents.iter().find(|about| about.agent == line.agent));
        about.map(|about| &about.name).or(line.teller.as_ref()).unwrap_or(&line.agent)
    }

    /// What was found here, and by others.
    fn all(&self) -> impl Iterator<Item = &Found> {
        std::iter::once(&self.found).chain(self.told.iter().map(|(_, found)| &*found.0))
    }

    /// The same as pages show it: what was found here, and what others say of pairs that were not looked at here.
    pub(super) fn neighbourhood(&self) -> Neighbourhood {
        let link = |link: &LinkLine| Neighbour {
            name: link.name.clone(),
            address: link.address.clone(),
            since_s: link.since_s,
            why: link.why.clone(),
            received: link.received,
            wanted: link.wanted,
            rate: link.rate,
            lacks: link.lacks,
        };
        let told = self.told.iter().map(|(_, found)| (true, &*found.0));
        let all = std::iter::once((false, &self.found)).chain(told);
        let mut seen = BTreeSet::new();
        let is_new = |(_, meeting): &(bool, &FoundMeeting)| {
            let mut both = [&meeting.agents, &meeting.names].map(|both| both.clone());
            both.iter_mut().for_each(|both| both.sort());
            // What earlier versions found has no identities.
            let [agents, names] = both;
            seen.insert(if agents[0].is_empty() { names } else { agents })
        };
        let each =
            all.flat_map(|(is_told, found)| found.meetings.iter().map(move |meeting| (is_told, meeting)));
        let meeting = |(is_told, meeting): (bool, &FoundMeeting)| {
            let FoundMeeting { names, verdict, why, .. } = meeting.clone();
            Meeting { names, verdict, why, is_told }
        };
        let meetings = each.filter(is_new).take(SHOWN).map(meeting).collect();
        let (listening, trouble) = (self.listening.clone(), self.trouble.clone());
        let links = self.links.iter().map(link).collect();
        let maps = self.agents.iter().take(SHOWN).map(|line| self.told_map(line)).collect();
        Neighbourhood { listening, links, maps, meetings, trouble }
    }

    /// Another's map, as pages show it; its agent's name is known once the map was looked at.
    fn told_map(&self, line: &AgentLine) -> ToldMap {
        ToldMap {
            name: self.name_of(line).to_owned(),
            keyframes: line.keyframes,
            missing: line.missing,
            finished: line.finished,
            is_lidar: line.sensor == Some(SensorKind::Lidar),
            is_joined: self.all().any(|found| found.is_joined(&line.agent)),
        }
    }
}

/// How things are or were with the party whose results are in `folder`.
///
/// # Errors
/// When there is none.
pub fn read_status(folder: &Path) -> anyhow::Result<StatusFile> {
    let path = folder.join(STATUS);
    let text = fs::read(&path).with_context(|| {
        format!(
            "{}: cannot be read\nhint: give the folder of `loopbox station` or of `loopbox run --fleet`",
            path.display()
        )
    })?;
    serde_json::from_slice(&text).with_context(|| format!("{}: is no such file", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use fleet::findings::FoundAgent;

    fn found(pairs: impl Iterator<Item = [u32; 2]>, verdict: &str) -> Found {
        let meeting = |pair: [u32; 2]| FoundMeeting {
            names: ["one".into(), "other".into()],
            agents: pair.map(|agent| agent.to_string()),
            verdict: verdict.into(),
            why: None,
            pending: false,
        };
        Found { agents: Vec::new(), meetings: pairs.map(meeting).collect() }
    }

    #[test]
    fn a_page_shows_maps_by_the_names_of_their_agents_and_whether_they_hang_together() {
        let line = |agent: &str, missing| AgentLine {
            agent: agent.into(),
            teller: Some("car".into()),
            missing,
            ..AgentLine::default()
        };
        let about = |agent: &str, root: &str| FoundAgent {
            agent: agent.into(),
            name: format!("the {agent}"),
            keyframes: 3,
            whole: true,
            root: root.into(),
            root_from_agent: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0],
        };
        let agents = vec![about("a", "a"), about("b", "a"), about("c", "c")];
        let status = StatusFile {
            agents: vec![line("a", 0), line("b", 4), line("c", 0), line("d", 0)],
            found: Found { agents, meetings: Vec::new() },
            ..StatusFile::default()
        };
        let shown = status.neighbourhood().maps;
        let said: Vec<_> = shown.iter().map(|map| (&*map.name, map.missing, map.is_joined)).collect();
        assert_eq!(said, [("the a", 0, true), ("the b", 4, true), ("the c", 0, false), ("car", 0, false)]);
    }

    #[test]
    fn keys_of_the_status_file_stay() {
        let line = AgentLine { teller: Some("car".into()), heard_to_place_s: Some(1.0), ..AgentLine::default() };
        let told = vec![("x".into(), ToldFound(found([[2, 1]].into_iter(), "refused").into()))];
        let status = StatusFile { agents: vec![line], told, ..StatusFile::default() };
        let status = serde_json::to_value(status).unwrap();
        for key in ["/agents/0/teller", "/agents/0/heard_to_place_s", "/told/0/1", "/found/meetings"] {
            assert!(status.pointer(key).is_some(), "no {key} in {status:#}");
        }
    }

    #[test]
    fn a_page_shows_what_was_found_here_and_of_other_pairs_what_others_found_within_limits() {
        let mut status =
            StatusFile { found: found([[1, 2]].into_iter(), "accepted"), ..StatusFile::default() };
        let told = |found: Found| ToldFound(found.into());
        status.told = vec![("x".into(), told(found([[2, 1], [1, 3]].into_iter(), "refused")))];
        let shown: Vec<(String, bool)> =
            status.neighbourhood().meetings.into_iter().map(|m| (m.verdict, m.is_told)).collect();
        assert_eq!(shown, [("accepted".into(), false), ("refused".into(), true)]);
        status.told.push(("y".into(), told(found((10..100_000).map(|other| [1, other]), "refused"))));
        assert_eq!(status.neighbourhood().meetings.len(), SHOWN);
    }
}
