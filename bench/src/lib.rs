//! What the programs that measure loopbox share: documents with measured parts, and what recordings have in common
//! by their true poses.

pub mod document;
pub mod shared;
pub mod views;

use std::path::{Path, PathBuf};

/// The map of a sequence's first run, in the folder of all runs.
pub fn map_of(runs: &Path, sequence: &str) -> PathBuf {
    runs.join(sequence).join("run-1").join("map.mcap")
}

/// The median of numbers, the larger of the two in the middle; `None` without any.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    geometry::median(&mut values)
}

/// Whether two sequences were recorded in one world, which the first part of their names tells.
pub fn share_world(a: &str, b: &str) -> bool {
    let world = |name: &str| name.split('_').next().map(str::to_owned);
    world(a) == world(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_are_recognised_by_names() {
        assert!(share_world("parking_a", "parking_c"));
        assert!(!share_world("parking_a", "tum_fr1_desk"));
    }
}
