//! Poses that are given: a map is built on them, in place of an odometry's.

use anyhow::{Result, bail};
use geometry::Se3;
use slam_lidar::motion::SweepMotion;

/// How far beyond the first and the last pose a scan may be, seconds: stamps are rounded.
const MARGIN: f64 = 0.02;

/// `world_from_sensor` over time; in between, the sensor moves with a constant twist.
#[derive(Clone, Debug)]
pub struct GivenPoses(Vec<(f64, Se3)>);

impl GivenPoses {
    /// Poses by their times, seconds.
    ///
    /// # Errors
    /// Without poses, or when times do not ascend or a pose is not finite.
    pub fn new(poses: Vec<(f64, Se3)>) -> Result<Self> {
        if poses.is_empty() {
            bail!("there are no poses");
        }
        if let Some((time, _)) = poses.iter().find(|(time, pose)| !(time.is_finite() && pose.is_finite())) {
            bail!("the pose at {time} is not finite");
        }
        match poses.windows(2).find(|pair| pair[1].0 <= pair[0].0) {
            Some(pair) => bail!("time {} does not come after {}", pair[1].0, pair[0].0),
            None => Ok(Self(poses)),
        }
    }

    /// The pose at a time; `None` outside of the poses.
    pub fn at(&self, time: f64) -> Option<Se3> {
        let (first, last) = (self.0.first()?, self.0.last()?);
        if !(first.0 - MARGIN..=last.0 + MARGIN).contains(&time) {
            return None;
        }
        let after = self.0.partition_point(|(t, _)| *t <= time).min(self.0.len() - 1).max(1);
        let (Some((t0, a)), Some((t1, b))) = (self.0.get(after - 1), self.0.get(after)) else {
            return Some(first.1);
        };
        Some(*a * Se3::exp(&((a.inverse() * *b).log() * ((time - t0) / (t1 - t0)))))
    }

    /// The pose at a time between two that are at most `max_gap` seconds apart.
    pub fn between(&self, time: f64, max_gap: f64) -> Option<Se3> {
        let [first, last] = self.span();
        if !(first..=last).contains(&time) {
            return None;
        }
        let after = self.0.partition_point(|(t, _)| *t < time);
        let gap = after.checked_sub(1).map_or(0.0, |before| self.0[after].0 - self.0[before].0);
        self.at(time).filter(|_| gap <= max_gap)
    }

    /// The times of the first and the last pose.
    pub fn span(&self) -> [f64; 2] {
        // There is one at least.
        [self.0.first(), self.0.last()].map(|end| end.map_or(0.0, |(time, _)| *time))
    }

    /// The motion of a sweep between two instants. At the ends of the poses, where only a part of the sweep is
    /// known, the sensor rests at `stamp`; `None` where that has no pose either.
    pub fn motion(&self, instants: (f64, f64), stamp: f64) -> Option<SweepMotion> {
        match (self.at(instants.0), self.at(instants.1)) {
            (Some(begin), Some(end)) => Some(SweepMotion { begin, end }),
            _ => self.at(stamp).map(SweepMotion::resting),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    fn at(x: f64) -> Se3 {
        Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0))
    }

    #[test]
    fn poses_are_interpolated_within_and_unknown_outside() {
        let poses = GivenPoses::new(vec![(1.0, at(0.0)), (2.0, at(4.0))]).unwrap();
        for (time, x) in [(1.0, 0.0), (1.25, 1.0), (2.0, 4.0), (2.01, 4.04)] {
            assert!((poses.at(time).unwrap().translation.x - x).abs() < 1e-9, "{time}");
        }
        assert!(poses.at(0.9).is_none() && poses.at(2.1).is_none());
        let motion = poses.motion((1.95, 2.05), 2.0).unwrap();
        assert!((motion.displacement().translation.x).abs() < 1e-9, "the sweep ends after the poses");
        assert!(poses.motion((1.5, 1.6), 1.5).unwrap().displacement().translation.x > 0.39);
        assert_eq!(poses.between(1.25, 1.0).unwrap().translation.x, 1.0);
        assert!(poses.between(1.25, 0.9).is_none() && poses.between(2.01, 1.0).is_none());
        assert!(poses.between(1.0, 0.0).is_some(), "a pose that is there needs no other");
        let one = GivenPoses::new(vec![(1.0, at(3.0))]).unwrap();
        assert_eq!(one.at(1.0).unwrap().translation.x, 3.0);
    }

    #[test]
    fn what_is_no_trajectory_is_refused() {
        assert!(GivenPoses::new(Vec::new()).is_err());
        assert!(GivenPoses::new(vec![(1.0, at(0.0)), (1.0, at(1.0))]).is_err());
        assert!(GivenPoses::new(vec![(1.0, at(f64::NAN))]).is_err());
    }
}
