//! How things are with a peer of the fleet, as its file says it.

use super::waiting::{Waited, Waits};
use anyhow::Context;
use fleet::merge_results::{MergeResults, PairVerdict};
use fleet::node::{AgentStatus, NeighbourStatus};
use map::SensorKind;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use view::watch::{FleetCounts, Neighbour, Neighbourhood, PairLine, RemoteMap};

/// Maps and pairs of them that a page shows at the most: what others found may be any number.
const MAX_LISTED: usize = 200;
/// The file that says how things are.
pub const STATUS: &str = "fleet.json";

/// How things are, as the file `fleet.json` says it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StatusFile {
    /// What people call this peer.
    pub name: String,
    /// When this was written, milliseconds since 1970; every second as long as the peer is at work.
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
    pub found: MergeResults,
    /// What others found out, by their names.
    #[serde(rename = "told")]
    pub remote_results: Vec<(String, RemoteResults)>,
    /// The last that was refused or went wrong.
    pub trouble: Vec<String>,
}

/// What another one found out.
#[derive(Clone, Debug, Default)]
pub struct RemoteResults(pub Arc<MergeResults>);

impl Serialize for RemoteResults {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(to)
    }
}

impl<'de> Deserialize<'de> for RemoteResults {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        MergeResults::deserialize(from).map(|found| Self(found.into()))
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
    #[serde(rename = "teller")]
    pub publisher: Option<String>,
    /// The kind of its sensor; nothing while no keyframe is told of.
    pub sensor: Option<SensorKind>,
    /// Keyframes of its newest version.
    pub keyframes: usize,
    /// Objects of it that are not here yet.
    pub missing: usize,
    /// Whether its run has ended.
    pub finished: bool,
    /// Seconds from hearing of it until it was told its place; nothing while it has none.
    #[serde(rename = "heard_to_place_s")]
    pub discovery_to_place_s: Option<f64>,
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
        let Waited { since_discovery_s, parts_s } = waits.of(&agent.agent);
        Self {
            agent: agent.agent.to_string(),
            publisher: agent.publisher.clone(),
            sensor: agent.sensor,
            keyframes: agent.keyframes,
            missing: agent.missing,
            finished: agent.finished,
            discovery_to_place_s: since_discovery_s,
            parts_to_place_s: parts_s,
        }
    }
}

/// How old a status is that a peer at work has written: longer, and nobody is there to write it.
const STALE: Duration = Duration::from_secs(10);

impl StatusFile {
    /// Seconds since it was written.
    pub fn age_s(&self) -> f64 {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        now.saturating_sub(Duration::from_millis(self.written_ms)).as_secs_f64()
    }

    /// Whether the peer was at work and gives no sign of life: it was killed, or stands still.
    pub fn is_stale(&self) -> bool {
        !self.ended && self.age_s() > STALE.as_secs_f64()
    }

    /// What people call a map: by the name of its agent, once it was looked at, else by who tells it, else by its identity.
    pub fn name_of<'a>(&'a self, line: &'a AgentLine) -> &'a str {
        let about = self.all().find_map(|found| found.agents.iter().find(|about| about.agent == line.agent));
        about.map(|about| &about.name).or(line.publisher.as_ref()).unwrap_or(&line.agent)
    }

    /// What was found here, and by others.
    fn all(&self) -> impl Iterator<Item = &MergeResults> {
        std::iter::once(&self.found).chain(self.remote_results.iter().map(|(_, found)| &*found.0))
    }

    /// The same as pages show it: what was found here, and what others say of pairs that were not looked at here.
    pub(super) fn neighbourhood(&self) -> Neighbourhood {
        let link = |link: &LinkLine| Neighbour {
            name: link.name.clone(),
            address: link.address.clone(),
            since_s: link.since_s,
            why: link.why.clone(),
            received: link.received,
            useless: link.useless,
            wanted: link.wanted,
            rate: link.rate,
            lacks: link.lacks,
        };
        let remote_results = self.remote_results.iter().map(|(_, found)| (true, &*found.0));
        let all = std::iter::once((false, &self.found)).chain(remote_results);
        let mut seen = BTreeSet::new();
        let is_new = |(_, pair_verdict): &(bool, &PairVerdict)| {
            let mut both = [&pair_verdict.agents, &pair_verdict.names].map(|both| both.clone());
            both.iter_mut().for_each(|both| both.sort());
            // What earlier versions found has no identities.
            let [agents, names] = both;
            seen.insert(if agents[0].is_empty() { names } else { agents })
        };
        let each = all.flat_map(|(is_remote, found)| {
            found.pair_verdicts.iter().map(move |pair_verdict| (is_remote, pair_verdict))
        });
        let pair_verdict = |(is_remote, pair_verdict): (bool, &PairVerdict)| {
            let PairVerdict { names, verdict, why, .. } = pair_verdict.clone();
            PairLine { names, verdict, why, is_remote }
        };
        let pair_verdicts = each.filter(is_new).take(MAX_LISTED).map(pair_verdict).collect();
        let (listening, trouble) = (self.listening.clone(), self.trouble.clone());
        let links = self.links.iter().map(link).collect();
        let maps = self.agents.iter().take(MAX_LISTED).map(|line| self.remote_map(line)).collect();
        Neighbourhood { listening, links, maps, pair_verdicts, trouble, counts: self.counts() }
    }

