//! Errors over segments of a path, as the KITTI odometry benchmark measures them.

use crate::Associated;
use serde::{Deserialize, Serialize};

/// Every how many poses a segment starts (KITTI: 10).
const START_STEP: usize = 10;
/// Segment lengths are one to eight times a unit (KITTI: 100 m to 800 m).
const LENGTHS: usize = 8;
/// The path must hold this many units, so that more than the shortest lengths are measured.
const LEAST_UNITS: f64 = 4.0;

/// Mean errors of all segments of one length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LengthError {
    /// Length along the true path, in its unit (metres).
    pub length: f64,
    /// How many segments of this length there are.
    pub count: usize,
    /// Translation error as a share of the length, percent.
    pub translation_percent: f64,
    /// Rotation error, degrees per metre.
    pub rotation_deg_per_m: f64,
}

/// Segment errors by length and over all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SegmentErrors {
    /// Mean over all segments, percent.
    pub translation_percent: f64,
    /// Mean over all segments, degrees per metre.
    pub rotation_deg_per_m: f64,
    /// By length, ascending; lengths without a segment are left out.
    pub lengths: Vec<LengthError>,
}

/// Translation and rotation error over segments of 100, 200, … 800 m of the true path, one starting at every
/// tenth pose (Geiger 2012). On paths below 400 m the unit of 100 m steps down through 50, 20, 10, … until
/// the path holds four of them. `None` when the path is too short for a segment of 0.1 m.
pub fn segment_errors(aligned: &Associated) -> Option<SegmentErrors> {
    let along = path_lengths(aligned);
    let unit = length_unit(*along.last()?)?;
    let mut all = Vec::new();
    let mut lengths = Vec::new();
    for multiple in 1..=LENGTHS {
        let length = unit * multiple as f64;
        let errors: Vec<(f64, f64)> = (0..aligned.len())
            .step_by(START_STEP)
            .filter_map(|first| {
                let last = first + along[first..].iter().position(|&d| d > along[first] + length)?;
                Some(segment_error(aligned, first, last, length))
            })
            .collect();
        if let Some((translation_percent, rotation_deg_per_m)) = mean(&errors) {
            let count = errors.len();
            lengths.push(LengthError { length, count, translation_percent, rotation_deg_per_m });
        }
        all.extend(errors);
    }
    let (translation_percent, rotation_deg_per_m) = mean(&all)?;
    Some(SegmentErrors { translation_percent, rotation_deg_per_m, lengths })
}

/// Distance travelled along the true path up to each pose.
fn path_lengths(aligned: &Associated) -> Vec<f64> {
    let mut sum = 0.0;
    let mut last = aligned.truth.first().map(|pose| pose.translation);
    aligned
        .truth
        .iter()
        .map(|pose| {
            sum += last.replace(pose.translation).map_or(0.0, |from| (pose.translation - from).norm());
            sum
        })
        .collect()
}

fn length_unit(path: f64) -> Option<f64> {
    const UNITS: [f64; 10] = [100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1];
    UNITS.into_iter().find(|unit| path >= LEAST_UNITS * unit)
}

/// `(percent, degrees per metre)` from pose `first` to `last`.
fn segment_error(aligned: &Associated, first: usize, last: usize, length: f64) -> (f64, f64) {
    let est_motion = aligned.estimate[first].to(&aligned.estimate[last]);
    let error = est_motion.to(&aligned.truth[first].to(&aligned.truth[last]));
    (100.0 * error.translation.norm() / length, error.angle_deg() / length)
}

fn mean(errors: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = errors.len() as f64;
    let (t, r) = errors.iter().fold((0.0, 0.0), |(t, r), e| (t + e.0, r + e.1));
    (!errors.is_empty()).then(|| (t / n, r / n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Se3;

    fn straight(n: usize, step: f64, scale: f64) -> Associated {
        let path = |step: f64| {
            (0..n).map(|i| Se3::from_tum([0.0, 0.0, step * i as f64, 0.0, 0.0, 0.0, 1.0]).into()).collect()
        };
        Associated { timestamps: None, estimate: path(step * scale), truth: path(step) }
    }

    #[test]
    fn a_scale_error_is_its_percentage() {
        // 1000 m at 1 m a frame: a segment ends at the first pose beyond its length, so 100 m spans 101.
        let errors = segment_errors(&straight(1001, 1.0, 1.02)).unwrap();
        assert_eq!(errors.lengths.len(), 8);
        let first = errors.lengths[0];
        assert_eq!((first.length, first.count), (100.0, 90));
        assert!((first.translation_percent - 2.02).abs() < 1e-9, "{first:?}");
        assert!(errors.rotation_deg_per_m.abs() < 1e-12);
    }

    #[test]
    fn short_paths_have_short_segments() {
        let lengths = |n, step| -> Vec<f64> {
            let errors = segment_errors(&straight(n, step, 1.0)).unwrap();
            errors.lengths.iter().map(|l| l.length).collect()
        };
        assert_eq!(lengths(202, 0.7), [20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0]);
        assert_eq!(lengths(333, 0.121), [10.0, 20.0, 30.0, 40.0]);
        assert_eq!(segment_errors(&straight(3, 0.001, 1.0)), None);
    }
}
