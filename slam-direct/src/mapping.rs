//! The work after a new keyframe: new points, the joint optimisation around it, culling.

use crate::align::ReferencePoint;
use crate::local_map::{KeyframeState, LocalMap, Matched, PointRef, PointState, SeenAt};
use crate::select::select;
use crate::track::TrackParams;
use crate::triangulate::{TriangulateParams, Triangulator};
use crate::window::{Limits, OTHER_SHUTTER, Problem, solve_within, variances_by_poses};
use backend::params;
use geometry::sensor::{Sensor, UNKNOWNS};
use geometry::{Pinhole, Se3, median};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;
use window::Window;

mod window;

/// Squared normalised residual below which a match binds a new keyframe to a point.
const OBSERVED: f64 = 9.21;

/// Share of itself by which a readout time that has settled still changes; of what it puts back, as much is left.
const SETTLED_READOUT: f64 = 0.03;
/// Keyframes that are moved together at most where it is asked what their poses leave uncertain of depths: it takes a dense
/// inverse.
const MOST_BY_POSES: usize = 20;

/// Keyframes that are waited for before it is asked for again: about a window's half.
const WAITED: usize = 4;

params! {
    /// Parameters of the mapping.
    pub struct MappingParams {
        /// Side of the blocks that get one point each, pixels. Range 4–200.
        pub block: usize = 20,
        /// Least distinctness of a point, squared grey levels per pixel. Range 0.1–1000.
        pub min_score: f32 = 12.0,
        /// Keyframes that are moved together after a new one. Range 2–50.
        pub window: usize = 8,
        /// Keyframes at most that hold the window in place: those that share most points with it. Range 5–100; the
        /// cost of a keyframe grows with them and not with the map.
        pub fixed: usize = 25,
        /// Iterations of the window optimisation. Range 1–100.
        pub window_iterations: usize = 6,
        /// Iterations of the last optimisation of the whole map. Range 1–200.
        pub final_iterations: usize = 20,
        /// Observations that the last optimisation processes in all its iterations together, millions; a map that has
        /// more gets fewer iterations. Range 1–1000; this limits the time at the end of a long run.
        pub final_effort: f64 = 60.0,
        /// Observations of a map up to which it is optimised as a whole, millions. A map that has more is optimised
        /// in parts of half as many, one after another, each fixed by its surroundings. Range 0.01–100; a million
        /// take 0.2 GB.
        pub whole: f64 = 2.0,
        /// Shift of an image's corner from where the calibration has it, one standard deviation, as a share of its
        /// distance from the middle: the prior of the remaining radial distortion. Range 0–0.1; 0 switches it off.
        /// Cameras of public recordings are off by up to 0.015.
        pub lens_sigma: f64 = 0.02,
        /// Readout time of a camera, one standard deviation, seconds: the prior of a rolling shutter. Range 0–0.1;
        /// with 0 all rows count as read at once.
        pub readout_sigma: f64 = 0.02,
        /// Keyframes from which on both are solved for. Range 3–100; fewer do not determine them.
        pub calibrate_from: usize = 10,
        /// Keyframes up to which the whole map is optimised for them whenever the keyframes have doubled; later, only
        /// at the end and with loops. Range 0–200.
        pub calibrate_until: usize = 80,
        /// Iterations of each of these optimisations. Range 1–100.
        pub calibration_iterations: usize = 10,
        /// A keyframe's semi-dense depth is computed when this many newer ones are there. Range 1–50.
        #[key = "settle_after"]
        pub depth_delay: usize = 3,
        /// Frames after a keyframe at which the agent adopts its mapping. Range 0–10: with 0 the tracker waits for
        /// the mapping of each keyframe; with more, mapping has more time in the background, and the map is that much
        /// older.
        pub lag: usize = 0,
        /// Factor of `lag` where the whole map is optimised: when a loop is closed, or the sensor is calibrated.
        /// Range 1–20; no keyframes are made meanwhile.
        pub whole_lag: usize = 5,
        /// Keyframes in which the depth of a new point is searched. Range 1–100.
        pub search_views: usize = 12,
    }
}

