//! What verdicts are called by.

use crate::lidar::merging::LidarMergeParams;
use crate::merging::MergingParams;
use crate::open::map_file_at;
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io;
use std::path::Path;

/// Goes up with every change of what comes of two maps: verdicts of other versions are not taken for this one's.
const METHOD_VERSION: u32 = 9;
const EXTENSION: &str = "verdict";

/// The SHA-256 of a map's file, in hexadecimal; of one agent of several in it, with `#` and its number.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MapDigest(String);

impl MapDigest {
    /// That of the map at `path`, a map file or the folder of results that holds one.
    ///
    /// # Errors
    /// When there is no map, or it cannot be read.
    pub fn of(path: &Path) -> Result<Self> {
        let (file, _) = map_file_at(path)?;
        let mut digest = Sha256::new();
        let mut copied = || io::copy(&mut File::open(&file)?, &mut digest);
        copied().with_context(|| format!("{}: cannot be read", file.display()))?;
        Ok(Self(hex(&digest.finalize())))
    }

    /// That of a map's file that holds these bytes.
    pub(crate) fn of_bytes(bytes: &[u8]) -> Self {
        Self(hex(&Sha256::digest(bytes)))
    }

    /// That of a map that is in no file, by the hash of what it holds.
    #[cfg(feature = "fleet")]
    pub(crate) fn of_content(hash: &impl ToString) -> Self {
        Self(hash.to_string())
    }

    /// That of one of the file's agents.
    pub(crate) fn of_agent(&self, number: usize) -> Self {
        Self(format!("{}#{number}", self.0))
    }

    /// In hexadecimal.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// What a verdict is called by: both maps, the parameters and the version of the method.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct VerdictKey {
    name: String,
    /// Ascending.
    pub(super) maps: [MapDigest; 2],
}

impl VerdictKey {
    /// That of two maps of cameras, in either order.
    pub fn of_cameras(maps: [&MapDigest; 2], params: &MergingParams) -> Self {
        let MergingParams { places, rank, key_points, verification, method, baseline, further, .. } = params;
        Self::new("cameras", maps, &(places, rank, key_points, verification, method, baseline, further))
    }

    /// That of two agents with LiDARs, in either order.
    pub fn of_lidars(maps: [&MapDigest; 2], params: &LidarMergeParams) -> Self {
        Self::new("lidars", maps, params)
    }

    fn new(sensors: &str, maps: [&MapDigest; 2], params: &impl Serialize) -> Self {
        let mut maps = maps.map(MapDigest::clone);
        maps.sort();
        let params = serde_json::to_string(params).expect("parameters are numbers, names and lists of these");
        let version = env!("CARGO_PKG_VERSION");
        let [first, second] = [&maps[0].0, &maps[1].0];
        let text =
            format!("loopbox verdict {METHOD_VERSION} {version}\n{sensors}\n{first}\n{second}\n{params}\n");
        Self { name: hex(&Sha256::digest(text)), maps }
    }

    /// The name of the verdict among [`Blobs`](crate::blobs::Blobs).
    pub fn object(&self) -> String {
        format!("{}.{EXTENSION}", self.name)
    }

    /// The name of what is there where a person confirmed that both maps show one place.
    pub(super) fn confirmation(&self) -> String {
        format!("{}.confirmed", self.name)
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
