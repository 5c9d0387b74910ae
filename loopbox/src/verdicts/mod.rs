//! Verdicts on pairs of maps as values, kept among objects that processes share, or in memory.
//!
//! A verdict depends on its two maps and the parameters alone, not on their order or on what other maps there are. So it is
//! called by the SHA-256 of both maps' files, the parameters and the version of the method ([`VerdictKey`]), any process on any machine may
//! find it, and [`Verdicts`] keeps it for all others. A verdict that is found twice is the same to the byte, and the first stays.

#[cfg(feature = "fleet")]
pub(crate) mod check;
pub(crate) mod digest;
mod find;
mod key;
#[cfg(test)]
mod tests;

pub use digest::MapDigest;
pub use find::{ProposedPair, VerdictOptions, VerdictReport, find_verdict, listed_pairs, propose_pairs};
pub use key::VerdictKey;

use crate::blobs::{self, Blobs};
use crate::lidar::merging::input::{self as lidar, Files};
use crate::lidar::merging::params::LidarMergeParams;
use crate::merging::input::Input;
use crate::merging::pair_result::{PairResult, Seconds};
use crate::merging::params::MergingParams;
use anyhow::{Context, Result, bail};
use digest::agent_digests;
use merge::further::Joined;
use merge::verification::TestedPlace;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
#[cfg(feature = "fleet")]
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The files of inputs, several read at a time.
///
/// # Errors
/// When one cannot be read.
fn digests<'a>(paths: impl Iterator<Item = &'a PathBuf>) -> Result<Vec<MapDigest>> {
    paths.collect::<Vec<_>>().into_par_iter().map(|path| MapDigest::of(path)).collect()
}

/// Verdicts among [`Blobs`]. Several processes may read and fill them at a time; a verdict that is there is not changed.
#[derive(Clone, Debug)]
pub struct Verdicts {
    blobs: Arc<dyn Blobs>,
}

/// A verdict with the maps that it is on.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Kept<V> {
    /// The maps in the order that the verdict speaks of.
    maps: [MapDigest; 2],
    verdict: V,
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
    fn get<V: DeserializeOwned>(&self, key: &VerdictKey) -> Result<Option<Kept<V>>> {
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

    /// Keeps that a person said of two maps that both show one place.
    ///
    /// # Errors
    /// When it cannot be written.
    fn confirm(&self, key: &VerdictKey) -> Result<()> {
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
    fn is_confirmed(&self, key: &VerdictKey) -> Result<bool> {
        self.blobs.has(&key.confirmation())
    }

    /// Keeps a verdict on `maps`, in the order that it speaks of, where there is none of that name.
    ///
    /// # Errors
    /// When it cannot be written.
    fn put<V: Serialize>(&self, key: &VerdictKey, maps: [&MapDigest; 2], verdict: &V) -> Result<()> {
        let name = key.object();
        if self.blobs.has(&name)? {
            return Ok(());
        }
        let kept = Kept { maps: maps.map(MapDigest::clone), verdict };
        let bytes = rmp_serde::to_vec_named(&kept).context("a verdict cannot be written as MessagePack")?;
        self.blobs.put(&name, &bytes)
    }
}

/// What two maps of cameras made of each other, whatever their places among others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct OfCameras {
    proposed: usize,
    #[serde(rename = "tried")]
    tested: Vec<TestedPlace>,
    joined: Option<Joined>,
    error: Option<String>,
}

/// Verdicts on maps of cameras, by their places among the inputs.
pub(crate) struct CameraVerdicts<'a> {
    kept: Verdicts,
    /// The inputs' files.
    maps: Vec<MapDigest>,
    params: &'a MergingParams,
}

impl<'a> CameraVerdicts<'a> {
    /// Those of `inputs` in `folder`, where one is named.
    ///
    /// # Errors
    /// When the folder cannot be made, or a map's file not be read.
    pub fn of(folder: Option<&Path>, inputs: &[Input], params: &'a MergingParams) -> Result<Option<Self>> {
        let Some(folder) = folder else { return Ok(None) };
        let (kept, maps) = (Verdicts::at(folder)?, digests(inputs.iter().map(|input| &input.path))?);
        Ok(Some(Self { kept, maps, params }))
    }

