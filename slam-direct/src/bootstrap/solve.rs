//! Poses and depths from the followed points, and whether a map can be built on them.

use super::{Bootstrap, BootstrapParams, MIN_POINTS};
use crate::window::{
    Calibration, DistortedPixel, OTHER_SHUTTER, Pairs, PoseSolver, Problem, SeenPoint, WindowObservation,
    WindowPoint, least_variance_by_rotation, solve, weigh_sensor,
};
use geometry::Se3;
use geometry::median;
use geometry::sensor::{Sensor, Twist, UNKNOWNS, motion};
use nalgebra::{Vector3, Vector6};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Steps of the optimisation at most.
const MAX_ITERATIONS: usize = 40;

/// Longest readout time of a rolling shutter, seconds: sensors take 5 to 35 milliseconds, and never longer than to the next frame.
const LONGEST_READOUT: f64 = 0.035;

/// A local minimum of the cost.
pub(super) struct Solution {
    pub cost: f64,
    pub problem: Problem,
    /// The sensor by which the problem's rays and pixels are.
    pub sensor: Sensor,
}

impl Solution {
    /// Poses of the chosen frames.
    fn poses(&self) -> Vec<Se3> {
        self.problem.frames[1..].to_vec()
    }
}

impl Bootstrap {
    /// The rotation that explains the newest frame best, and the median way that it leaves.
    pub(super) fn parallax(&mut self) -> (Se3, f32) {
        let newest = self.frames.len() - 1;
        let before = self.frames[..newest].last().map_or(Se3::identity(), |frame| frame.pure_rotation);
        self.frames[newest].pure_rotation = before;
        let mut problem = self.problem(&[newest], &[Se3::identity()], 0.0, &self.sensor);
        let pure_rotation = fit_pose(&problem, 15, true);
        self.frames[newest].pure_rotation = pure_rotation;
        problem.frames[1] = pure_rotation;
        let mut left: Vec<f32> = problem
            .observations
            .iter()
            .zip(&problem.points)
            .map(|(seen, point)| {
                let pixel = self.camera.project(&(pure_rotation.rotation * point.ray));
                (pixel.x - seen.pixel[0]).hypot(pixel.y - seen.pixel[1]) as f32
            })
            .collect();
        (pure_rotation, median(&mut left).unwrap_or(0.0))
    }

    /// How the camera turns at the first frame, and at each of the others.
    fn turns(&self) -> Vec<Twist> {
        let first = (self.timestamp, Se3::identity());
        let all: Vec<(f64, Se3)> = [first]
            .into_iter()
            .chain(self.frames.iter().map(|frame| (frame.timestamp, frame.pure_rotation)))
            .collect();
        let at = |i: usize| {
            let ((from, before), (to, after)) = (all[i.saturating_sub(1)], all[(i + 1).min(all.len() - 1)]);
            motion(&before, &after, to - from)
        };
        (0..all.len()).map(at).collect()
    }

    /// Poses (first frame and chosen frames) and points seen in the last of `chosen`, as this sensor shows them.
    fn problem(&self, chosen: &[usize], poses: &[Se3], inverse_depth: f64, sensor: &Sensor) -> Problem {
        let mut problem = self.problem_of(chosen, poses, inverse_depth, sensor, [0.0; UNKNOWNS]);
        problem.calibration = None;
        problem
    }

    /// The same, with a sensor that is uncertain by `sigma`.
    fn problem_of(
        &self,
        chosen: &[usize],
        poses: &[Se3],
        inverse_depth: f64,
        sensor: &Sensor,
        sigma: [f64; UNKNOWNS],
    ) -> Problem {
        let turns = self.turns();
        let distorted = |frame: usize, pixel: [f32; 2]| {
            let pixel = pixel.map(f64::from);
            DistortedPixel { pixel, velocity: sensor.velocity(pixel, &turns[frame], 0.0) }
        };
        let (mut hosts, mut all) = (Vec::new(), Vec::new());
        let mut problem = Problem {
            camera: self.camera,
            frames: [Se3::identity()].into_iter().chain(poses.iter().copied()).collect(),
            fixed: (0..=chosen.len()).map(|i| i == 0).collect(),
            points: Vec::new(),
            observations: Vec::new(),
            calibration: None,
        };
        let Some(&last) = chosen.last() else { return problem };
        for (index, track) in self.tracks.iter().enumerate() {
            if self.frames[last].seen[index].is_none() {
                continue;
            }
            let first = problem.observations.len();
            problem.observations.extend(chosen.iter().enumerate().filter_map(|(i, &frame)| {
                let (pixel, information) = self.frames[frame].seen[index]?;
                all.push((distorted(frame + 1, pixel), information.map(f64::from)));
                Some(WindowObservation {
                    frame: i + 1,
                    pixel: pixel.map(f64::from),
                    information: information.map(f64::from),
                })
            }));
            hosts.push(distorted(0, track.pixel));
            problem.points.push(WindowPoint {
                host: 0,
                ray: self.camera.unproject(track.pixel[0] as f64, track.pixel[1] as f64),
                inverse_depth,
                observations: first..problem.observations.len(),
                information: 0.0,
            });
        }
        problem.calibration =
            Some(Calibration { sensor: *sensor, sigma, variance: [0.0; UNKNOWNS], hosts, seen: all });
        problem.set_sensor(sensor.unknowns());
        problem
    }

