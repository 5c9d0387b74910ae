//! The true way of a sensor, and how far an estimate is from it.

use anyhow::{Context, Result};
use eval::{AlignMode, Associated, Pose, Trajectory, align, ate, read_trajectory};
use geometry::Se3;
use std::path::Path;

/// Poses are asked for at most so long before or after the truth that is known, seconds: half a sweep, for the last
/// sweep's end.
const BEYOND: f64 = 0.06;
/// Length of the pieces over which drift is taken, metres.
const PIECE: f64 = 10.0;

/// A recording's truth.
pub struct Truth {
    times: Vec<f64>,
    poses: Vec<Se3>,
}

/// How far an estimate is from the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Root mean square distance after rigid alignment, metres.
    pub ate: f64,
    /// Largest of them.
    pub most: f64,
    /// Mean error over all pieces of 10 m, percent of the way.
    pub drift: f64,
    /// The same of the rotation, degrees a metre.
    pub rotation_drift: f64,
}

impl Truth {
    /// That of a folder of scans.
    ///
    /// # Errors
    /// When it cannot be read or has no times.
    pub fn of(folder: &Path) -> Result<Self> {
        let path = folder.join("groundtruth.txt");
        let (times, poses) = timed(&path)?;
        Ok(Self { times, poses: poses.iter().map(Pose::rigid).collect() })
    }

    /// The pose at an instant, `world_from_sensor`: between known ones on the screw from one to the next.
    pub fn at(&self, time: f64) -> Option<Se3> {
        let (first, last) = (self.times.first()?, self.times.last()?);
        if time < first - BEYOND || time > last + BEYOND || self.times.len() < 2 {
            return None;
        }
        let after = self.times.partition_point(|t| *t <= time).clamp(1, self.times.len() - 1);
        let (t, s) = (self.times[after - 1], self.times[after]);
        let (a, b) = (self.poses[after - 1], self.poses[after]);
        Some(a * Se3::exp(&((a.inverse() * b).log() * ((time - t) / (s - t)))))
    }

    /// The errors of an estimated trajectory in a file, each pose compared with the truth at its own instant.
    ///
    /// # Errors
    /// When the file cannot be read, has no times or too few poses.
    pub fn errors(&self, estimate: &Path) -> Result<Errors> {
        let (times, poses) = timed(estimate)?;
        let known =
            times.iter().zip(poses).filter_map(|(&time, pose)| Some((time, pose, self.at(time)?.into())));
        let (mut timestamps, mut pairs) = (Vec::new(), (Vec::new(), Vec::new()));
        for (time, pose, truth) in known {
            timestamps.push(time);
            pairs.0.push(pose);
            pairs.1.push(truth);
        }
        let pairs = Associated { timestamps: Some(timestamps), estimate: pairs.0, truth: pairs.1 };
        let aligned =
            align(&pairs, AlignMode::Se3).with_context(|| format!("{}: no error", estimate.display()))?.1;
        let found = ate(&aligned).with_context(|| format!("{}: no pose to compare", estimate.display()))?;
        let (drift, rotation_drift) = drift(&aligned);
        Ok(Errors { ate: found.rmse, most: found.max, drift, rotation_drift })
    }
}

fn timed(path: &Path) -> Result<(Vec<f64>, Vec<Pose>)> {
    let Trajectory { timestamps, world_from_camera } = read_trajectory(path)?;
    Ok((timestamps.with_context(|| format!("{}: has no times", path.display()))?, world_from_camera))
}

/// Mean error over all pieces of [`PIECE`]: percent of the way, and degrees a metre.
fn drift(pairs: &Associated) -> (f64, f64) {
    let mut travelled = vec![0.0];
    for step in pairs.truth.windows(2) {
        travelled.push(travelled[travelled.len() - 1] + (step[1].translation - step[0].translation).norm());
    }
    let (mut sum, mut count) = ((0.0, 0.0), 0.0);
    for begin in 0..pairs.len() {
        let end = travelled.partition_point(|&along| along < travelled[begin] + PIECE);
        if end == pairs.len() {
            break;
        }
        let [found, truth] = [&pairs.estimate, &pairs.truth].map(|poses| poses[begin].to(&poses[end]));
        let (error, length) = (truth.to(&found), travelled[end] - travelled[begin]);
        sum.0 += 100.0 * error.translation.norm() / length;
        sum.1 += error.angle_deg() / length;
        count += 1.0;
    }
    (sum.0 / f64::max(count, 1.0), sum.1 / f64::max(count, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Se3;
    use nalgebra::{UnitQuaternion, Vector3};
    use std::fmt::Write;

    fn line(text: &mut String, time: f64, pose: Se3) {
        let numbers = pose.to_tum().map(|v| format!("{v:.9}")).join(" ");
        writeln!(text, "{time:.3} {numbers}").unwrap();
    }

    #[test]
    fn an_estimate_that_is_a_percent_too_long_drifts_by_a_percent() {
        // Nearly straight, for a line leaves the rotation open.
        let place = |step: f64| Vector3::new(step, 0.3 * (step / 4.0).sin(), 0.0);
        let at = |place: Vector3<f64>| Se3::new(UnitQuaternion::identity(), place);
        let (mut truth, mut estimate) = (String::new(), String::new());
        for step in 0..41 {
            let step = f64::from(step);
            line(&mut truth, step, at(place(step)));
            // Half a second later than the truth's instants.
            line(&mut estimate, step + 0.5, at(1.01 * 0.5 * (place(step) + place(step + 1.0))));
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("groundtruth.txt"), truth).unwrap();
        std::fs::write(folder.path().join("estimate.txt"), estimate).unwrap();
        let found = Truth::of(folder.path()).unwrap().errors(&folder.path().join("estimate.txt")).unwrap();
        // Of the way, which is a little longer than what it leads to.
        assert!((found.drift - 1.0).abs() < 5e-3 && found.rotation_drift < 1e-6, "{found:?}");
        // After alignment the ends are 1 % of half of the way off.
        assert!((found.most - 0.195).abs() < 2e-3 && found.ate < found.most, "{found:?}");
    }
}
