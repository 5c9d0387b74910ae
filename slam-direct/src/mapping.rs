//! What a new keyframe sets off: new points, the joint optimisation of its surroundings, culling.

use crate::local_map::{LocalMap, PointRef, SeenAt, median};
use crate::select::select;
use crate::track::{Matched, TrackParams};
use crate::triangulate::{TriangulateParams, Triangulator};
use crate::window::{Problem, WindowObservation, WindowPoint, solve};
use backend::params;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Squared normalised residual below which a match binds a new keyframe to a point.
const OBSERVED: f64 = 9.21;
/// Squared normalised residual above which the joint optimisation gives an observation up.
const OUTLIER: f64 = 18.4;

params! {
    /// Parameters of the mapping.
    pub struct MappingParams {
        /// Side of the blocks that get one point each, pixels.
        pub block: usize = 20,
        /// Least distinctness of a point, squared grey levels per pixel.
        pub min_score: f32 = 12.0,
        /// Keyframes that are moved together after a new one.
        pub window: usize = 8,
        /// Iterations of the window optimisation.
        pub window_iterations: usize = 6,
        /// Iterations of the last optimisation of the whole map.
        pub final_iterations: usize = 20,
        /// A keyframe's semi-dense depth is computed when this many newer ones are there.
        pub settle_after: usize = 3,
        /// Keyframes in which a new point's depth is sought.
        pub search_views: usize = 12,
    }
}

/// Adds the matched points to what the keyframe sees.
pub(crate) fn add_observations(map: &mut LocalMap, keyframe: usize, matched: &[Matched]) {
    for m in matched.iter().filter(|m| m.squared < OBSERVED && m.at.host != keyframe) {
        let known = map.point(m.at).observations.iter().any(|o| o.keyframe == keyframe);
        if !known {
            map.observe(m.at, SeenAt { keyframe, pixel: m.pixel, information: m.information });
        }
    }
}

/// Gives `host` points where it has none, with depths found in `others`.
pub(crate) fn add_points(
    map: &mut LocalMap,
    host: usize,
    others: &[usize],
    params: &MappingParams,
    search: &TriangulateParams,
    track: &TrackParams,
) -> usize {
    let known = map.reference_points(host);
    let block = params.block;
    let occupied: BTreeSet<(usize, usize)> = known
        .iter()
        .map(|p| (p.pixel[0].max(0.0) as usize / block, p.pixel[1].max(0.0) as usize / block))
        .collect();
    let image = map.keyframes[host].pyramid.base();
    let candidates = select(image, block, params.min_score, |cx, cy| occupied.contains(&(cx, cy)));
    let depths = DepthPrior::new(&known);
    let triangulator = Triangulator::new(map, host, others, search, track);
    let points: Vec<_> = candidates
        .par_iter()
        .with_min_len(16)
        .filter_map(|c| triangulator.point(c.pixel, depths.range_near(c.pixel)))
        .collect();
    let count = points.len();
    for point in points {
        let at = PointRef { host, index: map.keyframes[host].points.len() };
        for seen in &point.observations {
            map.keyframes[seen.keyframe].seen.push(at);
        }
        map.keyframes[host].points.push(point);
    }
    count
}

/// What inverse depths to expect where in an image, from the points it already has.
struct DepthPrior {
    points: Vec<([f32; 2], f32)>,
    overall: (f64, f64),
}

impl DepthPrior {
    fn new(points: &[crate::align::ReferencePoint]) -> Self {
        let mut depths: Vec<f32> = points.iter().map(|p| p.inverse_depth).collect();
        depths.sort_by(f32::total_cmp);
        let at = |share: f64| {
            depths.get((share * (depths.len().max(1) - 1) as f64) as usize).copied().unwrap_or(1.0) as f64
        };
        let overall = (0.25 * at(0.05), 2.5 * at(0.95));
        Self { points: points.iter().map(|p| (p.pixel, p.inverse_depth)).collect(), overall }
    }