    /// Those of maps that are called so, at a place.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn at(place: &Path, maps: Vec<MapDigest>, params: &'a MergingParams) -> Result<Self> {
        Ok(Self { kept: Verdicts::at(place)?, maps, params })
    }

    /// What the verdict on two inputs is called.
    pub fn key(&self, pair: [usize; 2]) -> VerdictKey {
        VerdictKey::of_cameras(pair.map(|map| &self.maps[map]), self.params)
    }

    /// What is known of two inputs.
    ///
    /// # Errors
    /// When its file cannot be read, or holds something else.
    pub fn get(&self, [a, b]: [usize; 2]) -> Result<Option<PairResult>> {
        let kept = self.kept.get::<OfCameras>(&self.key([a, b]))?;
        Ok(kept.map(|Kept { maps, verdict }| {
            let [target, source] = if maps[0] == self.maps[a] { [a, b] } else { [b, a] };
            let OfCameras { proposed, tested, joined, error } = verdict;
            let (tested, joined) = (tested.into(), joined.map(Arc::new));
            PairResult {
                target,
                source,
                proposed,
                tested,
                joined,
                error,
                seconds: Seconds::default(),
                seen: None,
            }
        }))
    }

    /// Keeps that a person said of two inputs that both show one place.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn confirm(&self, pair: [usize; 2]) -> Result<()> {
        self.kept.confirm(&self.key(pair))
    }

    /// Whether a person said so.
    ///
    /// # Errors
    /// When that cannot be read.
    pub fn is_confirmed(&self, pair: [usize; 2]) -> Result<bool> {
        self.kept.is_confirmed(&self.key(pair))
    }

    /// Keeps what two inputs made of each other.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&self, pair_result: &PairResult) -> Result<()> {
        let maps = [pair_result.target, pair_result.source].map(|input| &self.maps[input]);
        let verdict = OfCameras {
            proposed: pair_result.proposed,
            tested: pair_result.tested.to_vec(),
            joined: pair_result.joined.as_deref().cloned(),
            error: pair_result.error.clone(),
        };
        self.kept.put(&self.key([pair_result.target, pair_result.source]), maps, &verdict)
    }
}

/// Verdicts on agents with LiDARs, by their places among the inputs.
pub(crate) struct LidarVerdicts<'a> {
    kept: Verdicts,
    /// The inputs' files and agents.
    maps: Vec<MapDigest>,
    params: &'a LidarMergeParams,
}

impl<'a> LidarVerdicts<'a> {
    /// Those of `inputs` in `folder`, where one is named.
    ///
    /// # Errors
    /// When the folder cannot be made, or a map's file not be read.
    pub fn of(
        folder: Option<&Path>,
        inputs: &[lidar::Input],
        params: &'a LidarMergeParams,
    ) -> Result<Option<Self>> {
        let Some(folder) = folder else { return Ok(None) };
        let files = Files::of(inputs);
        let maps = agent_digests(&files.agents, &digests(files.paths.iter().copied())?);
        Ok(Some(Self::at(folder, maps, params)?))
    }

    /// Those of maps that are called so, at a place.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn at(place: &Path, maps: Vec<MapDigest>, params: &'a LidarMergeParams) -> Result<Self> {
        Ok(Self { kept: Verdicts::at(place)?, maps, params })
    }

    /// Those of maps that are called so, among `kept`.
    #[cfg(feature = "fleet")]
    pub fn among(kept: Verdicts, maps: Vec<MapDigest>, params: &'a LidarMergeParams) -> Self {
        Self { kept, maps, params }
    }

    /// What the verdicts on all pairs are called, or would be.
    #[cfg(feature = "fleet")]
    pub fn objects(&self) -> BTreeSet<String> {
        crate::merging::pair_result::pairs(self.maps.len()).map(|pair| self.key(pair).object()).collect()
    }

    /// What the verdict on two inputs is called.
    fn key(&self, pair: [usize; 2]) -> VerdictKey {
        VerdictKey::of_lidars(pair.map(|map| &self.maps[map]), self.params)
    }

    /// Keeps that a person said of two inputs, which stand in `order`, that both show one place.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn confirm(&self, order: [usize; 2]) -> Result<()> {
        self.kept.confirm(&self.key(order))
    }

    /// Whether a person said so.
    ///
    /// # Errors
    /// When that cannot be read.
    pub fn is_confirmed(&self, order: [usize; 2]) -> Result<bool> {
        self.kept.is_confirmed(&self.key(order))
    }

    /// Whether anything is known of two inputs.
    ///
    /// # Errors
    /// When that cannot be read.
    pub fn has(&self, pair: [usize; 2]) -> Result<bool> {
        self.kept.blobs.has(&self.key(pair).object())
    }

    /// What is known of two inputs, which stand in `order`.
    ///
    /// # Errors
    /// When its file cannot be read, or holds something else.
    pub fn get(&self, order: [usize; 2]) -> Result<Option<slam_lidar::merging::verdict::Verdict>> {
        let kept = self.kept.get(&self.key(order))?;
        Ok(kept.map(|Kept { verdict, .. }| verdict))
    }

    /// Keeps what two inputs made of each other, which stand in `order`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&self, order: [usize; 2], verdict: &slam_lidar::merging::verdict::Verdict) -> Result<()> {
        let maps = order.map(|map| &self.maps[map]);
        self.kept.put(&self.key(order), maps, verdict)
    }
}
