//! How much of a recording has a pose.

use crate::associate::nearest;
use serde::{Deserialize, Serialize};

/// How many frames of a recording, or poses of a ground truth, have an estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Those with an estimate.
    pub covered: usize,
    /// All.
    pub total: usize,
    /// `covered / total`, 0–1.
    pub share: f64,
}

/// Frames and estimates carry the same stamp; this forgives its rounding, seconds.
pub(crate) const FRAME_TOLERANCE: f64 = 1e-3;

/// Counts the times of `wanted` that have one of `estimated` (both ascending, seconds) within `tolerance`.
pub fn coverage(wanted: &[f64], estimated: &[f64], tolerance: f64) -> Coverage {
    let near =
        |&&time: &&f64| nearest(estimated, time).is_some_and(|i| (estimated[i] - time).abs() <= tolerance);
    let covered = wanted.iter().filter(near).count();
    let share = if wanted.is_empty() { 0.0 } else { covered as f64 / wanted.len() as f64 };
    Coverage { covered, total: wanted.len(), share }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_frames_with_an_estimate() {
        let frames = [0.0, 0.033, 0.067, 0.1];
        let c = coverage(&frames, &[0.0330004, 0.1], 1e-3);
        assert_eq!((c.covered, c.total, c.share), (2, 4, 0.5));
        assert_eq!(coverage(&frames, &[], 1e-3).covered, 0);
    }
}
