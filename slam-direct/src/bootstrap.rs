//! The first map: patches of the first frame are followed until they have moved enough, then poses and
//! inverse depths of all frames so far are solved for together, from several starts.
//!
//! No essential matrix is needed: with inverse depths and small motions the joint problem converges from
//! constant depth (Yu & Gallup, CVPR 2014); several directions of travel guard against its mirror solutions.

use crate::local_map::{KeyframeState, LocalMap, PointState, SeenAt, median};
use crate::patch::{PatchMatch, Template};
use crate::select::select;
use crate::track::{TrackParams, position_information};
use crate::warp::Warp;
use crate::window::{PoseSolver, Problem, SeenPoint, WindowObservation, WindowPoint, solve};
use backend::params;
use geometry::{Pinhole, Pyramid, Se3};
use nalgebra::{Vector3, Vector6};
use rayon::prelude::*;

params! {
    /// Parameters of the start.
    pub struct BootstrapParams {
        /// Points to follow.
        pub block: usize = 16,
        /// Median way of the points, turn removed, that is worth an attempt; share of the image width.
        pub min_parallax: f32 = 0.008,
        /// Share of the points that must still be followed, else the start begins anew.
        pub min_followed: f32 = 0.3,
        /// Frames after which the start begins anew.
        pub max_frames: usize = 60,
        /// Median standard deviation of the inverse depths, relative to them, that a good start has.
        pub max_relative_sigma: f64 = 0.08,
        /// Share of the points that must agree with the solution.
        pub min_inliers: f64 = 0.55,
    }
}

/// A frame of the start.
struct Followed {
    timestamp: f64,
    frame_index: u64,
    /// Per followed point: where it is.
    seen: Vec<Option<([f32; 2], [f32; 3])>>,
}

/// One point being followed.
struct Track {
    pixel: [f32; 2],
    at: [f32; 2],
    velocity: [f32; 2],
    templates: Vec<Template>,
    /// Where the newest frame shows it, with the information; `None` once it is lost.
    seen: Option<([f32; 2], [f32; 3])>,
    lost: bool,
}

/// A start in progress.
pub(crate) struct Bootstrap {
    camera: Pinhole,
    first: Pyramid,
    timestamp: f64,
    frame_index: u64,
    tracks: Vec<Track>,
    frames: Vec<Followed>,
}

