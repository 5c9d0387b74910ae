//! Keyframes and points of the map as a joint optimisation, and its result carried back.

use super::ScaleChange;
use crate::local_map::{LocalMap, PointRef, PointState, SeenAt};
use crate::window::{
    Calibration, DistortedPixel, Pairs, Problem, WindowObservation, WindowPoint, least_variance_by_rotation,
};
use geometry::median;
use geometry::sensor::UNKNOWNS;
use std::collections::{BTreeMap, BTreeSet};

/// Squared normalised residual above which the joint optimisation gives an observation up.
const OUTLIER: f64 = 18.4;

/// A part of the map as values.
pub(super) struct Window {
    pub problem: Problem,
    pub pairs: Pairs,
    /// Which keyframe each frame of the problem is, ascending.
    keyframes: Vec<usize>,
    /// Whether it is among those to be moved.
    active: Vec<bool>,
    /// Which point of the map each point of the problem is.
    points: Vec<PointRef>,
    /// Which observation of its point each observation of the problem is.
    seen: Vec<u32>,
}

impl Window {
    /// The `active` keyframes with all points they host or see. Of the other keyframes that host or see these, the
    /// `max_fixed` that share most points hold the rest in place; what only others know of is left out.
    pub fn build(map: &LocalMap, active: &BTreeSet<usize>, max_fixed: usize) -> Self {
        let mut chosen: Vec<PointRef> = active.iter().flat_map(|&k| map.points_of(k)).collect();
        chosen.sort_unstable();
        chosen.dedup();
        let keyframes = frames(map, active, &chosen, max_fixed);
        let frame = |keyframe: usize| keyframes.binary_search(&keyframe).ok();
        let is_active: Vec<bool> = keyframes.iter().map(|k| active.contains(k)).collect();
        let mut problem = Problem {
            camera: map.camera,
            frames: keyframes.iter().map(|&k| map.keyframes[k].camera_from_world).collect(),
            // The first keyframe holds the world; with others fixed they hold it.
            fixed: keyframes.iter().zip(&is_active).map(|(&k, active)| !active || k == 0).collect(),
            points: Vec::with_capacity(chosen.len()),
            observations: Vec::new(),
            calibration: None,
        };
        let (mut points, mut seen) = (Vec::with_capacity(chosen.len()), Vec::new());
        for at in chosen {
            let Some(host) = frame(at.host) else { continue };
            let point = map.point(at);
            let first = problem.observations.len();
            for (index, o) in point.observations.iter().enumerate() {
                let Some(frame) = frame(o.keyframe) else { continue };
                let pixel =
                    map.undistorted_pixel(o.keyframe, o.pixel, seen_inverse_depth(map, at.host, point, o));
                let information = o.information.map(f64::from);
                problem.observations.push(WindowObservation { frame, pixel, information });
                seen.push(index as u32);
            }
            problem.points.push(WindowPoint {
                host,
                ray: point.ray,
                inverse_depth: point.inverse_depth,
                observations: first..problem.observations.len(),
                information: 0.0,
            });
            points.push(at);
        }
        let pairs = Pairs::new(&problem);
        Self { problem, pairs, keyframes, active: is_active, points, seen }
    }

    /// Makes the sensor unknown, a priori uncertain by `sigma`.
    pub fn calibrate(&mut self, map: &LocalMap, sigma: [f64; UNKNOWNS]) {
        let distorted = |keyframe: usize, pixel: [f32; 2], inverse_depth: f64| {
            let (pixel, motion) = (pixel.map(f64::from), map.keyframes[keyframe].motion_in_world());
            DistortedPixel { pixel, velocity: map.sensor.velocity(pixel, &motion, inverse_depth) }
        };
        let host = |&at: &PointRef| distorted(at.host, map.point(at).pixel, map.point(at).inverse_depth);
        let hosts = self.points.iter().map(host).collect();
        let of_point = |(solved, &at): (&WindowPoint, &PointRef)| {
            let point = map.point(at);
            let own = self.seen[solved.observations.clone()].iter();
            own.map(|&i| {
                let seen = &point.observations[i as usize];
                let inverse_depth = seen_inverse_depth(map, at.host, point, seen);
                (distorted(seen.keyframe, seen.pixel, inverse_depth), seen.information.map(f64::from))
            })
            .collect::<Vec<_>>()
        };
        let seen = self.problem.points.iter().zip(&self.points).flat_map(of_point).collect();
        let sensor = map.sensor;
        self.problem.calibration =
            Some(Calibration { sensor, sigma, variance: [0.0; UNKNOWNS], hosts, seen });
        self.problem.set_sensor(sensor.unknowns());
    }

