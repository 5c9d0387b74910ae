//! What can go wrong with maps and their files.

use crate::SensorKind;
use std::io;
use std::path::{Path, PathBuf};

/// Why a map could not be written, read or united. Messages about a file name it and say how to fix it.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file cannot be opened or read.
    #[error("cannot read {}: {reason}; check the path and its permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        reason: io::Error,
    },
    /// The file cannot be written; a file of that name from before is as it was, unless it was being
    /// written to bit by bit by a [`MapWriter`](crate::MapWriter).
    #[error("cannot write {}: {reason}; check the free space, the folder and its permissions", path.display())]
    Write {
        /// The file that was to be written.
        path: PathBuf,
        /// The system's reason.
        reason: io::Error,
    },
    /// The file has no content.
    #[error("{} is empty; the run that made it ended before it wrote anything, so run it again", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file is not an MCAP file.
    #[error("{} is not an MCAP file; give the map.mcap of a run", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The file is an MCAP file, but not a map.
    #[error("{} is an MCAP file but holds no loopbox map; a recording is turned into one by `loopbox run`", path.display())]
    NotAMap {
        /// The file.
        path: PathBuf,
    },
    /// The map was written in another version of the format.
    #[error("{} has map format {found}, this program reads format {supported}; use the loopbox version that wrote it, or run the recording again", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// The version in the file.
        found: String,
        /// The version this program reads and writes.
        supported: u32,
    },
    /// The content contradicts itself, in a file to read or in a map to write.
    #[error("{}: {what}; a map like this cannot be used, run the recording again", path.display())]
    Invalid {
        /// The file read, or to be written.
        path: PathBuf,
        /// What is wrong and where.
        what: String,
    },
    /// Maps to be united hold the same agent.
    #[error("the same map twice: the maps number {} and {} (\"{}\", \"{}\") are of the same run; give each map once",
        maps[0] + 1, maps[1] + 1, agents[0], agents[1])]
    SameMapTwice {
        /// Which of the maps given, from 0, the earlier first.
        maps: [usize; 2],
        /// The agents' names in them.
        agents: [String; 2],
    },
    /// A function for maps of one sensor was given one of another.
    #[error("agent \"{agent}\" has a {found}; this needs maps of agents with a {wanted}")]
    Sensor {
        /// The agent.
        agent: String,
        /// What it has.
        found: SensorKind,
        /// What is needed.
        wanted: SensorKind,
    },
    /// Maps that cannot be united.
    #[error("the maps cannot be united: {0}")]
    Union(String),
}

impl MapError {
    /// A failure to read `path`.
    pub(crate) fn read(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.to_owned(), reason: source }
    }

    /// A failure to write `path`.
    pub fn write(path: &Path, source: io::Error) -> Self {
        Self::Write { path: path.to_owned(), reason: source }
    }

    /// Contradictory content of `path`.
    pub(crate) fn invalid(path: &Path, what: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_owned(), what: what.into() }
    }
}
