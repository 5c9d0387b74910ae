//! Immutable objects by name: put once, read by many. One interface for a folder, for memory and for buckets.
//!
//! Whoever puts an object calls it by what it holds or by all that it follows from, so that two that are put under one name are the same,
//! and it does not matter who is first, how often it is put, or who is killed meanwhile.

#[cfg(feature = "object-store")]
mod bucket;
#[cfg(feature = "object-store")]
mod copies;
mod folder;
mod memory;
#[cfg(feature = "object-store")]
mod recordings;
#[cfg(test)]
mod tests;
mod uri;

#[cfg(feature = "object-store")]
pub use bucket::BucketBlobs;
pub use folder::FolderBlobs;
pub use memory::MemoryBlobs;
pub use uri::{LocalMap, Place, local_files, local_maps, local_pair, local_recording, open, recordings_at};

use anyhow::Result;
use std::fmt::Debug;

/// The map of a folder of results.
const MAP: &str = "map.mcap";
/// How other names of maps end.
const MAP_EXTENSION: &str = ".mcap";

/// Immutable objects by name. A name is one or several words with `/` between them, none of which begins with a dot.
///
/// # Errors
/// All functions fail where what keeps the objects cannot be reached or refuses; the error names the object.
pub trait Blobs: Debug + Send + Sync {
    /// The object; nothing where there is none of that name.
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>>;

    /// Whether there is an object of that name.
    fn has(&self, name: &str) -> Result<bool>;

    /// Keeps an object, whole or not at all, where there is none of that name; the first one stays.
    fn put(&self, name: &str, bytes: &[u8]) -> Result<()>;

    /// The names that begin so, ascending.
    fn list(&self, prefix: &str) -> Result<Vec<String>>;

    /// Where an object is or would be, for people.
    fn address(&self, name: &str) -> String;
}

/// The maps right under a prefix, which ends with `/` unless it is empty, or in folders right under it.
pub(crate) fn maps_among(names: &[String], prefix: &str) -> Vec<String> {
    let is_map =
        |name: &&String| match name.strip_prefix(prefix).map(|within| (within, within.split_once('/'))) {
            Some((_, Some((_, file)))) => file == MAP,
            Some((within, None)) => within.ends_with(MAP_EXTENSION),
            None => false,
        };
    names.iter().filter(is_map).cloned().collect()
}