    /// Range spanned by the nearest points, widened.
    fn range_near(&self, pixel: [f32; 2]) -> (f64, f64) {
        let mut near: Vec<(f32, f32)> = self
            .points
            .iter()
            .map(|(p, d)| ((p[0] - pixel[0]).powi(2) + (p[1] - pixel[1]).powi(2), *d))
            .filter(|(distance, _)| *distance < 100.0 * 100.0)
            .collect();
        if near.len() < 6 {
            return self.overall;
        }
        near.select_nth_unstable_by(5, |a, b| a.0.total_cmp(&b.0));
        let depths = near[..6].iter().map(|n| n.1 as f64);
        let (least, most) = depths.fold((f64::INFINITY, 0.0f64), |(l, m), d| (l.min(d), m.max(d)));
        // What lies nearby bounds the range even where it is farther than all the rest.
        ((0.5 * least).max(self.overall.0).min(least), (1.7 * most).min(self.overall.1).max(0.6 * least))
    }
}

/// Optimises keyframe `centre` and its most covisible neighbours together; the others that see the same
/// points hold the rest in place.
pub(crate) fn optimise_around(map: &mut LocalMap, centre: usize, params: &MappingParams) -> Vec<UnitChange> {
    let neighbours = map.covisible(centre).into_iter().take(params.window - 1).map(|c| c.0);
    let active: BTreeSet<usize> = neighbours.chain([centre]).collect();
    optimise(map, &active, params.window_iterations)
}

/// Optimises all keyframes and points.
pub(crate) fn optimise_all(map: &mut LocalMap, iterations: usize) -> Vec<UnitChange> {
    let active: BTreeSet<usize> = (0..map.keyframes.len()).collect();
    optimise(map, &active, iterations)
}

fn optimise(map: &mut LocalMap, active: &BTreeSet<usize>, iterations: usize) -> Vec<UnitChange> {
    let (mut window, points) = build(map, active);
    let before = frame_depths(&window.0);
    solve(&mut window.0, iterations);
    let changes = unit_changes(&window, &before, &frame_depths(&window.0), active);
    apply(map, &window, &points);
    changes
}

/// How lengths around a keyframe changed in an optimisation: what was measured in its surroundings before
/// (poses of frames, semi-dense depth) must be multiplied by `factor` to fit the map after.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UnitChange {
    pub keyframe: usize,
    pub factor: f64,
}

/// Depth of each observed point in each frame of the window, in order of points and observations, the
/// host first.
fn frame_depths(problem: &Problem) -> Vec<(usize, f64)> {
    let mut all = Vec::with_capacity(problem.observations.len() + problem.points.len());
    let inverse: Vec<_> = problem.frames.iter().map(|f| f.inverse()).collect();
    for point in &problem.points {
        all.push((point.host, 1.0 / point.inverse_depth));
        for seen in &problem.observations[point.observations.clone()] {
            let relative = problem.frames[seen.frame] * inverse[point.host];
            let x = relative.rotation * point.ray + relative.translation * point.inverse_depth;
            all.push((seen.frame, x.z / point.inverse_depth));
        }
    }
    all
}

fn unit_changes(
    (problem, keyframes): &Window,
    before: &[(usize, f64)],
    after: &[(usize, f64)],
    active: &BTreeSet<usize>,
) -> Vec<UnitChange> {
    let mut ratios: Vec<Vec<f32>> = vec![Vec::new(); problem.frames.len()];
    for (&(frame, old), &(_, new)) in before.iter().zip(after) {
        if old > 0.0 && new > 0.0 {
            ratios[frame].push((new / old) as f32);
        }
    }
    let change = |(frame, &keyframe): (usize, &usize)| {
        let factor = median(&mut ratios[frame]).filter(|f| f.is_finite())? as f64;
        active.contains(&keyframe).then_some(UnitChange { keyframe, factor })
    };
    keyframes.iter().enumerate().filter_map(change).collect()
}

/// The window's values, and which keyframe each of its frames is.
type Window = (Problem, Vec<usize>);