    /// Poses and depths by the sensor as it is known, or as one that reads all rows at once, or one after the other, where
    /// that leaves much less.
    pub(super) fn solve(&self, pure_rotation: &Se3, readout_sigma: f64) -> Option<Solution> {
        let initial_poses = self.initial_poses(pure_rotation);
        let mut best = self.solve_from(&initial_poses, &self.sensor, [0.0; UNKNOWNS])?;
        let at_once = self.sensor.with_readout([0.0; 2]);
        let known =
            self.sensor.is_rolling().then(|| self.solve_from(&initial_poses, &at_once, [0.0; UNKNOWNS]));
        let rolling = self.solve_rolling(&[best.poses(), initial_poses[0].clone()], readout_sigma);
        for other in [known.flatten(), rolling].into_iter().flatten() {
            if other.cost < OTHER_SHUTTER * best.cost {
                best = other;
            }
        }
        Some(best)
    }

    /// Poses, depths and the readout time, if it is one that a camera of so many frames a second can have.
    fn solve_rolling(&self, initial_poses: &[Vec<Se3>], sigma: f64) -> Option<Solution> {
        let at_once = self.sensor.with_readout([0.0; 2]);
        let readout = |solution: &Solution| {
            let readout = solution.sensor.plausible_readout();
            let longest = LONGEST_READOUT.min(self.interval());
            (readout != [0.0; 2] && readout.iter().all(|time| time.abs() <= longest)).then_some(readout)
        };
        if sigma == 0.0 {
            return None;
        }
        let both = self.solve_from(initial_poses, &at_once, [0.0, sigma, sigma])?;
        let rolling = both.sensor.with_readout(readout(&both)?);
        let [columns, rows] = rolling.readout.map(|time| if time == 0.0 { 0.0 } else { sigma });
        let solution = self.solve_from(&[both.poses()], &rolling, [0.0, columns, rows])?;
        readout(&solution).is_some().then_some(solution)
    }

    /// Mean time between frames, seconds.
    fn interval(&self) -> f64 {
        let last = self.frames.last().map_or(self.timestamp, |frame| frame.timestamp);
        (last - self.timestamp) / self.frames.len().max(1) as f64
    }

    /// Poses of the chosen frames to seek a solution from: the camera turns only, or travels in one of six directions besides.
    pub(super) fn initial_poses(&self, pure_rotation: &Se3) -> Vec<Vec<Se3>> {
        let chosen = self.chosen();
        let w = pure_rotation.rotation.scaled_axis();
        let directions = [
            Vector3::zeros(),
            Vector3::x(),
            -Vector3::x(),
            Vector3::y(),
            -Vector3::y(),
            Vector3::z(),
            -Vector3::z(),
        ];
        let pose = |direction: &Vector3<f64>, frame: usize| {
            let share = (frame + 1) as f64 / self.frames.len() as f64;
            let (v, w) = (direction * 0.1 * share, w * share);
            Se3::exp(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z))
        };
        let initial_pose = |direction| chosen.iter().map(|&frame| pose(direction, frame)).collect();
        directions.iter().map(initial_pose).collect()
    }

    /// Poses and depths, sought from several ways; the solution that costs least.
    fn solve_from(
        &self,
        initial_poses: &[Vec<Se3>],
        sensor: &Sensor,
        sigma: [f64; UNKNOWNS],
    ) -> Option<Solution> {
        let chosen = self.chosen();
        let (cost, mut problem) = cheapest(initial_poses, |poses| {
            let mut problem = self.problem_of(&chosen, poses, 1.0, sensor, sigma);
            if sigma == [0.0; UNKNOWNS] {
                problem.calibration = None;
            }
            problem
        })?;
        weigh_sensor(&mut problem);
        let sensor = problem.calibration.take().map_or(*sensor, |calibration| calibration.solved());
        Some(Solution { cost, problem, sensor })
    }

    /// What is left when the poses of the chosen frames are held and the depths fit them best.
    pub(super) fn cost_of(&self, poses: &[Se3]) -> f64 {
        let mut problem = self.problem(&self.chosen(), poses, 1.0, &self.sensor);
        problem.fixed.fill(true);
        solve(&mut problem, MAX_ITERATIONS)
    }

    /// The frames that are solved for: at most five, evenly spaced, the newest the last.
    pub(super) fn chosen(&self) -> Vec<usize> {
        match self.frames.len() {
            count @ 0..=5 => (0..count).collect(),
            count => (1..=5).map(|i| i * count / 5 - 1).collect(),
        }
    }

    /// Poses of all frames of the start, with the solution's depths held.
    pub(super) fn pose_all(&self, solution: &Solution, unit: f64) -> Vec<(f64, u64, Se3)> {
        let all: Vec<usize> = (0..self.frames.len()).collect();
        let last = *solution.problem.frames.last().unwrap_or(&Se3::identity());
        let twist = last.log();
        let depths: BTreeMap<usize, f64> = self
            .followed()
            .into_iter()
            .zip(solution.problem.points.iter().map(|p| p.inverse_depth))
            .collect();
        all.iter()
            .map(|&frame| {
                let share = (frame + 1) as f64 / self.frames.len() as f64;
                let mut problem =
                    self.problem(&[frame], &[Se3::exp(&(twist * share))], 1.0, &solution.sensor);
                let mut tracks = self.seen_in(frame);
                // Points are in the order of their tracks; those without a depth leave.
                problem.points.retain_mut(|point| {
                    let known = tracks.next().and_then(|track| depths.get(&track));
                    point.inverse_depth = known.copied().unwrap_or(0.0);
                    point.inverse_depth > 0.0
                });
                let pose = fit_pose(&problem, 8, false);
                let f = &self.frames[frame];
                (f.timestamp, f.frame_index, Se3::new(pose.rotation, pose.translation * unit))
            })
            .collect()
    }

    /// The tracks that a frame sees, ascending.
    fn seen_in(&self, frame: usize) -> impl Iterator<Item = usize> {
        let seen = self.frames[frame].seen.iter().enumerate();
        seen.filter_map(|(track, seen)| seen.map(|_| track))
    }

    /// The tracks that a solution has points of.
    pub(super) fn followed(&self) -> Vec<usize> {
        self.seen_in(self.frames.len() - 1).collect()
    }
}

