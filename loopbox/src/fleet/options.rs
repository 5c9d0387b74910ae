//! How a peer of the fleet is to be.

use fleet::transport::Endpoint;
use std::path::PathBuf;

/// How a peer is to be.
#[derive(Clone, Debug)]
pub struct FleetOptions {
    /// Folder for the results.
    pub out: PathBuf,
    /// Replace results of something else in that folder.
    pub force: bool,
    /// What people call it.
    pub name: String,
    /// Whether it has no map of its own, and is there to collect those of others.
    pub is_station: bool,
    /// Whether a run works beside it, to which it gives way.
    pub in_background: bool,
    /// Where it listens.
    pub listen: Option<Endpoint>,
    /// Whom it dials.
    pub dial: Vec<Endpoint>,
    /// Where a station puts the maps of runs that have ended and the verdicts on them, and takes verdicts that workers found: a folder, which
    /// is made if it is not there, or the URI of a bucket.
    pub store: Option<PathBuf>,
    /// The folder of its keys; without them it reaches nobody beyond this machine.
    pub keys: Option<PathBuf>,
}
