//! Which pose of the estimate belongs to which of the ground truth.

use crate::{EvalError, Pose, Trajectory};
use geometry::Sim3;
use nalgebra::Vector3;

/// Widest time difference of a pair, seconds. Half the spacing of motion-capture data thinned to 50 Hz is
/// 0.01 s; twice that forgives rounded stamps and still never skips to the next frame of a 30 Hz camera.
pub const DEFAULT_MAX_DIFF: f64 = 0.02;

/// Poses that belong together, in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Associated {
    /// Seconds on the clock of the ground truth; `None` when neither file has time stamps.
    pub timestamps: Option<Vec<f64>>,
    /// Estimated poses.
    pub estimate: Vec<Pose>,
    /// Their true poses.
    pub truth: Vec<Pose>,
}

impl Associated {
    /// Number of pairs.
    pub fn len(&self) -> usize {
        self.truth.len()
    }

    /// Whether there is no pair.
    pub fn is_empty(&self) -> bool {
        self.truth.is_empty()
    }

    /// The pairs with the estimate in the frame and unit that `transform` maps to.
    pub fn transformed(&self, transform: &Sim3) -> Self {
        let estimate = self.estimate.iter().map(|pose| pose.transformed(transform)).collect();
        Self { estimate, ..self.clone() }
    }

    /// `(estimated, true)` camera positions.
    pub fn positions(&self) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
        let positions = |poses: &[Pose]| poses.iter().map(|pose| pose.translation).collect();
        (positions(&self.estimate), positions(&self.truth))
    }
}

/// Pairs each pose of the trajectory with fewer poses with the one of the other that is nearest in time,
/// when they differ by at most `max_diff` seconds (the rule of `evo`). Without time stamps in both, poses
/// pair by their order.
pub fn associate(estimate: &Trajectory, truth: &Trajectory, max_diff: f64) -> Result<Associated, EvalError> {
    let (est_times, true_times) = match (&estimate.timestamps, &truth.timestamps) {
        (Some(e), Some(t)) => (e, t),
        (None, None) => return by_order(estimate, truth),
        _ => return Err(EvalError::MixedTimes),
    };
    if !(max_diff.is_finite() && max_diff >= 0.0) {
        return Err(EvalError::Setting(format!("the largest time difference is {max_diff} s: expected ≥ 0")));
    }
    let pairs: Vec<(usize, usize)> = if truth.len() < estimate.len() {
        nearest_pairs(true_times, est_times, max_diff).into_iter().map(|(t, e)| (e, t)).collect()
    } else {
        nearest_pairs(est_times, true_times, max_diff)
    };
    if pairs.is_empty() {
        return Err(EvalError::NoPairs { max_diff, of_truth: true_times.first().copied().unwrap_or(0.0) });
    }
    Ok(Associated {
        timestamps: Some(pairs.iter().map(|&(_, t)| true_times[t]).collect()),
        estimate: pairs.iter().map(|&(e, _)| estimate.world_from_camera[e]).collect(),
        truth: pairs.iter().map(|&(_, t)| truth.world_from_camera[t]).collect(),
    })
}

fn by_order(estimate: &Trajectory, truth: &Trajectory) -> Result<Associated, EvalError> {
    if estimate.len() != truth.len() {
        return Err(EvalError::CountMismatch { estimate: estimate.len(), truth: truth.len() });
    }
    Ok(Associated {
        timestamps: None,
        estimate: estimate.world_from_camera.clone(),
        truth: truth.world_from_camera.clone(),
    })
}

/// For each time of `few`: `(its index, index of the nearest of many)` where they are near enough.
fn nearest_pairs(few: &[f64], many: &[f64], max_diff: f64) -> Vec<(usize, usize)> {
    few.iter()
        .enumerate()
        .filter_map(|(i, &time)| Some((i, nearest(many, time)?)))
        .filter(|&(i, j)| (few[i] - many[j]).abs() <= max_diff)
        .collect()
}

/// Index of the time nearest to `time` in an ascending list, the earlier of two equally near.
pub(crate) fn nearest(times: &[f64], time: f64) -> Option<usize> {
    let after = times.partition_point(|&t| t < time);
    let before = after.checked_sub(1);
    match (before, times.get(after)) {
        (Some(b), Some(&t)) if time - times[b] > t - time => Some(after),
        (Some(b), _) => Some(b),
        (None, Some(_)) => Some(after),
        (None, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Se3;
    use proptest::prelude::*;

    fn trajectory(times: &[f64]) -> Trajectory {
        let pose = |&t: &f64| Se3::from_tum([t, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).into();
        Trajectory { timestamps: Some(times.to_vec()), world_from_camera: times.iter().map(pose).collect() }
    }

    #[test]
    fn each_pose_of_the_shorter_finds_its_nearest() {
        let truth = trajectory(&[0.0, 0.1, 0.2, 0.3, 0.4]);
        let estimate = trajectory(&[0.09, 0.26, 0.405, 0.5]);
        let pairs = associate(&estimate, &truth, 0.02).unwrap();
        assert_eq!(pairs.timestamps, Some(vec![0.1, 0.4]));
        assert_eq!(pairs.estimate[1].translation.x, 0.405);
        let swapped = associate(&truth, &estimate, 0.02).unwrap();
        assert_eq!(swapped.timestamps, Some(vec![0.09, 0.405]));
    }

    #[test]
    fn what_cannot_be_paired_is_refused() {
        let (a, b) = (trajectory(&[0.0, 1.0]), trajectory(&[10.0, 11.0, 12.0]));
        assert!(matches!(associate(&a, &b, 0.1), Err(EvalError::NoPairs { .. })));
        for (times, unit) in [
            ([1.4e18, 1.5e18], "nanoseconds"),
            ([1.4e12, 1.5e12], "milliseconds"),
            ([1.4e15, 1.5e15], "microseconds"),
        ] {
            let text = associate(&a, &trajectory(&times), 0.1).err().map(|error| error.to_string());
            assert!(text.is_some_and(|text| text.contains(unit)), "{unit}");
        }
        assert!(matches!(associate(&a, &b, f64::NAN), Err(EvalError::Setting(_))));
        let bare = |t: &Trajectory| Trajectory { timestamps: None, ..t.clone() };
        assert!(matches!(associate(&bare(&a), &b, 0.1), Err(EvalError::MixedTimes)));
        assert!(matches!(associate(&bare(&a), &bare(&b), 0.1), Err(EvalError::CountMismatch { .. })));
        assert_eq!(associate(&bare(&a), &bare(&a), 0.1).unwrap().len(), 2);
    }

    proptest! {
        #[test]
        fn nearest_is_nearest(mut times in prop::collection::vec(-5.0f64..5.0, 1..20), time in -6.0f64..6.0) {
            times.sort_by(f64::total_cmp);
            let found = nearest(&times, time).unwrap();
            let least = times.iter().map(|t| (t - time).abs()).fold(f64::INFINITY, f64::min);
            prop_assert_eq!((times[found] - time).abs(), least);
        }
    }
}
