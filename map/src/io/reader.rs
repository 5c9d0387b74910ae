//! Loading maps.

mod contents;

use super::about::AboutError;
use super::records::{Stop, read_file};
use super::{FORMAT_VERSION, PROFILE};
use crate::{Map, MapError, SensorKind};
use contents::Contents;
use geometry::Swap;
use mcap::records::{Record, op};
use mcap::{McapError, parse_record};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// A map from a file, and whether it is all that was to be in the file.
#[derive(Clone, Debug)]
pub struct LoadedMap {
    /// The map.
    pub map: Map,
    /// Whether the file is whole: written to its end, and nothing damaged since.
    pub complete: bool,
    /// Warnings for the user; empty when the map is complete.
    pub warnings: Vec<String>,
}

/// Loads a map file. From a file that ends early or is damaged in places it loads what is intact: keyframes with
/// image and depth, and the edges, observations and frames that refer to them.
///
/// # Errors
/// [`MapError::Read`], [`MapError::Empty`], [`MapError::NotMcap`], [`MapError::NotAMap`],
/// [`MapError::Version`]; [`MapError::Invalid`] when what is whole contradicts itself.
pub fn load_map(path: impl AsRef<Path>) -> Result<LoadedMap, MapError> {
    load(path.as_ref(), None)
}

/// [`load_map`] for a map that may exceed memory: `swap` keeps images, depths, features and words from the
/// time they are read, as far as it has room.
///
/// # Errors
/// As [`load_map`].
pub fn load_map_swapped(path: impl AsRef<Path>, swap: &dyn Swap) -> Result<LoadedMap, MapError> {
    load(path.as_ref(), Some(swap))
}

fn load(path: &Path, swap: Option<&dyn Swap>) -> Result<LoadedMap, MapError> {
    let opened = File::open(path).and_then(|file| file.metadata().map(|about| (file, about.len())));
    let (file, length) = opened.map_err(|source| MapError::read(path, source))?;
    if length == 0 {
        return Err(MapError::Empty { path: path.to_owned() });
    }
    let mut contents = Contents::new(swap);
    let end = read_file(&mut BufReader::new(file), length, &mut |opcode, data| contents.record(opcode, data));
    match end {
        Ok(()) => {}
        Err(Stop::Failed(source)) => return Err(MapError::read(path, source)),
        Err(Stop::Refused(refusal)) => return Err(refusal.at(path)),
        Err(Stop::Damaged(_)) if !contents.has_header => {
            return Err(MapError::NotMcap { path: path.to_owned() });
        }
        Err(Stop::Damaged(McapError::UnexpectedEof)) => {
            contents.damage("the file ends early: the run was killed or the disk was full".into());
        }
        Err(Stop::Damaged(error)) => contents.damage(format!("the file is damaged: {error}")),
    }
    contents.into_map().map_err(|refusal| refusal.at(path))
}

/// Whether a file's header marks it as a map, complete or not, rather than a recording.
pub fn is_map_file(path: impl AsRef<Path>) -> bool {
    let Ok(file) = File::open(path) else { return false };
    let length = file.metadata().map_or(0, |about| about.len());
    // The header is the first record; reading stops with what it says.
    let first = read_file(&mut BufReader::new(file), length, &mut |opcode, data| {
        Err(matches!(parse_record(opcode, data), Ok(Record::Header(header)) if header.profile == PROFILE))
    });
    matches!(first, Err(Stop::Refused(true)))
}

/// The kinds of the sensors of a map's agents, from the file's first records, without reading its keyframes.
///
/// # Errors
/// As [`load_map`], as far as the first records say.
pub fn sensors_of(path: impl AsRef<Path>) -> Result<BTreeSet<SensorKind>, MapError> {
    let path = path.as_ref();
    let opened = File::open(path).and_then(|file| file.metadata().map(|about| (file, about.len())));
    let (file, length) = opened.map_err(|source| MapError::read(path, source))?;
    let mut contents = Contents::default();
    // What is said of agents comes before all chunks.
    let end = read_file(&mut BufReader::new(file), length, &mut |opcode, data| match opcode {
        op::CHUNK => Err(None),
        _ => contents.record(opcode, data).map_err(Some),
    });
    match end {
        Err(Stop::Refused(Some(refusal))) => return Err(refusal.at(path)),
        Err(Stop::Failed(source)) => return Err(MapError::read(path, source)),
        Ok(()) | Err(Stop::Refused(None) | Stop::Damaged(_)) => {}
    }
    if !contents.has_header {
        return Err(MapError::NotMcap { path: path.to_owned() });
    }
    Ok(contents.about.agents.values().map(|info| info.sensor.kind()).collect())
}

/// Why a file cannot be loaded.
#[derive(Debug)]
enum Refusal {
    NotAMap,
    Version(String),
    Invalid(String),
}

impl From<String> for Refusal {
    fn from(what: String) -> Self {
        Self::Invalid(what)
    }
}

impl From<AboutError> for Refusal {
    fn from(error: AboutError) -> Self {
        match error {
            AboutError::Version(found) => Self::Version(found),
            AboutError::Invalid(what) => Self::Invalid(what),
        }
    }
}

impl Refusal {
    /// The error for the file `path`.
    fn at(self, path: &Path) -> MapError {
        let path = path.to_owned();
        match self {
            Self::NotAMap => MapError::NotAMap { path },
            Self::Version(found) => MapError::Version { path, found, supported: FORMAT_VERSION },
            Self::Invalid(what) => MapError::Invalid { path, what },
        }
    }
}
