//! Verdicts on pairs of maps as values, kept among objects that processes share, or in memory.
//!
//! A verdict depends on its two maps and the parameters alone, not on their order or on what other maps there are. So it is
//! called by the SHA-256 of both maps' files, the parameters and the version of the method ([`VerdictKey`]), any process on any machine may
//! find it, and [`Verdicts`] keeps it for all others. A verdict that is found twice is the same to the byte, and the first stays.

mod key;
#[cfg(test)]
mod tests;

pub use crate::results::digest::MapDigest;
pub use key::VerdictKey;

use crate::blobs::{self, Blobs};
use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The files of inputs, several read at a time.
///
/// # Errors
/// When one cannot be read.
pub(crate) fn digests<'a>(paths: impl Iterator<Item = &'a PathBuf>) -> Result<Vec<MapDigest>> {
    paths.collect::<Vec<_>>().into_par_iter().map(|path| MapDigest::of(path)).collect()
}

/// Verdicts among [`Blobs`]. Several processes may read and fill them at a time; a verdict that is there is not changed.
#[derive(Clone, Debug)]
pub struct Verdicts {
    blobs: Arc<dyn Blobs>,
}

/// A verdict with the maps that it is on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Kept<V> {
    /// The maps in the order that the verdict speaks of.
    pub maps: [MapDigest; 2],
    /// What was decided of them.
    pub verdict: V,
}

impl Verdicts {
    /// Those at a place: a folder, which is made if it is not there, or a bucket by its URI.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn at(place: &Path) -> Result<Self> {
        Ok(Self::among(blobs::open(place)?))
    }

    /// Those among these objects.
    pub fn among(blobs: Arc<dyn Blobs>) -> Self {
        Self { blobs }
    }

    /// The verdict with its maps in the order that it speaks of; nothing where it was not found yet.
    ///
    /// # Errors
    /// When it cannot be read, or is something else.
    pub(crate) fn get<V: DeserializeOwned>(&self, key: &VerdictKey) -> Result<Option<Kept<V>>> {
        let name = key.object();
        let Some(bytes) = self.blobs.get(&name)? else { return Ok(None) };
        let hint = || {
            let address = self.blobs.address(&name);
            format!("{address}: is no verdict on these maps; delete it, and it is found again")
        };
        let kept: Kept<V> = rmp_serde::from_slice(&bytes).with_context(hint)?;
        let mut maps = kept.maps.clone();
        maps.sort();
        if maps != key.maps {
            bail!(hint());
        }
        Ok(Some(kept))
    }

    /// Whether a verdict is kept.
    ///
    /// # Errors
    /// When that cannot be read.
    pub(crate) fn has(&self, key: &VerdictKey) -> Result<bool> {
        self.blobs.has(&key.object())
    }

    /// Keeps that a person said of two maps that both show one place.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(crate) fn confirm(&self, key: &VerdictKey) -> Result<()> {
        let name = key.confirmation();
        if self.blobs.has(&name)? {
            Ok(())
        } else {
            self.blobs.put(&name, b"a person said that both show one place\n")
        }
    }

    /// Whether a person said so.
    ///
    /// # Errors
    /// When that cannot be read.
    pub(crate) fn is_confirmed(&self, key: &VerdictKey) -> Result<bool> {
        self.blobs.has(&key.confirmation())
    }

    /// Keeps a verdict on `maps`, in the order that it speaks of, where there is none of that name.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(crate) fn put<V: Serialize>(
        &self,
        key: &VerdictKey,
        maps: [&MapDigest; 2],
        verdict: &V,
    ) -> Result<()> {
        let name = key.object();
        if self.blobs.has(&name)? {
            return Ok(());
        }
        let kept = Kept { maps: maps.map(MapDigest::clone), verdict };
        let bytes = rmp_serde::to_vec_named(&kept).context("a verdict cannot be written as MessagePack")?;
        self.blobs.put(&name, &bytes)
    }
}

/// Every two of so many inputs, the earlier first: (0, 1), (0, 2), (1, 2), (0, 3), …
pub(crate) fn pairs(inputs: usize) -> impl Iterator<Item = [usize; 2]> {
    (1..inputs).flat_map(|later| (0..later).map(move |earlier| [earlier, later]))
}
