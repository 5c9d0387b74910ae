//! Relative pose error.

use crate::associate::nearest;
use crate::{Associated, EvalError, Statistics};
use serde::{Deserialize, Serialize};

/// A pair whose poses are further from the interval than this share of it is left out: the trajectory has
/// a gap there, or ends.
const TIME_TOLERANCE: f64 = 0.2;

/// How far apart the poses of a pair are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Delta {
    /// A number of associated poses, ≥ 1.
    Frames(usize),
    /// Seconds, > 0: from a pose to the one nearest in time to that much later.
    Seconds(f64),
}

/// Drift over a fixed interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rpe {
    /// The interval.
    pub delta: Delta,
    /// Whether pairs overlap (one starts at each pose) or follow each other.
    pub all_pairs: bool,
    /// Length of the translation part, in the unit of the ground truth.
    pub translation: Statistics,
    /// Angle of the rotation part, degrees.
    pub rotation_deg: Statistics,
}

/// Errors `(Qᵢ⁻¹ Qⱼ)⁻¹ (Pᵢ⁻¹ Pⱼ)` of the estimate P against the truth Q over pairs `delta` apart
/// (Sturm 2012, §IV-A); `None` when the trajectory is shorter than `delta`.
///
/// With `all_pairs` a pair starts at every pose, else where the one before ended (the default of `evo`).
pub fn rpe(aligned: &Associated, delta: Delta, all_pairs: bool) -> Result<Option<Rpe>, EvalError> {
    let next = successors(aligned, delta)?;
    let mut pairs = Vec::new();
    let mut i = 0;
    while i < next.len() {
        let Some(j) = next[i] else {
            i += 1;
            continue;
        };
        pairs.push((i, j));
        i = if all_pairs { i + 1 } else { j };
    }
    let mut translation = Vec::with_capacity(pairs.len());
    let mut rotation_deg = Vec::with_capacity(pairs.len());
    for (i, j) in pairs {
        let true_motion = aligned.truth[i].to(&aligned.truth[j]);
        let error = true_motion.to(&aligned.estimate[i].to(&aligned.estimate[j]));
        translation.push(error.translation.norm());
        rotation_deg.push(error.angle_deg());
    }
    let statistics = Statistics::of(&translation).zip(Statistics::of(&rotation_deg));
    Ok(statistics.map(|(translation, rotation_deg)| Rpe { delta, all_pairs, translation, rotation_deg }))
}

/// For each pose the one that ends its pair.
fn successors(aligned: &Associated, delta: Delta) -> Result<Vec<Option<usize>>, EvalError> {
    let n = aligned.len();
    match delta {
        Delta::Frames(0) => Err(EvalError::Setting("the RPE interval is 0 frames: expected ≥ 1".to_owned())),
        Delta::Frames(step) => Ok((0..n).map(|i| i.checked_add(step).filter(|&j| j < n)).collect()),
        Delta::Seconds(seconds) => {
            if !(seconds.is_finite() && seconds > 0.0) {
                return Err(EvalError::Setting(format!("the RPE interval is {seconds} s: expected > 0")));
            }
            let times = aligned.timestamps.as_ref().ok_or_else(|| {
                EvalError::Setting(
                    "an RPE interval in seconds needs time stamps: give it in frames".to_owned(),
                )
            })?;
            let end = |i: usize| {
                let goal = times[i] + seconds;
                nearest(times, goal).filter(|&j| j > i && (times[j] - goal).abs() <= TIME_TOLERANCE * seconds)
            };
            Ok((0..n).map(end).collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;
    use geometry::Se3;
    use nalgebra::Vector6;

    /// The truth moves 1 m a second along x; the estimate turns by `yaw_rate` radians and moves 1 + drift.
    fn pairs(n: usize, drift: f64, yaw_rate: f64) -> Associated {
        let path = |step: Se3| {
            std::iter::successors(Some(Se3::identity()), move |pose| Some(*pose * step))
                .take(n)
                .map(Pose::from)
                .collect()
        };
        Associated {
            timestamps: Some((0..n).map(|i| i as f64).collect()),
            estimate: path(Se3::exp(&Vector6::new(1.0 + drift, 0.0, 0.0, yaw_rate, 0.0, 0.0))),
            truth: path(Se3::exp(&Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))),
        }
    }

    #[test]
    fn constant_drift_is_measured_per_interval() {
        let pairs = pairs(10, 0.01, 0.02);
        for delta in [Delta::Frames(3), Delta::Seconds(3.0)] {
            let consecutive = rpe(&pairs, delta, false).unwrap().unwrap();
            assert_eq!(consecutive.translation.count, 3);
            let all = rpe(&pairs, delta, true).unwrap().unwrap();
            assert_eq!(all.translation.count, 7);
            for result in [consecutive, all] {
                assert!((result.translation.max - 0.03).abs() < 1e-12);
                assert!((result.rotation_deg.mean - 0.06f64.to_degrees()).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn unusable_intervals_are_refused() {
        let mut pairs = pairs(4, 0.0, 0.0);
        assert!(rpe(&pairs, Delta::Frames(0), false).is_err());
        assert!(rpe(&pairs, Delta::Seconds(-1.0), false).is_err());
        assert_eq!(rpe(&pairs, Delta::Frames(4), false).unwrap(), None);
        assert_eq!(rpe(&pairs, Delta::Seconds(100.0), true).unwrap(), None);
        pairs.timestamps = None;
        assert!(rpe(&pairs, Delta::Seconds(1.0), false).is_err());
    }
}