/// What a frame did to the start.
pub(crate) enum Progress {
    /// More frames are needed.
    Waiting(&'static str),
    /// The first frame is of no use any more: begin with this one.
    Restart(&'static str),
    /// There is a map: two keyframes, and the poses of the frames between relative to the first.
    Done(Box<Started>),
}

/// The first map.
pub(crate) struct Started {
    pub map: LocalMap,
    /// `(timestamp, frame index, frame_from_first)` of the frames after the first, the last one included.
    pub frames: Vec<(f64, u64, Se3)>,
}

/// Points without which there is no first map.
const MIN_POINTS: usize = 60;
/// Pyramid levels over which patches are followed.
const LEVELS: usize = 4;

impl Bootstrap {
    /// Begins with a frame; `None` when it has too little texture.
    pub fn new(
        camera: Pinhole,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        params: &BootstrapParams,
    ) -> Option<Self> {
        let candidates = select(pyramid.base(), params.block, 12.0, |_, _| false);
        let tracks: Vec<Track> = candidates
            .iter()
            .filter_map(|c| {
                let template = |level: usize| {
                    let warp =
                        Warp { host_from_view: [1.0, 0.0, 0.0, 1.0], host_level: level, view_level: level };
                    Template::cut(&pyramid, c.pixel, &warp)
                };
                let templates: Vec<Template> = (0..LEVELS.min(pyramid.len())).map_while(template).collect();
                (!templates.is_empty()).then_some(Track {
                    pixel: c.pixel,
                    at: c.pixel,
                    velocity: [0.0; 2],
                    templates,
                    seen: None,
                    lost: false,
                })
            })
            .collect();
        (tracks.len() >= 60).then_some(Self {
            camera,
            first: pyramid,
            timestamp,
            frame_index,
            tracks,
            frames: Vec::new(),
        })
    }

    /// Follows the points into a frame and tries for a map when they have moved enough.
    pub fn add(
        &mut self,
        pyramid: &Pyramid,
        timestamp: f64,
        frame_index: u64,
        params: &BootstrapParams,
        track: &TrackParams,
    ) -> Progress {
        self.follow(pyramid, track);
        let seen: Vec<_> = self.tracks.iter().map(|t| t.seen.filter(|_| !t.lost)).collect();
        let count = seen.iter().flatten().count();
        self.frames.push(Followed { timestamp, frame_index, seen });
        if (count as f32) < params.min_followed * self.tracks.len() as f32 || count < MIN_POINTS {
            return Progress::Restart("the view changed before the first map was made");
        }
        let (turn, parallax) = self.parallax();
        if parallax < params.min_parallax * self.camera.width as f32 {
            if self.frames.len() >= params.max_frames {
                return Progress::Restart("the camera hardly moved");
            }
            return Progress::Waiting("waiting for the camera to move sideways");
        }
        match self.attempt(&turn, params) {
            Some(solution) => Progress::Done(Box::new(self.finish(solution, pyramid))),
            None if self.frames.len() >= params.max_frames => Progress::Restart("no consistent first map"),
            None => Progress::Waiting("the first map is not certain yet"),
        }
    }

    fn follow(&mut self, pyramid: &Pyramid, params: &TrackParams) {
        self.tracks.par_iter_mut().with_min_len(32).filter(|t| !t.lost).for_each(|t| {
            let start = [t.at[0] + t.velocity[0], t.at[1] + t.velocity[1]];
            let found =
                [start, t.at].into_iter().find_map(|s| coarse_to_fine(&t.templates, pyramid, s, params));
            t.seen = found.map(|(found, level)| {
                (found.pixel, position_information(&found.information, found.rmse, level, params))
            });
            match t.seen {
                Some((pixel, _)) => {
                    t.velocity = [pixel[0] - t.at[0], pixel[1] - t.at[1]];
                    t.at = pixel;
                }
                None => t.lost = true,
            }
        });
    }

    /// The rotation that explains the newest frame best, and the median way that it leaves.
    fn parallax(&self) -> (Se3, f32) {
        let mut problem = self.problem(&[self.frames.len() - 1], &[Se3::identity()], 0.0);
        let turn = fit_pose(&problem, 15, true);
        problem.frames[1] = turn;
        let mut left: Vec<f32> = problem
            .observations
            .iter()
            .zip(&problem.points)
            .map(|(seen, point)| {
                let pixel = self.camera.project(&(turn.rotation * point.ray));
                (pixel.x - seen.pixel[0]).hypot(pixel.y - seen.pixel[1]) as f32
            })
            .collect();
        (turn, median(&mut left).unwrap_or(0.0))
    }

    /// Poses (first frame and chosen frames) and points seen in the last of `chosen`.
    fn problem(&self, chosen: &[usize], poses: &[Se3], inverse_depth: f64) -> Problem {
        let mut problem = Problem {
            camera: self.camera,
            frames: [Se3::identity()].into_iter().chain(poses.iter().copied()).collect(),
            fixed: (0..=chosen.len()).map(|i| i == 0).collect(),
            points: Vec::new(),
            observations: Vec::new(),
        };
        let Some(&last) = chosen.last() else { return problem };
        for (index, track) in self.tracks.iter().enumerate() {
            if self.frames[last].seen[index].is_none() {
                continue;
            }
            let first = problem.observations.len();
            problem.observations.extend(chosen.iter().enumerate().filter_map(|(i, &frame)| {
                let (pixel, information) = self.frames[frame].seen[index]?;
                Some(WindowObservation {
                    frame: i + 1,
                    pixel: pixel.map(f64::from),
                    information: information.map(f64::from),
                })
            }));
            problem.points.push(WindowPoint {
                host: 0,
                ray: self.camera.unproject(track.pixel[0] as f64, track.pixel[1] as f64),
                inverse_depth,
                observations: first..problem.observations.len(),
                information: 0.0,
            });
        }
        problem
    }

    /// Solves for poses and depths from several directions of travel; the best solution if it is good.
    fn attempt(&self, turn: &Se3, params: &BootstrapParams) -> Option<Problem> {
        let count = self.frames.len();
        let chosen: Vec<usize> = match count {
            1..=5 => (0..count).collect(),
            _ => (1..=5).map(|i| i * count / 5 - 1).collect(),
        };
        let w = turn.rotation.scaled_axis();
        let starts = [
            Vector3::zeros(),
            Vector3::x(),
            -Vector3::x(),
            Vector3::y(),
            -Vector3::y(),
            Vector3::z(),
            -Vector3::z(),
        ];
        let solved: Vec<(f64, Problem)> = starts
            .par_iter()
            .map(|direction| {
                let poses: Vec<Se3> = chosen
                    .iter()
                    .map(|&frame| {
                        let share = (frame + 1) as f64 / count as f64;
                        let (v, w) = (direction * 0.1 * share, w * share);
                        Se3::exp(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z))
                    })
                    .collect();
                let mut problem = self.problem(&chosen, &poses, 1.0);
                let cost = solve(&mut problem, 40);
                (cost, problem)
            })
            .collect();
        let best = solved.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?.1;
        acceptable(&best, params).then_some(best)
    }

    /// Makes two keyframes of the solution, in units of the median depth.
    fn finish(&self, solution: Problem, pyramid: &Pyramid) -> Started {
        let mut depths: Vec<f32> = solution.points.iter().map(|p| p.inverse_depth as f32).collect();
        let unit = median(&mut depths).unwrap_or(1.0) as f64;
        let scaled = |pose: &Se3| Se3::new(pose.rotation, pose.translation * unit);
        let squared = solution.squared_residuals();
        let limit = agreement(&squared);
        let last = solution.frames.len() - 1;
        let mut points = Vec::new();
        let mut observed = Vec::new();
        for point in &solution.points {
            let good = point.observations.clone().all(|i| squared[i] < limit) && point.inverse_depth > 0.0;
            let relative = 1.0 / (point.information.sqrt() * point.inverse_depth);
            if !good || relative > 0.3 {
                continue;
            }
            let Some(seen) =
                solution.observations[point.observations.clone()].iter().find(|o| o.frame == last)
            else {
                continue;
            };
            let pixel = self.camera.project(&point.ray);
            observed.push(crate::local_map::PointRef { host: 0, index: points.len() });
            points.push(PointState {
                pixel: [pixel.x as f32, pixel.y as f32],
                ray: point.ray,
                inverse_depth: point.inverse_depth / unit,
                variance: 1.0 / (point.information * unit * unit),
                observations: vec![SeenAt {
                    keyframe: 1,
                    pixel: seen.pixel.map(|v| v as f32),
                    information: seen.information.map(|v| v as f32),
                }],
                alive: true,
                sought: 0,
                found: 0,
            });
        }
        let newest = &self.frames[self.frames.len() - 1];
        let mut map = LocalMap::new(self.camera);
        map.keyframes.push(KeyframeState {
            timestamp: self.timestamp,
            frame_index: self.frame_index,
            pyramid: self.first.clone(),
            camera_from_world: Se3::identity(),
            points,
            seen: Vec::new(),
            companions: Vec::new(),
        });
        map.keyframes.push(KeyframeState {
            timestamp: newest.timestamp,
            frame_index: newest.frame_index,
            pyramid: pyramid.clone(),
            camera_from_world: scaled(&solution.frames[last]),
            points: Vec::new(),
            seen: observed,
            companions: Vec::new(),
        });
        let frames = self.pose_all(&solution, unit);
        Started { map, frames }
    }

    /// Poses of all frames of the start, with the solution's depths held.
    fn pose_all(&self, solution: &Problem, unit: f64) -> Vec<(f64, u64, Se3)> {
        let all: Vec<usize> = (0..self.frames.len()).collect();
        let last = *solution.frames.last().unwrap_or(&Se3::identity());
        let twist = last.log();
        all.iter()
            .map(|&frame| {
                let share = (frame + 1) as f64 / self.frames.len() as f64;
                let mut problem = self.problem(&[frame], &[Se3::exp(&(twist * share))], 1.0);
                hold_depths(&mut problem, solution);
                let pose = fit_pose(&problem, 8, false);
                let f = &self.frames[frame];
                (f.timestamp, f.frame_index, Se3::new(pose.rotation, pose.translation * unit))
            })
            .collect()
    }
}

/// Gives the points of `problem` the depths that `solution` found for the same rays; others leave.
fn hold_depths(problem: &mut Problem, solution: &Problem) {
    let mut known = solution.points.iter();
    problem.points.retain_mut(|point| {
        // Both lists are in the order of the tracks.
        match known.clone().position(|k| k.ray == point.ray) {
            Some(position) => {
                let found = known.nth(position);
                point.inverse_depth = found.map_or(1.0, |k| k.inverse_depth);
                found.is_some_and(|k| k.inverse_depth > 0.0)
            }
            None => false,
        }
    });
}

/// Follows a patch from the coarsest level down; the match at level 0, or at level 1 where blur hides the
/// patch below it.
fn coarse_to_fine(
    templates: &[Template],
    pyramid: &Pyramid,
    start: [f32; 2],
    params: &TrackParams,
) -> Option<(PatchMatch, usize)> {
    let mut at = start;
    let mut best = None;
    for template in templates.iter().rev() {
        if let Some(found) = template.align(pyramid, at, 8.0, 12) {
            at = found.pixel;
            if template.level <= 1 && found.unexplained < params.max_unexplained {
                best = Some((found, template.level));
            }
        }
    }
    best
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
fn agreement(squared: &[f64]) -> f64 {
    let mut all: Vec<f32> = squared.iter().map(|s| *s as f32).collect();
    12.0 * median(&mut all).map_or(1.0, |m| (m as f64).clamp(1.0, MAX_WIDENING))
}

/// Beyond this the residuals are not noise.
const MAX_WIDENING: f64 = 8.0;

/// Whether a solution is one to build on: most points agree, lie in front and have certain depths.
fn acceptable(solution: &Problem, params: &BootstrapParams) -> bool {
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
mod tests;