    /// Depth of each observed point in the frame that is moved, in order of points and observations, the host first.
    pub fn frame_depths(&self) -> Vec<(usize, f64)> {
        let Self { problem, pairs, .. } = self;
        let mut all = Vec::with_capacity(problem.observations.len() + problem.points.len());
        let relative = pairs.relative(&problem.frames);
        for point in &problem.points {
            if self.active[point.host] {
                all.push((point.host, 1.0 / point.inverse_depth));
            }
            for i in point.observations.clone().filter(|&i| self.active[problem.observations[i].frame]) {
                let x = relative[pairs.of(i)].transform(&point.ray, point.inverse_depth);
                all.push((problem.observations[i].frame, x.z / point.inverse_depth));
            }
        }
        all
    }

    /// How the scales of the keyframes that were moved changed since their depths were `before`, one change each.
    pub fn scale_changes(&self, before: &[(usize, f64)]) -> Vec<ScaleChange> {
        let mut ratios: Vec<Vec<f32>> = vec![Vec::new(); self.keyframes.len()];
        for (&(frame, old), (_, new)) in before.iter().zip(self.frame_depths()) {
            if old > 0.0 && new > 0.0 {
                ratios[frame].push((new / old) as f32);
            }
        }
        let change = |(frame, &keyframe): (usize, &usize)| {
            let factor = median(&mut ratios[frame]).filter(|f| f.is_finite()).unwrap_or(1.0);
            self.active[frame].then_some(ScaleChange { keyframe, factor: factor.into() })
        };
        self.keyframes.iter().enumerate().filter_map(change).collect()
    }

    /// Writes the solution back; observations that disagree with it go, points without any die. `by_poses` is what the
    /// uncertainty of the poses adds to the variance of each point's inverse depth; without it a depth stays as doubtful as it
    /// was.
    pub fn apply(&self, map: &mut LocalMap, by_poses: Option<&[f64]>) {
        let Self { problem, keyframes, .. } = self;
        for (frame, &keyframe) in problem.frames.iter().zip(keyframes) {
            map.keyframes[keyframe].camera_from_world = *frame;
        }
        let sensor = problem.calibration.as_ref().map(Calibration::solved);
        let squared = problem.squared_residuals();
        let mut dropped: BTreeSet<(usize, PointRef)> = BTreeSet::new();
        let relative = self.pairs.relative(&problem.frames);
        for (index, (solved, &at)) in problem.points.iter().zip(&self.points).enumerate() {
            let point = map.point_mut(at);
            point.inverse_depth = solved.inverse_depth;
            if solved.information > 0.0 {
                let by_rotation = least_variance_by_rotation(problem, &self.pairs, &relative, solved);
                point.variance = 1.0 / solved.information;
                point.doubt = match by_poses {
                    Some(by_poses) => by_rotation + by_poses[index],
                    None => by_rotation.max(point.doubt),
                };
            }
            // From behind, so that those still to be looked at keep their places.
            let agrees = |i: &usize| squared[*i] < OUTLIER;
            for i in solved.observations.clone().rev().filter(|i| !agrees(i)) {
                let gone = point.observations.remove(self.seen[i] as usize);
                dropped.insert((gone.keyframe, at));
            }
            point.alive = !point.observations.is_empty() && point.inverse_depth > 0.0;
        }
        match sensor {
            Some(sensor) => map.set_sensor(sensor),
            // How far a point moves while the image is read depends on its depth.
            None if map.sensor.is_rolling() => {
                for &at in &self.points {
                    let point = map.point(at);
                    map.point_mut(at).ray = map.ray(at.host, point.pixel, point.inverse_depth);
                }
            }
            None => {}
        }
        for &keyframe in keyframes {
            let mut seen = std::mem::take(&mut map.keyframes[keyframe].seen);
            seen.retain(|&at| map.point(at).alive && !dropped.contains(&(keyframe, at)));
            map.keyframes[keyframe].seen = seen;
        }
    }
}

/// Inverse depth of a point in a keyframe that sees it.
fn seen_inverse_depth(map: &LocalMap, host: usize, point: &PointState, seen: &SeenAt) -> f64 {
    let seen_from_host =
        map.keyframes[seen.keyframe].camera_from_world * map.keyframes[host].camera_from_world.inverse();
    let x = seen_from_host.rotation * point.ray + seen_from_host.translation * point.inverse_depth;
    point.inverse_depth / x.z
}

/// The keyframes of a window, ascending.
fn frames(map: &LocalMap, active: &BTreeSet<usize>, points: &[PointRef], max_fixed: usize) -> Vec<usize> {
    let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
    if active.len() < map.keyframes.len() {
        for &at in points {
            let around = map.point(at).observations.iter().map(|o| o.keyframe).chain([at.host]);
            for keyframe in around.filter(|k| !active.contains(k)) {
                *shared.entry(keyframe).or_default() += 1;
            }
        }
    }
    let mut fixed: Vec<(usize, usize)> = shared.into_iter().collect();
    fixed.sort_by(|a, b| b.1.cmp(&a.1).then(b.0.cmp(&a.0)));
    let mut all: Vec<usize> =
        fixed.into_iter().take(max_fixed).map(|f| f.0).chain(active.iter().copied()).collect();
    all.sort_unstable();
    all
}
