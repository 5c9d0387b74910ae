//! What maps are called by in verdicts and manifests.

use super::map_file_at;
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io;
use std::path::Path;

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

/// What agents are called by whose files have these digests, by the number of each's file and its own in that.
pub(crate) fn agent_digests(agents: &[(usize, usize)], files: &[MapDigest]) -> Vec<MapDigest> {
    let is_alone = |file: usize| agents.iter().filter(|(other, _)| *other == file).count() == 1;
    let digest = |&(file, agent): &(usize, usize)| {
        if is_alone(file) { files[file].clone() } else { files[file].of_agent(agent) }
    };
    agents.iter().map(digest).collect()
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
