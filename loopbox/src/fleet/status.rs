//! How things are with a party of the fleet, as its file says it.

use super::findings::{Found, FoundMeeting};
use anyhow::{Context, Result};
use fleet::node::{AgentStatus, NeighbourStatus};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;
use view::watch::{Meeting, Neighbour, Neighbourhood};

/// The file that says how things are.
pub const STATUS: &str = "fleet.json";

/// How things are, as the file `fleet.json` says it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct StatusFile {
    /// What people call this party.
    pub name: String,
    /// Where it listens.
    pub listening: Option<String>,
    /// Whom it knows.
    pub links: Vec<LinkLine>,
    /// Maps of others that are told here.
    pub agents: Vec<AgentLine>,
    /// What was found out here about where agents are.
    pub found: Found,
    /// What others found out, by their names.
    pub told: Vec<(String, Found)>,
    /// The last that was refused or went wrong.
    pub trouble: Vec<String>,
}

/// A neighbour.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkLine {
    /// What people call it.
    pub name: String,
    /// Where it is; nothing while there is no link.
    pub address: Option<String>,
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
    /// Keyframes of its newest version.
    pub keyframes: usize,
    /// Objects of it that are not here yet.
    pub missing: usize,
    /// Whether its run has ended.
    pub finished: bool,
}

impl LinkLine {
    /// Of a neighbour.
    pub(super) fn of(neighbour: &NeighbourStatus) -> Self {
        Self {
            name: neighbour.name.clone(),
            address: neighbour.address.clone(),
            silent_s: neighbour.silent.map(|silent| silent.as_secs_f64()),
            received: neighbour.received,
            useless: neighbour.useless,
            wanted: neighbour.wanted,
            rate: neighbour.rate,
            lacks: neighbour.lacks,
        }
    }
}

impl AgentLine {
    /// Of an agent.
    pub(super) fn of(agent: &AgentStatus) -> Self {
        Self {
            agent: agent.agent.to_string(),
            teller: agent.teller.clone(),
            keyframes: agent.keyframes,
            missing: agent.missing,
            finished: agent.finished,
        }
    }
}

impl StatusFile {
    /// The same as pages show it: what was found here, and what others say of pairs that were not looked at here.
    pub(super) fn neighbourhood(&self) -> Neighbourhood {
        let link = |link: &LinkLine| Neighbour {
            name: link.name.clone(),
            address: link.address.clone(),
            received: link.received,
            wanted: link.wanted,
            rate: link.rate,
            lacks: link.lacks,
        };
        let mut meetings: Vec<Meeting> = Vec::new();
        let told = self.told.iter().map(|(_, found)| (true, found));
        for (is_told, found) in std::iter::once((false, &self.found)).chain(told) {
            for FoundMeeting { names, verdict, why, .. } in &found.meetings {
                let of_both = |known: &Meeting| names.iter().all(|name| known.names.contains(name));
                if !meetings.iter().any(of_both) {
                    let (names, verdict, why) = (names.clone(), verdict.clone(), why.clone());
                    meetings.push(Meeting { names, verdict, why, is_told });
                }
            }
        }
        let (listening, trouble) = (self.listening.clone(), self.trouble.clone());
        Neighbourhood { listening, links: self.links.iter().map(link).collect(), meetings, trouble }
    }
}

/// How things are or were with the party whose results are in `folder`.
///
/// # Errors
/// When there is none.
pub fn read_status(folder: &Path) -> Result<StatusFile> {
    let path = folder.join(STATUS);
    let text = fs::read(&path).with_context(|| {
        format!(
            "{}: cannot be read\nhint: give the folder of `loopbox station` or of `loopbox run --fleet`",
            path.display()
        )
    })?;
    serde_json::from_slice(&text).with_context(|| format!("{}: is no such file", path.display()))
}
