//! Verdicts on agents with LiDARs, as they are kept.

use super::input::{Files, Input};
use super::params::LidarMergeParams;
use crate::results::digest::agent_digests;
#[cfg(feature = "fleet")]
use crate::verdicts::pairs;
use crate::verdicts::{Kept, MapDigest, VerdictKey, Verdicts, digests};
use anyhow::Result;
use slam_lidar::merging::verdict::Verdict;
#[cfg(feature = "fleet")]
use std::collections::BTreeSet;
use std::path::Path;

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
    pub fn of(folder: Option<&Path>, inputs: &[Input], params: &'a LidarMergeParams) -> Result<Option<Self>> {
        let Some(folder) = folder else { return Ok(None) };
        let files = Files::of(inputs);
        let maps = agent_digests(&files.agents, &digests(files.paths.iter().copied())?);
        Ok(Some(Self::among(Verdicts::at(folder)?, maps, params)))
    }

    /// Those of maps that are called so, among `kept`.
    pub fn among(kept: Verdicts, maps: Vec<MapDigest>, params: &'a LidarMergeParams) -> Self {
        Self { kept, maps, params }
    }

    /// What the verdicts on all pairs are called, or would be.
    #[cfg(feature = "fleet")]
    pub fn objects(&self) -> BTreeSet<String> {
        pairs(self.maps.len()).map(|pair| self.key(pair).object()).collect()
    }

    /// What the verdict on two inputs is called.
    fn key(&self, pair: [usize; 2]) -> VerdictKey {
        lidar_key(pair.map(|map| &self.maps[map]), self.params)
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
        self.kept.has(&self.key(pair))
    }

    /// What is known of two inputs, which stand in `order`.
    ///
    /// # Errors
    /// When its file cannot be read, or holds something else.
    pub fn get(&self, order: [usize; 2]) -> Result<Option<Verdict>> {
        let kept = self.kept.get(&self.key(order))?;
        Ok(kept.map(|Kept { verdict, .. }| verdict))
    }

    /// Keeps what two inputs made of each other, which stand in `order`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&self, order: [usize; 2], verdict: &Verdict) -> Result<()> {
        let maps = order.map(|map| &self.maps[map]);
        self.kept.put(&self.key(order), maps, verdict)
    }
}

/// What the verdict on two agents with LiDARs is called, in either order.
pub(crate) fn lidar_key(maps: [&MapDigest; 2], params: &LidarMergeParams) -> VerdictKey {
    VerdictKey::of("lidars", maps, params)
}
