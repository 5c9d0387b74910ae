//! A map that was read.

use map::Map;
use std::path::PathBuf;

/// A map that was read.
#[derive(Clone, Debug)]
pub struct OpenedMap {
    /// Its file.
    pub file: PathBuf,
    /// The map.
    pub map: Map,
    /// What is missing from it, and what else there is to know, for people.
    pub warnings: Vec<String>,
}
