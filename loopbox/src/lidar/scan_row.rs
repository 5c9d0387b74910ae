//! What `run.json` holds of each scan.

use super::mapper::MappedScan;
use serde::Serialize;

/// One scan.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ScanRow {
    /// Index in the recording.
    pub index: u64,
    /// The instant of its pose, seconds.
    pub instant: f64,
    /// Milliseconds the agent took.
    pub ms: f64,
    /// Of its thread's CPU time.
    pub cpu_ms: f64,
    /// Its points.
    pub points: usize,
    /// Share of the points asked that agree with the map.
    pub inlier_share: f64,
    /// Root mean square distance of those from their surfaces, metres.
    pub rmse_m: f64,
    /// Directions of the pose that the points determine badly.
    pub weak: usize,
    /// Directions of the translation that are guessed.
    pub guessed: usize,
    /// Metres since the scan before that are guessed; what was guessed before it came to be said is in the first of a stretch.
    pub guessed_m: f64,
    /// What the pose may err by since the last one that was determined, standard deviation, metres; 0 where nothing is guessed.
    pub guessed_deviation_m: f64,
    /// Whether it became a keyframe.
    pub keyframe: bool,
    /// Whether it closed a loop.
    pub closed: bool,
}

impl ScanRow {
    /// That of a scan which was taken, with the milliseconds by the clock and of the CPU.
    pub fn of(index: u64, points: usize, [ms, cpu_ms]: [f64; 2], taken: &MappedScan) -> Self {
        let sweep = &taken.sweep;
        Self {
            index,
            instant: sweep.instant,
            ms,
            cpu_ms,
            points,
            inlier_share: sweep.inlier_share,
            rmse_m: sweep.rmse,
            weak: sweep.conditioning.weak,
            guessed: sweep.guess.directions,
            guessed_m: sweep.guess.metres,
            guessed_deviation_m: sweep.guess.deviation,
            keyframe: taken.is_keyframe,
            closed: taken.closed.is_some(),
        }
    }
}