    /// How many maps others tell, how many hang together by what was found here or by others, and what was found here.
    fn counts(&self) -> FleetCounts {
        let mut joined: BTreeSet<&str> = BTreeSet::new();
        for found in self.all() {
            let mut of_root: BTreeMap<&str, usize> = BTreeMap::new();
            found.agents.iter().for_each(|about| *of_root.entry(&about.root).or_default() += 1);
            let several = found.agents.iter().filter(|about| of_root[&*about.root] > 1);
            joined.extend(several.map(|about| &*about.agent));
        }
        let mut counts = FleetCounts { maps: self.agents.len(), ..FleetCounts::default() };
        for line in &self.agents {
            counts.finished += usize::from(line.finished);
            counts.joined += usize::from(joined.contains(&*line.agent));
            counts.missing += line.missing;
        }
        for pair_verdict in &self.found.pair_verdicts {
            *counts.pairs.entry(pair_verdict.verdict.clone()).or_default() += 1;
        }
        counts
    }

    /// Another's map, as pages show it; its agent's name is known once the map was looked at.
    fn remote_map(&self, line: &AgentLine) -> RemoteMap {
        RemoteMap {
            name: self.name_of(line).to_owned(),
            keyframes: line.keyframes,
            missing: line.missing,
            finished: line.finished,
            is_lidar: line.sensor == Some(SensorKind::Lidar),
            is_joined: self.all().any(|found| found.is_joined(&line.agent)),
        }
    }
}

/// How things are or were with the peer whose results are in `folder`.
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
    use fleet::merge_results::PlacedAgent;

    fn found(pairs: impl Iterator<Item = [u32; 2]>, verdict: &str) -> MergeResults {
        let pair_verdict = |pair: [u32; 2]| PairVerdict {
            names: ["one".into(), "other".into()],
            agents: pair.map(|agent| agent.to_string()),
            verdict: verdict.into(),
            why: None,
            pending: false,
        };
        MergeResults { agents: Vec::new(), pair_verdicts: pairs.map(pair_verdict).collect() }
    }

    #[test]
    fn a_page_shows_maps_by_the_names_of_their_agents_and_whether_they_hang_together() {
        let line = |agent: &str, missing| AgentLine {
            agent: agent.into(),
            publisher: Some("car".into()),
            missing,
            ..AgentLine::default()
        };
        let about = |agent: &str, root: &str| PlacedAgent {
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
            found: MergeResults { agents, pair_verdicts: Vec::new() },
            ..StatusFile::default()
        };
        let listed = status.neighbourhood().maps;
        let lines: Vec<_> = listed.iter().map(|map| (&*map.name, map.missing, map.is_joined)).collect();
        assert_eq!(lines, [("the a", 0, true), ("the b", 4, true), ("the c", 0, false), ("car", 0, false)]);
        let FleetCounts { maps, finished, joined, missing, .. } = status.neighbourhood().counts;
        assert_eq!((maps, finished, joined, missing), (4, 0, 2, 4));
    }

    #[test]
    fn keys_of_the_status_file_stay() {
        let line = AgentLine {
            publisher: Some("car".into()),
            discovery_to_place_s: Some(1.0),
            ..AgentLine::default()
        };
        let remote_results = vec![("x".into(), RemoteResults(found([[2, 1]].into_iter(), "refused").into()))];
        let status = StatusFile { agents: vec![line], remote_results, ..StatusFile::default() };
        let status = serde_json::to_value(status).unwrap();
        for key in ["/agents/0/teller", "/agents/0/heard_to_place_s", "/told/0/1", "/found/meetings"] {
            assert!(status.pointer(key).is_some(), "no {key} in {status:#}");
        }
    }

    #[test]
    fn a_page_shows_what_was_found_here_and_of_other_pairs_what_others_found_within_limits() {
        let mut status =
            StatusFile { found: found([[1, 2]].into_iter(), "accepted"), ..StatusFile::default() };
        let remote_results = |found: MergeResults| RemoteResults(found.into());
        status.remote_results =
            vec![("x".into(), remote_results(found([[2, 1], [1, 3]].into_iter(), "refused")))];
        let listed: Vec<(String, bool)> =
            status.neighbourhood().pair_verdicts.into_iter().map(|m| (m.verdict, m.is_remote)).collect();
        assert_eq!(listed, [("accepted".into(), false), ("refused".into(), true)]);
        status
            .remote_results
            .push(("y".into(), remote_results(found((10..100_000).map(|other| [1, other]), "refused"))));
        assert_eq!(status.neighbourhood().pair_verdicts.len(), MAX_LISTED);
        status.found = found((10..1010).map(|other| [1, other]), "not yet");
        let counts = status.neighbourhood().counts.pairs;
        assert_eq!(counts, BTreeMap::from([("not yet".to_owned(), 1000)]), "all of them are counted");
    }
}
