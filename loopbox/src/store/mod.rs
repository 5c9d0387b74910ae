//! A store at rest: maps and the verdicts on their pairs in one folder or bucket. Processes that know nothing of each other read and fill
//! it: runs and stations put maps ([`Store::put_map`]), workers ask their pairs ([`work`]), `merge --verdicts` joins what they found.
//!
//! `maps/` holds the maps: each a `map.mcap` in a folder of its own, or a file of another name with `.mcap` behind; those that loopbox puts
//! there are called by their SHA-256. `verdicts/` holds what `merge --verdicts` keeps, under the same names.

#[cfg(feature = "fleet")]
mod sharing;
#[cfg(test)]
mod tests;
mod worker;

#[cfg(feature = "fleet")]
pub(crate) use sharing::Sharing;
pub use worker::{Work, WorkOptions, work};

use crate::blobs::{self, Blobs, Place, local_files, maps_among};
use crate::verdicts::MapDigest;
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The folder of the maps.
const MAPS: &str = "maps/";
/// The folder of the verdicts.
const VERDICTS: &str = "verdicts/";

/// A folder or bucket of maps and verdicts.
#[derive(Clone, Debug)]
pub struct Store {
    /// As people named it.
    place: PathBuf,
    blobs: Arc<dyn Blobs>,
}

impl Store {
    /// The store at a place: a folder, which is made if it is not there, or a bucket by its URI.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn at(place: &Path) -> Result<Self> {
        Ok(Self { place: place.to_owned(), blobs: blobs::open(place)? })
    }

    /// Where it is, for people.
    pub fn address(&self) -> String {
        self.place.display().to_string()
    }

    /// The names of the maps that are there, ascending.
    ///
    /// # Errors
    /// When the store cannot be read.
    fn maps(&self) -> Result<Vec<String>> {
        Ok(maps_among(&self.blobs.list(MAPS)?, MAPS))
    }

    /// The file of a map, which of a bucket is copied once.
    ///
    /// # Errors
    /// When there is none of that name, or it cannot be copied.
    fn file(&self, map: &str, report: &dyn Fn(&str)) -> Result<PathBuf> {
        let place = match Place::of(&self.place)? {
            Place::Local(folder) => return Ok(folder.join(map)),
            Place::Bucket(uri) => format!("{}/{map}", uri.trim_end_matches('/')),
        };
        let files = local_files(&[place.into()], report)?;
        files.into_iter().next().with_context(|| format!("{}: there is no map", self.blobs.address(map)))
    }

    /// Puts a map, under the SHA-256 of its file, where it is not there yet; what it is called by.
    ///
    /// # Errors
    /// When the file cannot be read, or the store not be written.
    pub fn put_map(&self, file: &Path) -> Result<MapDigest> {
        let bytes = fs::read(file).with_context(|| format!("{}: cannot be read", file.display()))?;
        let digest = MapDigest::of_bytes(&bytes);
        let name = format!("{MAPS}{}.mcap", digest.as_str());
        if !self.blobs.has(&name)? {
            self.blobs.put(&name, &bytes)?;
        }
        Ok(digest)
    }

    /// The names of the verdicts that are there, as [`VerdictKey::object`](crate::verdicts::VerdictKey::object) has them.
    ///
    /// # Errors
    /// When the store cannot be read.
    fn verdicts(&self) -> Result<BTreeSet<String>> {
        let names = self.blobs.list(VERDICTS)?;
        Ok(names.iter().filter_map(|name| Some(name.strip_prefix(VERDICTS)?.to_owned())).collect())
    }

    /// Whether a verdict is there.
    ///
    /// # Errors
    /// When the store cannot be read.
    fn has_verdict(&self, name: &str) -> Result<bool> {
        self.blobs.has(&format!("{VERDICTS}{name}"))
    }

    /// A verdict; nothing where there is none of that name.
    ///
    /// # Errors
    /// When the store cannot be read.
    #[cfg(feature = "fleet")]
    fn verdict(&self, name: &str) -> Result<Option<Vec<u8>>> {
        self.blobs.get(&format!("{VERDICTS}{name}"))
    }

    /// Puts a verdict where there is none of that name.
    ///
    /// # Errors
    /// When the store cannot be written.
    fn put_verdict(&self, name: &str, bytes: &[u8]) -> Result<()> {
        self.blobs.put(&format!("{VERDICTS}{name}"), bytes)
    }
}