fn build(map: &LocalMap, active: &BTreeSet<usize>) -> (Window, Vec<PointRef>) {
    let chosen: BTreeSet<PointRef> = active.iter().flat_map(|&k| map.points_of(k)).collect();
    let mut keyframes: BTreeSet<usize> = active.clone();
    for &at in &chosen {
        keyframes.insert(at.host);
        keyframes.extend(map.point(at).observations.iter().map(|o| o.keyframe));
    }
    let keyframes: Vec<usize> = keyframes.into_iter().collect();
    let index: BTreeMap<usize, usize> = keyframes.iter().enumerate().map(|(i, &k)| (k, i)).collect();
    let mut problem = Problem {
        camera: map.camera,
        frames: keyframes.iter().map(|&k| map.keyframes[k].camera_from_world).collect(),
        // The first keyframe holds the world; with others fixed they hold it.
        fixed: keyframes.iter().map(|k| !active.contains(k) || *k == 0).collect(),
        points: Vec::with_capacity(chosen.len()),
        observations: Vec::new(),
    };
    for &at in &chosen {
        let point = map.point(at);
        let first = problem.observations.len();
        problem.observations.extend(point.observations.iter().map(|o| WindowObservation {
            frame: index[&o.keyframe],
            pixel: o.pixel.map(f64::from),
            information: o.information.map(f64::from),
        }));
        problem.points.push(WindowPoint {
            host: index[&at.host],
            ray: point.ray,
            inverse_depth: point.inverse_depth,
            observations: first..problem.observations.len(),
            information: 0.0,
        });
    }
    ((problem, keyframes), chosen.into_iter().collect())
}

/// Writes the solution back; observations that disagree with it go, points without any die.
fn apply(map: &mut LocalMap, (problem, keyframes): &Window, points: &[PointRef]) {
    for (frame, &keyframe) in problem.frames.iter().zip(keyframes) {
        map.keyframes[keyframe].camera_from_world = *frame;
    }
    let squared = problem.squared_residuals();
    let mut dropped: BTreeMap<usize, BTreeSet<PointRef>> = BTreeMap::new();
    for (solved, &at) in problem.points.iter().zip(points) {
        let point = map.point_mut(at);
        point.inverse_depth = solved.inverse_depth;
        if solved.information > 0.0 {
            point.variance = 1.0 / solved.information;
        }
        let mut residuals = squared[solved.observations.clone()].iter();
        let before = std::mem::take(&mut point.observations);
        for seen in before {
            if residuals.next().is_some_and(|&r| r < OUTLIER) {
                point.observations.push(seen);
            } else {
                dropped.entry(seen.keyframe).or_default().insert(at);
            }
        }
        point.alive = !point.observations.is_empty() && point.inverse_depth > 0.0;
    }
    for (keyframe, gone) in dropped {
        map.keyframes[keyframe].seen.retain(|at| !gone.contains(at));
    }
    for keyframe in keyframes {
        let alive: Vec<PointRef> =
            map.keyframes[*keyframe].seen.iter().copied().filter(|&at| map.point(at).alive).collect();
        map.keyframes[*keyframe].seen = alive;
    }
}

/// Drops points that tracked frames look for in vain.
pub(crate) fn cull_unfound(map: &mut LocalMap, share: f32) {
    for state in &mut map.keyframes {
        for point in state.points.iter_mut().filter(|p| p.alive && p.sought >= 8) {
            if (point.found as f32) < share * point.sought as f32 {
                point.alive = false;
            }
        }
    }
}

/// Median length of the matched points' way from the keyframe to the frame, pixels: in all, and what is
/// left of it without the turn.
pub(crate) fn median_flow(
    map: &LocalMap,
    reference: usize,
    frame_from_reference: &geometry::Se3,
) -> Option<(f32, f32)> {
    let rotation = frame_from_reference.rotation_matrix();
    let camera = &map.camera;
    let (mut all, mut moved): (Vec<f32>, Vec<f32>) = (Vec::new(), Vec::new());
    for point in map.reference_points(reference) {
        let ray = camera.unproject(point.pixel[0] as f64, point.pixel[1] as f64);
        let turned = rotation * ray;
        let x = turned + frame_from_reference.translation * point.inverse_depth as f64;
        if turned.z < 0.05 || x.z < 0.05 {
            continue;
        }
        let (turned, at) = (camera.project(&turned), camera.project(&x));
        all.push((at.x as f32 - point.pixel[0]).hypot(at.y as f32 - point.pixel[1]));
        moved.push((at - turned).norm() as f32);
    }
    Some((median(&mut all)?, median(&mut moved)?))
}

#[cfg(test)]
mod tests;
