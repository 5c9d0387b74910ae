//! Verdicts on maps of cameras, as they are kept.

use super::input::Input;
use super::pair_result::{PairResult, Seconds};
use super::params::MergingParams;
use crate::verdicts::{Kept, MapDigest, VerdictKey, Verdicts, digests};
use anyhow::Result;
use merge::further::Joined;
use merge::verification::TestedPlace;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;

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
        Ok(Some(Self::among(kept, maps, params)))
    }

    /// Those of maps that are called so, among `kept`.
    pub fn among(kept: Verdicts, maps: Vec<MapDigest>, params: &'a MergingParams) -> Self {
        Self { kept, maps, params }
    }

    /// What the verdict on two inputs is called.
    pub fn key(&self, pair: [usize; 2]) -> VerdictKey {
        camera_key(pair.map(|map| &self.maps[map]), self.params)
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

/// What the verdict on two maps of cameras is called, in either order.
pub(crate) fn camera_key(maps: [&MapDigest; 2], params: &MergingParams) -> VerdictKey {
    let MergingParams { places, rank, key_points, verification, method, baseline, further, .. } = params;
    VerdictKey::of("cameras", maps, &(places, rank, key_points, verification, method, baseline, further))
}

/// Whether these bytes are the verdict on two maps of cameras that the key names.
#[cfg(feature = "fleet")]
pub(crate) fn is_camera_verdict(key: &VerdictKey, bytes: &[u8]) -> bool {
    let Ok(Kept { mut maps, .. }) = rmp_serde::from_slice::<Kept<OfCameras>>(bytes) else { return false };
    maps.sort();
    maps == key.maps
}

/// The verdict on two maps that have nothing in common.
#[cfg(all(test, feature = "fleet"))]
pub(crate) fn refused_camera_verdict(key: &VerdictKey) -> Vec<u8> {
    let verdict = OfCameras { proposed: 0, tested: Vec::new(), joined: None, error: None };
    rmp_serde::to_vec_named(&Kept { maps: key.maps.clone(), verdict }).expect("numbers and texts")
}
