//! Who is near an agent or a station, what is told of maps and what became of meeting, as pages show it.

use serde::Serialize;
use std::collections::BTreeMap;

/// The neighbours of an agent, and what was found with their maps.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Neighbourhood {
    /// Where others reach this agent.
    pub listening: Option<String>,
    /// Whom it knows.
    pub links: Vec<Neighbour>,
    /// Maps that others tell.
    pub maps: Vec<RemoteMap>,
    /// Pairs of maps that were looked at, here or by others.
    #[serde(rename = "meetings")]
    pub pair_verdicts: Vec<PairLine>,
    /// The last that was refused or went wrong, for people.
    pub trouble: Vec<String>,
    /// How many there are, beyond what pages list too.
    #[serde(skip)]
    pub counts: FleetCounts,
}

/// How many maps and pairs of them there are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FleetCounts {
    /// Maps that others tell.
    pub maps: usize,
    /// Of these, those whose run is over.
    pub finished: usize,
    /// Of these, those that hang together with another one.
    pub joined: usize,
    /// Objects of them that are not here yet.
    pub missing: usize,
    /// Pairs that were looked at here, by their verdict.
    pub pairs: BTreeMap<String, usize>,
}

/// A neighbour.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Neighbour {
    /// What people call it.
    pub name: String,
    /// Where it is; nothing while there is no link.
    pub address: Option<String>,
    /// Seconds for which it has been there, or has not.
    pub since_s: f64,
    /// Why it is not there, of one that is dialled and does not answer.
    pub why: Option<String>,
    /// Bytes of its maps that came.
    pub received: u64,
    /// Bytes of these that were here already.
    #[serde(skip)]
    pub useless: u64,
    /// Objects that are to be fetched from it by now.
    pub wanted: usize,
    /// The measured rate at which it sends them, bytes a second.
    pub rate: f64,
    /// Objects of the own map that it does not hold yet; nothing while it has not said.
    pub lacks: Option<u64>,
}

/// A map that is told here.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RemoteMap {
    /// What people call its agent, as far as that is known.
    pub name: String,
    /// Keyframes of its newest version.
    pub keyframes: usize,
    /// Objects of it that are not here yet.
    pub missing: usize,
    /// Whether its run is over.
    pub finished: bool,
    /// Whether it is a LiDAR's.
    pub is_lidar: bool,
    /// Whether it hangs together with another one.
    pub is_joined: bool,
}

/// Two agents.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PairLine {
    /// Their names.
    pub names: [String; 2],
    /// `accepted`, `not yet`, `undecided` or `refused`.
    pub verdict: String,
    /// Why not, where they were not merged.
    pub why: Option<String>,
    /// Whether another one found that, and not this agent.
    #[serde(rename = "is_told")]
    pub is_remote: bool,
}