/// The matches that bind a keyframe to their points.
pub(crate) fn inlier_matches(matched: &[Matched]) -> impl Iterator<Item = &Matched> {
    matched.iter().filter(|m| m.squared < OBSERVED)
}

/// Adds the matched points to what the keyframe sees.
pub(crate) fn add_observations(map: &mut LocalMap, keyframe: usize, matched: &[Matched]) {
    for m in inlier_matches(matched).filter(|m| m.at.host != keyframe) {
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
    let candidates = select(image, block, params.min_score, &map.mask, |cx, cy| occupied.contains(&(cx, cy)));
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
    fn new(points: &[ReferencePoint]) -> Self {
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
pub(crate) fn optimise_around(map: &mut LocalMap, centre: usize, params: &MappingParams) -> Vec<ScaleChange> {
    let neighbours = map.covisible(centre).into_iter().take(params.window - 1).map(|c| c.0);
    let active: BTreeSet<usize> = neighbours.chain([centre]).collect();
    optimise(map, &active, params.fixed, [0.0; UNKNOWNS], |_| Limits::steps(params.window_iterations))
}

/// Whether a map of so many keyframes is due to be optimised for its sensor: each time they have doubled, and `again` at so
/// many.
pub(crate) fn calibration_is_due(keyframes: usize, again: Option<usize>, params: &MappingParams) -> bool {
    let first = params.calibrate_from.max(1);
    let doubled = keyframes.is_multiple_of(first) && (keyframes / first).is_power_of_two();
    (params.lens_sigma > 0.0 || params.readout_sigma > 0.0)
        && keyframes <= params.calibrate_until
        && (doubled || again.is_some_and(|again| keyframes >= again))
}

/// How many keyframes to wait for before readout times that changed so in a map of so many `keyframes` are asked for again;
/// nothing where they have settled. What was mapped before a rolling shutter was known of agrees with images that are read
/// at once and holds the first answers back, the more so the fewer keyframes came after.
pub(crate) fn calibrate_again(keyframes: usize, before: &Sensor, after: &Sensor) -> Option<usize> {
    let change = before.readout.iter().zip(&after.readout).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let time = after.readout.iter().map(|time| time.abs()).fold(0.0, f64::max);
    (change > SETTLED_READOUT * time).then_some(keyframes + WAITED)
}

/// Optimises all keyframes and points, and with enough of them the lens, and the readout times of a rolling shutter, in so
/// many iterations at most as the effort (see [`MappingParams::final_effort`]) allows, and until `stop`.
pub(crate) fn optimise_all(
    map: &mut LocalMap,
    iterations: usize,
    params: &MappingParams,
    stop: &dyn Fn() -> bool,
) -> Vec<ScaleChange> {
    let readout = map.sensor.readout.map(|time| if time == 0.0 { 0.0 } else { params.readout_sigma });
    let changes = optimise_whole(map, iterations, readout, params, stop);
    if map.sensor.is_rolling() && map.sensor.plausible_readout() != map.sensor.readout {
        map.set_sensor(map.sensor.with_readout([0.0; 2]));
        return together(changes, optimise_whole(map, iterations, [0.0; 2], params, stop));
    }
    changes
}

/// The same, and asks before whether the camera has a rolling shutter. One that reads columns, as a telephone does that records upright, must
/// explain much: a focal length that is a few per cent wrong stretches what a camera sees that turns to the side, as reading its columns
/// one after the other does.
pub(crate) fn calibrate(map: &mut LocalMap, params: &MappingParams) -> Vec<ScaleChange> {
    let is_asked = !map.sensor.is_rolling() && params.readout_sigma > 0.0;
    let rolling = is_asked.then(|| with_shutter(map, params)).flatten();
    let at_once = |map: &mut LocalMap| optimise_all(map, params.calibration_iterations, params, &|| false);
    let Some((rolling, changes)) = rolling else { return at_once(map) };
    let reads_rows = rolling.sensor.readout[0] == 0.0;
    if !reads_rows {
        let otherwise = at_once(map);
        if left(&rolling) >= OTHER_SHUTTER * left(map) {
            return otherwise;
        }
    }
    *map = rolling;
    changes
}

/// The map with a rolling shutter, where its readout can be that of one.
fn with_shutter(map: &LocalMap, params: &MappingParams) -> Option<(LocalMap, Vec<ScaleChange>)> {
    let (iterations, stop) = (params.calibration_iterations, || false);
    let mut rolling = map.clone();
    let changes = optimise_whole(&mut rolling, iterations, [params.readout_sigma; 2], params, &stop);
    let readout = rolling.sensor.plausible_readout();
    rolling.set_sensor(rolling.sensor.with_readout(readout));
    if !rolling.sensor.is_rolling() {
        return None;
    }
    let changes = together(changes, optimise_all(&mut rolling, iterations, params, &stop));
    Some((rolling, changes))
}

/// The robust cost that is left of all that a map's keyframes see.
fn left(map: &LocalMap) -> f64 {
    let Window { problem, pairs, .. } = Window::build(map, &(0..map.keyframes.len()).collect(), 0);
    problem.cost(&pairs, &pairs.relative(&problem.frames))
}

/// Changes that follow each other as one, in order of the keyframes.
fn together(first: Vec<ScaleChange>, then: Vec<ScaleChange>) -> Vec<ScaleChange> {
    let mut factors = BTreeMap::new();
    for ScaleChange { keyframe, factor } in first.into_iter().chain(then) {
        *factors.entry(keyframe).or_insert(1.0) *= factor;
    }
    factors.into_iter().map(|(keyframe, factor)| ScaleChange { keyframe, factor }).collect()
}

fn optimise_whole(
    map: &mut LocalMap,
    iterations: usize,
    [columns, rows]: [f64; 2],
    params: &MappingParams,
    stop: &dyn Fn() -> bool,
) -> Vec<ScaleChange> {
    let observations = observations(map);
    let all: usize = observations.iter().sum();
    if all as f64 > 1e6 * params.whole {
        return optimise_parts(map, &observations, iterations, params, stop);
    }
    let active: BTreeSet<usize> = (0..map.keyframes.len()).collect();
    let is_known = active.len() < params.calibrate_from;
    let sigma = [params.lens_sigma, columns, rows].map(|sigma| if is_known { 0.0 } else { sigma });
    optimise(map, &active, 0, sigma, |problem| {
        let affordable = 1e6 * params.final_effort / problem.observations.len().max(1) as f64;
        Limits { iterations: iterations.min(affordable as usize).max(1), stop }
    })
}

/// Optimises all keyframes and points in parts of successive keyframes, each held by what surrounds it, and then once more in
/// parts that begin in the middle of the first ones. What was learnt of the sensor from so large a map stays.
fn optimise_parts(
    map: &mut LocalMap,
    observations: &[usize],
    iterations: usize,
    params: &MappingParams,
    stop: &dyn Fn() -> bool,
) -> Vec<ScaleChange> {
    const SWEEPS: usize = 2;
    let size = (0.5e6 * params.whole) as usize;
    let all: usize = observations.iter().sum();
    let affordable = 1e6 * params.final_effort / (SWEEPS * all) as f64;
    let limits = || Limits { iterations: iterations.min(affordable as usize).max(1), stop };
    let mut changes = Vec::new();
    for first in [0, size / 2] {
        for part in parts(observations, first, size) {
            if stop() {
                return changes;
            }
            let of_part = optimise(map, &part.collect(), usize::MAX, [0.0; UNKNOWNS], |_| limits());
            changes = together(changes, of_part);
        }
    }
    changes
}

/// How many observations the points of each keyframe have.
fn observations(map: &LocalMap) -> Vec<usize> {
    let of = |keyframe: &KeyframeState| keyframe.points.iter().map(|point| point.observations.len()).sum();
    map.keyframes.iter().map(|keyframe| of(keyframe)).collect()
}

/// Successive keyframes in parts of `size` observations or somewhat more, but of `first` in the first part, if that is any.
fn parts(observations: &[usize], first: usize, size: usize) -> Vec<Range<usize>> {
    let (mut parts, mut begun, mut count) =
        (Vec::new(), 0, size.saturating_sub(first) * usize::from(first > 0));
    for (keyframe, own) in observations.iter().enumerate() {
        count += own;
        if count >= size {
            parts.push(begun..keyframe + 1);
            (begun, count) = (keyframe + 1, 0);
        }
    }
    parts.push(begun..observations.len());
    parts.retain(|part| !part.is_empty());
    parts
}

fn optimise<'a>(
    map: &mut LocalMap,
    active: &BTreeSet<usize>,
    max_fixed: usize,
    sensor_sigma: [f64; UNKNOWNS],
    limits: impl FnOnce(&Problem) -> Limits<'a>,
) -> Vec<ScaleChange> {
    let mut window = Window::build(map, active, max_fixed);
    if sensor_sigma.iter().any(|sigma| *sigma > 0.0) {
        window.calibrate(map, sensor_sigma);
    }
    let before = window.frame_depths();
    let limits = limits(&window.problem);
    if solve_within(&mut window.problem, &window.pairs, &limits).is_err() {
        // Without the memory for it the map stays as it is.
        return Vec::new();
    }
    let changes = window.scale_changes(&before);
    let by_poses =
        (active.len() <= MOST_BY_POSES).then(|| variances_by_poses(&window.problem, &window.pairs));
    window.apply(map, by_poses.flatten().as_deref());
    for change in &changes {
        map.keyframes[change.keyframe].scale *= change.factor;
    }
    changes
}

/// How lengths around a keyframe changed in an optimisation: its scale (see [`KeyframeState::scale`]) is `factor` times
/// what it was.
///
/// [`KeyframeState::scale`]: crate::local_map::KeyframeState::scale
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ScaleChange {
    pub keyframe: usize,
    pub factor: f64,
}

/// Drops points of the `hosts` that tracked frames look for in vain.
pub(crate) fn cull_unfound(map: &mut LocalMap, hosts: impl IntoIterator<Item = usize>, share: f32) {
    for host in hosts {
        for point in map.keyframes[host].points.iter_mut().filter(|p| p.alive && p.searched >= 8) {
            if (point.found as f32) < share * point.searched as f32 {
                point.alive = false;
            }
        }
    }
}

/// Drops the points of keyframes that share points with `keyframe`, and its own, that prove to move with the camera.
pub(crate) fn cull_masked(map: &mut LocalMap, keyframe: usize) {
    if map.mask.is_empty() {
        return;
    }
    let mask = Arc::clone(&map.mask);
    let is_masked = |point: &PointState| point.alive && mask.covers_at(point.pixel);
    let hosts: Vec<usize> = map.covisible(keyframe).into_iter().map(|c| c.0).chain([keyframe]).collect();
    for host in hosts {
        // What is not changed stays shared.
        if map.keyframes[host].points.iter().any(is_masked) {
            let points = map.keyframes[host].points.iter_mut();
            points.filter(|point| is_masked(point)).for_each(|point| point.alive = false);
        }
    }
}

/// Median length of the matched points' way from the keyframe to the frame, pixels: in all, and what is
/// left of it without the turn.
pub(crate) fn median_flow(
    camera: &Pinhole,
    points: &[ReferencePoint],
    frame_from_reference: &Se3,
) -> Option<(f32, f32)> {
    let rotation = frame_from_reference.rotation_matrix();
    let (mut all, mut moved): (Vec<f32>, Vec<f32>) = (Vec::new(), Vec::new());
    for point in points {
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
