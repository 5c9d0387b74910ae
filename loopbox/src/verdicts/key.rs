//! What verdicts are called by.

use crate::results::digest::{MapDigest, hex};
use serde::Serialize;
use sha2::{Digest, Sha256};

/// Goes up with every change of what comes of two maps: verdicts of other versions are not taken for this one's.
const METHOD_VERSION: u32 = 10;
const EXTENSION: &str = "verdict";

/// What a verdict is called by: both maps, the parameters and the version of the method.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct VerdictKey {
    name: String,
    /// Ascending.
    pub(crate) maps: [MapDigest; 2],
}

impl VerdictKey {
    /// That of two maps in either order, of these `sensors`, by what of the parameters a verdict depends on.
    pub(crate) fn of(sensors: &str, maps: [&MapDigest; 2], params: &impl Serialize) -> Self {
        let mut maps = maps.map(MapDigest::clone);
        maps.sort();
        let params = serde_json::to_string(params).expect("parameters are numbers, names and lists of these");
        let version = env!("CARGO_PKG_VERSION");
        let [first, second] = [maps[0].as_str(), maps[1].as_str()];
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
