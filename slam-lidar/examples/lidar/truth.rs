//! Ground truth and errors against it.

use crate::Failure;
use geometry::{Se3, umeyama};
use scans::{Folder, FolderOptions};
use std::path::Path;

/// A recording with its truth.
pub struct Recording {
    pub folder: Folder,
    poses: Vec<(f64, Se3)>,
}

impl Recording {
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let text = std::fs::read_to_string(path.join("groundtruth.txt"))?;
        let mut poses = Vec::new();
        for line in text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty()) {
            let values: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
            let [t, x, y, z, qx, qy, qz, qw] = values[..] else { return Err(line.into()) };
            poses.push((t, Se3::from_tum([x, y, z, qx, qy, qz, qw])));
        }
        Ok(Self { folder: Folder::open(path, &FolderOptions::default())?, poses })
    }

    /// The true `world_from_sensor` at an instant; none outside of the truth.
    pub fn at(&self, time: f64) -> Option<Se3> {
        let after = self.poses.partition_point(|(t, _)| *t <= time + 1e-9);
        let (first, last) = (self.poses.first()?, self.poses.last()?);
        if time < first.0 - 0.02 || time > last.0 + 0.02 || self.poses.len() < 2 {
            return (time - first.0).abs().lt(&0.02).then_some(first.1);
        }
        let after = after.clamp(1, self.poses.len() - 1);
        let ((t0, a), (t1, b)) = (self.poses[after - 1], self.poses[after]);
        Some(a * Se3::exp(&((a.inverse() * b).log() * ((time - t0) / (t1 - t0)))))
    }

    /// Estimated and true poses where both are known.
    pub fn pairs(&self, estimate: &[(f64, Se3)]) -> Vec<(Se3, Se3)> {
        estimate.iter().filter_map(|&(time, pose)| Some((pose, self.at(time)?))).collect()
    }
}

/// Root mean square and largest error of positions after rigid alignment, metres.
pub fn ate(pairs: &[(Se3, Se3)]) -> Result<(f64, f64), Failure> {
    let (found, truth): (Vec<_>, Vec<_>) = pairs.iter().map(|(a, b)| (a.translation, b.translation)).unzip();
    let aligned = umeyama::se3(&found, &truth)?;
    let squared: Vec<f64> =
        found.iter().zip(&truth).map(|(f, t)| (aligned * *f - t).norm_squared()).collect();
    let mean = squared.iter().sum::<f64>() / squared.len() as f64;
    Ok((mean.sqrt(), squared.iter().fold(0.0f64, |a, &b| a.max(b)).sqrt()))
}

/// Mean drift over all pieces of 10 m: share of the way, and degrees a metre.
pub fn drift(pairs: &[(Se3, Se3)]) -> (f64, f64) {
    let mut travelled = vec![0.0];
    for step in pairs.windows(2) {
        travelled
            .push(travelled[travelled.len() - 1] + (step[1].1.translation - step[0].1.translation).norm());
    }
    let (mut sum, mut count) = ((0.0, 0.0), 0.0);
    for i in 0..pairs.len() {
        let j = travelled.partition_point(|&d| d < travelled[i] + 10.0);
        let Some(end) = pairs.get(j) else { break };
        let error = (pairs[i].1.inverse() * end.1).inverse() * (pairs[i].0.inverse() * end.0);
        sum.0 += error.translation.norm() / (travelled[j] - travelled[i]);
        sum.1 += error.rotation.angle().to_degrees() / (travelled[j] - travelled[i]);
        count += 1.0;
    }
    (sum.0 / f64::max(count, 1.0), sum.1 / f64::max(count, 1.0))
}

/// Error of the pose after the first `metres` of the way in the frame of the first pose: metres and degrees.
pub fn beginning(pairs: &[(Se3, Se3)], metres: f64) -> Option<(f64, f64)> {
    let first = pairs.first()?;
    let mut travelled = 0.0;
    let reached = |step: &&[(Se3, Se3)]| {
        travelled += (step[1].1.translation - step[0].1.translation).norm();
        travelled >= metres
    };
    let end = pairs.windows(2).find(reached)?[1];
    let error = (first.1.inverse() * end.1).inverse() * (first.0.inverse() * end.0);
    Some((error.translation.norm(), error.rotation.angle().to_degrees()))
}
