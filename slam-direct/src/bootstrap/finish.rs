//! The first map from a good solution: two keyframes, in units of the median depth.

use super::solve::{Solution, agreement, variances_by_rotation};
use super::{Bootstrap, Started};
use crate::local_map::{KeyframeState, LocalMap, PointRef, PointState, SeenAt};
use crate::window::{Problem, WindowPoint};
use geometry::sensor::{Twist, motion};
use geometry::{Pyramid, Se3, median};

/// Largest standard deviation of an inverse depth, relative to it, that makes a point of the map.
const MAX_RELATIVE_SIGMA: f64 = 0.3;

impl Bootstrap {
    /// Makes two keyframes of the solution, in units of the median depth; `pyramid` is the newest frame's.
    pub(super) fn finish(&self, solution: &Solution, pyramid: &Pyramid) -> Started {
        let all = solution;
        let solution = &all.problem;
        let mut depths: Vec<f32> = solution.points.iter().map(|p| p.inverse_depth as f32).collect();
        let unit = median(&mut depths).unwrap_or(1.0) as f64;
        let points = self.points(solution, unit);
        let newest = &self.frames[self.frames.len() - 1];
        let last = solution.frames[solution.frames.len() - 1];
        let camera_from_world = Se3::new(last.rotation, last.translation * unit);
        let mut map = LocalMap::new(self.camera);
        map.push(KeyframeState::new(self.timestamp, self.frame_index, self.first.clone(), Se3::identity()));
        map.push(KeyframeState::new(
            newest.timestamp,
            newest.frame_index,
            pyramid.clone(),
            camera_from_world,
        ));
        let frames = self.pose_all(all, unit);
        map.keyframes[0].motion = between((self.timestamp, Se3::identity()), frames.first());
        if let [.., (time, _, pose), newest] = frames.as_slice() {
            map.keyframes[1].motion = between((*time, *pose), Some(newest));
        }
        map.keyframes[1].seen = (0..points.len()).map(|index| PointRef { host: 0, index }).collect();
        map.keyframes[0].points = points;
        map.set_sensor(all.sensor);
        Started { map, frames }
    }

    /// The points that agree with the solution, are certain, and are seen in its last frame.
    fn points(&self, solution: &Problem, unit: f64) -> Vec<PointState> {
        let squared = solution.squared_residuals();
        let limit = agreement(&squared);
        let by_rotation = variances_by_rotation(solution);
        let is_good = |((point, _), _): &((&WindowPoint, &f64), usize)| {
            let agrees = point.observations.clone().all(|i| squared[i] < limit) && point.inverse_depth > 0.0;
            let relative = 1.0 / (point.information.sqrt() * point.inverse_depth);
            agrees && relative <= MAX_RELATIVE_SIGMA
        };
        let newest = &self.frames[self.frames.len() - 1];
        let state = |((point, by_rotation), track): ((&WindowPoint, &f64), usize)| {
            let (pixel, information) = newest.seen[track]?;
            Some(PointState {
                pixel: self.tracks[track].pixel,
                ray: point.ray,
                inverse_depth: point.inverse_depth / unit,
                variance: 1.0 / (point.information * unit * unit),
                doubt: by_rotation / (unit * unit),
                observations: vec![SeenAt { keyframe: 1, pixel, information }],
                alive: true,
                searched: 0,
                found: 0,
            })
        };
        solution
            .points
            .iter()
            .zip(&by_rotation)
            .zip(self.followed())
            .filter(is_good)
            .filter_map(state)
            .collect()
    }
}

/// The motion from one pose to the next.
fn between((time, pose): (f64, Se3), next: Option<&(f64, u64, Se3)>) -> Twist {
    next.map_or(Twist::zeros(), |(later, _, next)| motion(&pose, next, later - time))
}
