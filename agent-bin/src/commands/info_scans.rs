//! `loopbox info` of a LiDAR's recording.

use super::run_scans::OpenScans;
use crate::console;
use anyhow::Result;

/// Describes it.
///
/// # Errors
/// When it cannot be printed.
pub fn run(mut scans: OpenScans, json: bool) -> Result<()> {
    let outlook = scans.outlook();
    if json { console::print_json(&outlook) } else { console::print(&outlook.to_string()) }
}