/// The solution that costs least, and its cost, of the problems that are made of these poses.
pub(super) fn cheapest<P: AsRef<[Se3]> + Sync>(
    starts: &[P],
    problem: impl Fn(&[Se3]) -> Problem + Sync,
) -> Option<(f64, Problem)> {
    let solved = |poses: &P| {
        let mut problem = problem(poses.as_ref());
        (solve(&mut problem, MAX_ITERATIONS), problem)
    };
    let solved: Vec<(f64, Problem)> = starts.par_iter().map(solved).collect();
    solved.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))
}

/// The pose of frame 1 of `problem` that agrees best with where it sees the points, their depths held;
/// `rotation_only` holds its translation too.
fn fit_pose(problem: &Problem, iterations: usize, rotation_only: bool) -> Se3 {
    let sightings = problem.points.iter().flat_map(|point| {
        problem.observations[point.observations.clone()].iter().map(|seen| SeenPoint {
            direction: point.ray,
            inverse_depth: point.inverse_depth,
            pixel: seen.pixel,
            information: seen.information,
        })
    });
    let points: Vec<SeenPoint> = sightings.collect();
    let solver = PoseSolver { iterations, wide: 0, settled: 0.0, rotation_only };
    solver.solve(&problem.camera, &problem.frames[1], &points)
}

/// Squared residual that an observation of a good start stays below; χ² of two degrees of freedom at 99.7 %,
/// widened when all residuals are larger than assumed (rolling shutter in a fast turn).
pub(super) fn agreement(squared: &[f64]) -> f64 {
    let mut all: Vec<f32> = squared.iter().map(|s| *s as f32).collect();
    12.0 * median(&mut all).map_or(1.0, |m| (m as f64).clamp(1.0, MAX_WIDENING))
}

/// What the turns of a solution's frames leave uncertain of each point's inverse depth, as a variance.
pub(super) fn variances_by_rotation(solution: &Problem) -> Vec<f64> {
    let pairs = Pairs::new(solution);
    let relative = pairs.relative(&solution.frames);
    let of = |point: &WindowPoint| least_variance_by_rotation(solution, &pairs, &relative, point);
    solution.points.iter().map(of).collect()
}

/// Beyond this the residuals are not noise.
const MAX_WIDENING: f64 = 8.0;

/// Whether a solution is one to build on: most points agree, lie in front and have certain depths.
pub(super) fn acceptable(solution: &Problem, params: &BootstrapParams) -> bool {
    let squared = solution.squared_residuals();
    let limit = agreement(&squared);
    let mut sigmas = Vec::new();
    let mut good = 0usize;
    for point in &solution.points {
        let agrees = point.observations.clone().all(|i| squared[i] < limit);
        if agrees && point.inverse_depth > 1e-3 && point.information > 0.0 {
            good += 1;
            sigmas
                .push((limit / 12.0).sqrt() as f32 / (point.information.sqrt() * point.inverse_depth) as f32);
        }
    }
    let sigma = median(&mut sigmas).unwrap_or(f32::INFINITY) as f64;
    good as f64 >= params.min_inliers * solution.points.len() as f64
        && good >= MIN_POINTS
        && sigma < params.max_relative_sigma
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agreement_widens_with_the_residuals_within_limits() {
        assert_eq!(agreement(&[]), 12.0);
        assert_eq!(agreement(&[0.1, 0.2, 0.3]), 12.0);
        assert_eq!(agreement(&[1.0, 2.0, 3.0]), 24.0);
        assert_eq!(agreement(&[1e6; 5]), 12.0 * MAX_WIDENING);
    }
}
