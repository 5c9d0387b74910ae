//! Whether the scale of a map is carried from its keyframes to those that come after them.
//!
//! A keyframe takes its unit from points of known depth that it shares with older ones. Where a camera turns on the spot, or sees little, few
//! are shared, and what is matched there may agree by chance: matches are sought around their predictions, so a wrong scale confirms itself.
//! Here each point whose depth one side of a cut knows by itself tells the length of the camera's way on the other side, by how far it
//! moved in an image there. True points agree with the map about that length; those that match by chance are spread evenly over what is searched.

use crate::local_map::{KeyframeState, LocalMap, PointRef, PointState};
use crate::params::Params;
use crate::window::{mahalanobis, predict};
use map::{Edge, KeyframeId, Shared};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;

/// Standard deviation of the logarithm of a length up to which a point tells it.
const TELLS: f64 = PointState::KNOWN;
/// A point agrees with the map within one such deviation, or within a third of the pixels around its prediction that it is searched in, if that
/// is less. Three times as far it still may be one that does (68 and 99.7 % of what errs by `TELLS`), and of what matches by chance a third
/// lies in the inner range.
const AGREES: f64 = TELLS;
const BY_CHANCE: f64 = 1.0 / 3.0;
/// Probability of so much agreement by chance, below which the scale is carried.
const SIGNIFICANT: f64 = 0.01;
/// Points of known depth on either side of a break: as many as a pose has unknowns, or nothing goes on there in a scale of its own.
const LEAST: usize = 6;
/// Points asked at a cut at most.
const MOST: usize = 300;
/// Cuts looked at at once.
const AT_ONCE: usize = 256;
/// The pixel that a depth or a length is measured from is as uncertain as the one where it is seen.
const BOTH_ENDS: f64 = 0.5;
/// Steps of Gauss–Newton on a depth, which begins where the map has it.
const STEPS: usize = 6;

/// Where the scale of a map is not carried on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ScaleBreak {
    /// The last keyframe before it.
    #[serde(skip)]
    pub before: KeyframeId,
    /// Points that measure the scale across it, within three deviations of the map's.
    pub points: usize,
    /// Those of them within one deviation, the inliers: no more than chance gives.
    pub inliers: usize,
}

impl ScaleBreak {
    /// How little the points measure, for people.
    pub fn text(&self) -> String {
        match self.points {
            0 => "no point that was seen before measures it".to_owned(),
            points => {
                format!("{} of {points} points that measure it agree, no more than by chance", self.inliers)
            }
        }
    }

    /// Whether it is not at or beside the keyframe where the last one was found.
    pub(crate) fn is_apart_from(&self, last: Option<KeyframeId>) -> bool {
        last.is_none_or(|last| self.before.0.abs_diff(last.0) > 1)
    }
}

/// How well the scale is known that is carried over a cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleDeviation {
    /// The last keyframe before it.
    pub before: KeyframeId,
    /// Standard deviation of the logarithm of the scale on one side over that on the other.
    pub deviation: f64,
}

/// How the scale of a map is carried on from keyframe to keyframe.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CarriedScale {
    /// Where it is not, in order; of cuts beside each other the one that fewest points agree across. On either side there are six
    /// points of known depth, or more.
    pub breaks: Vec<ScaleBreak>,
    /// How well it is known at the cuts that at least as many points measure, in order. A cut that a loop spans is not among them, nor
    /// one with too little on either side.
    pub deviations: Vec<ScaleDeviation>,
}

/// Keyframes behind a cut after which most of what tells the scale across it was seen.
const SETTLED: usize = 8;
/// Keyframes before it whose points are asked while the camera is tracked.
const RECENT: usize = 40;

/// How the scale of a map is carried on. A loop in `closed` carries it over what it spans.
pub(crate) fn carried_scale(map: &LocalMap, closed: &[Edge], params: &Params) -> CarriedScale {
    let cuts = map.keyframes.len().saturating_sub(1);
    let mut carried = CarriedScale::default();
    let mut last = None;
    for begin in (0..cuts).step_by(AT_ONCE) {
        let spanning = spanning(map, begin..(begin + AT_ONCE).min(cuts), 0);
        let found = spanning.par_iter().enumerate();
        let found: Vec<_> = found.map(|(i, points)| across(map, closed, begin + i, points, params)).collect();
        for (cut, across) in (begin..).zip(found).filter_map(|(cut, across)| Some((cut, across?))) {
            carried.deviations.extend(across.deviation());
            let Some(found) = across.scale_break() else { continue };
            let is_beside = last.replace(cut).is_some_and(|last| last + 1 == cut);
            match carried.breaks.last_mut().filter(|_| is_beside) {
                Some(beside) if beside.inliers <= found.inliers => {}
                Some(beside) => *beside = found,
                None => carried.breaks.push(found),
            }
        }
    }
    carried
}

/// The same of one cut, some keyframes before the newest: told once, while the camera is tracked.
pub(crate) fn newest_scale_break(map: &LocalMap, closed: &[Edge], params: &Params) -> Option<ScaleBreak> {
    let cut = map.keyframes.len().checked_sub(1 + SETTLED)?;
    break_behind(map, closed, cut, cut.saturating_sub(RECENT), params)
}

/// The same of the cut behind a keyframe, by all points that are seen on both sides.
pub(crate) fn scale_break_behind(
    map: &LocalMap,
    closed: &[Edge],
    before: KeyframeId,
    params: &Params,
) -> Option<ScaleBreak> {
    break_behind(map, closed, before.0 as usize, 0, params)
}

/// The same by points of keyframes from `first` on.
fn break_behind(
    map: &LocalMap,
    closed: &[Edge],
    cut: usize,
    first: usize,
    params: &Params,
) -> Option<ScaleBreak> {
    let points = spanning(map, cut..cut + 1, first);
    across(map, closed, cut, &points[0], params)?.scale_break()
}

/// Whether a loop joins keyframes of both sides.
fn spans(closed: &Edge, cut: usize) -> bool {
    let (first, last) = (closed.from.min(closed.to), closed.from.max(closed.to));
    first <= LocalMap::id(cut) && last > LocalMap::id(cut)
}

/// For each of the cuts, which lie behind the keyframes of these indices, the points of keyframes from `first` on that are seen on both
/// sides.
fn spanning(map: &LocalMap, cuts: Range<usize>, first: usize) -> Vec<Vec<PointRef>> {
    let mut points = vec![Vec::new(); cuts.len()];
    for (host, state) in map.keyframes.iter().enumerate().skip(first) {
        for (index, point) in state.points.iter().enumerate().filter(|(_, point)| may_tell(point)) {
            let seen = point.observations.iter().map(|seen| seen.keyframe);
            let (begin, end) = seen.fold((host, host), |(a, b), keyframe| (a.min(keyframe), b.max(keyframe)));
            let spanned = begin.max(cuts.start)..end.min(cuts.end);
            spanned.for_each(|cut| points[cut - cuts.start].push(PointRef { host, index }));
        }
    }
    points
}

/// Whether all views together know a point's depth well enough: those of one side know it less.
fn may_tell(point: &PointState) -> bool {
    point.alive && point.observations.len() >= 2 && point.variance <= (TELLS * point.inverse_depth).powi(2)
}

/// What points tell of the scale across a cut.
struct Across {
    /// The last keyframe before it.
    before: KeyframeId,
    /// Lengths that lie within three deviations of the map's, each with how far it is off in units of the range within which a point agrees.
    measured: Vec<(Length, f64)>,
}

/// What the points seen on both sides of a cut tell of its scale; nothing where a loop spans it, or one side has no scale of its own.
fn across(
    map: &LocalMap,
    closed: &[Edge],
    cut: usize,
    points: &[PointRef],
    params: &Params,
) -> Option<Across> {
    let (before, after) = map.keyframes.split_at(cut + 1);
    let is_enough = |side: &[Shared<KeyframeState>]| {
        let known = side.iter().flat_map(|state| &state.points).filter(|p| p.alive && p.is_known());
        known.take(LEAST).count() == LEAST
    };
    if closed.iter().any(|closed| spans(closed, cut)) || !is_enough(before) || !is_enough(after) {
        return None;
    }
    let step = points.len().div_ceil(MOST).max(1);
    let lengths = points.iter().step_by(step).filter_map(|&at| length_across(map, cut, at));
    let relative = |length: Length| {
        let off = length.log.abs() / AGREES.min(BY_CHANCE * f64::from(params.track.max_shift) / length.flow);
        (length, off)
    };
    let measured = lengths.map(relative).filter(|(_, off)| *off <= BY_CHANCE.recip()).collect();
    Some(Across { before: LocalMap::id(cut), measured })
}

impl Across {
    /// The break, if the points agree no more than by chance.
    fn scale_break(&self) -> Option<ScaleBreak> {
        let points = self.measured.len();
        let inliers = self.measured.iter().filter(|(_, off)| *off <= 1.0).count();
        let is_carried = at_least_by_chance(inliers, points) <= SIGNIFICANT;
        (!is_carried).then_some(ScaleBreak { before: self.before, points, inliers })
    }

    /// How well the scale is known: to the deviation of the points' weighted mean, by their spread where that is larger than stated, and
    /// no better than that mean agrees with the map. `None` of fewer than [`LEAST`] points.
    fn deviation(&self) -> Option<ScaleDeviation> {
        let lengths = || self.measured.iter().map(|(length, _)| (length.sigma.powi(-2), length.log));
        let weight: f64 = lengths().map(|(weight, _)| weight).sum();
        let mean = lengths().map(|(weight, log)| weight * log).sum::<f64>() / weight;
        let cost: f64 = lengths().map(|(weight, log)| weight * (log - mean).powi(2)).sum();
        let spread = (cost / self.measured.len() as f64).max(1.0);
        let deviation = mean.hypot((spread / weight).sqrt());
        (self.measured.len() >= LEAST).then_some(ScaleDeviation { before: self.before, deviation })
    }
}

/// Probability that at least so many of `count` points agree by chance: the tail of a binomial distribution.
fn at_least_by_chance(inliers: usize, count: usize) -> f64 {
    let odds = BY_CHANCE / (1.0 - BY_CHANCE);
    let mut term = (1.0 - BY_CHANCE).powi(count as i32);
    let mut fewer = 0.0;
    for i in 0..inliers {
        fewer += term;
        term *= odds * (count - i) as f64 / (i + 1) as f64;
    }
    (1.0 - fewer).max(0.0)
}

/// Where a keyframe sees a point.
#[derive(Clone, Copy)]
struct View {
    keyframe: usize,
    /// As an ideal camera there sees it.
    pixel: [f64; 2],
    /// Information `[xx, xy, yy]` of a length or a depth's pixel there, 1/px².
    information: [f64; 3],
}

/// The length of the camera's way to a view, by a point of known depth.
#[derive(Clone, Copy)]
struct Length {
    /// Its logarithm, less that of the map's, to first order.
    log: f64,
    /// Standard deviation of that, with what the depth is uncertain by.
    sigma: f64,
    /// By so many pixels the point moves in the view as it grows by one.
    flow: f64,
}

/// The length of the camera's way on one side of a cut, by a point of which the other side knows the depth; `None` if it tells too little.
fn length_across(map: &LocalMap, cut: usize, at: PointRef) -> Option<Length> {
    let point = map.point(at);
    let host = &map.keyframes[at.host];
    let world = host.camera_from_world.inverse() * (point.ray / point.inverse_depth);
    let views = views(map, at);
    let (before, after) = views.split_at(views.partition_point(|view| view.keyframe <= cut));
    let (known, others, from) =
        if before.len() >= 2 { (before, after, cut) } else { (after, before, cut + 1) };
    let (world, depth_sigma) = depth_by(map, known, &world)?;
    let lengths = others.iter().filter_map(|view| length_by(map, view, &world, from));
    let best = lengths.min_by(|a, b| a.sigma.total_cmp(&b.sigma))?;
    let sigma = depth_sigma.hypot(best.sigma);
    (sigma <= TELLS).then_some(Length { sigma, ..best })
}

/// All views of a point in order of the keyframes.
fn views(map: &LocalMap, at: PointRef) -> Vec<View> {
    let point = map.point(at);
    let seen: Vec<View> = point
        .observations
        .iter()
        .map(|seen| View {
            keyframe: seen.keyframe,
            pixel: map.undistorted_pixel(seen.keyframe, seen.pixel, inverse_depth_in(map, at, seen.keyframe)),
            information: seen.information.map(|v| BOTH_ENDS * f64::from(v)),
        })
        .collect();
    // The host's own patch is what the others are compared with.
    let best = |a: [f64; 3], b: [f64; 3]| if a[0] + a[2] >= b[0] + b[2] { a } else { b };
    let information = seen.iter().map(|view| view.information).reduce(best);
    let own = map.camera.project(&point.ray);
    let host = information.map(|information| View { keyframe: at.host, pixel: own.into(), information });
    let mut views: Vec<View> = seen.into_iter().chain(host).collect();
    views.sort_by_key(|view| view.keyframe);
    views
}

/// The inverse depth of a point in a keyframe's camera.
fn inverse_depth_in(map: &LocalMap, at: PointRef, keyframe: usize) -> f64 {
    let point = map.point(at);
    let relative =
        map.keyframes[keyframe].camera_from_world * map.keyframes[at.host].camera_from_world.inverse();
    let depth = (relative.rotation * point.ray + relative.translation * point.inverse_depth).z;
    if depth > 0.0 { point.inverse_depth / depth } else { point.inverse_depth }
}

/// The world point that views by themselves see, from where the map has it, and the relative standard deviation of its depth.
fn depth_by(map: &LocalMap, views: &[View], world: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let (first, others) = views.split_first()?;
    let first_from_world = map.keyframes[first.keyframe].camera_from_world;
    let world_from_first = first_from_world.inverse();
    let ray = map.camera.unproject(first.pixel[0], first.pixel[1]);
    let relative = |view: &View| {
        let relative = map.keyframes[view.keyframe].camera_from_world * world_from_first;
        (relative.rotation_matrix(), relative.translation)
    };
    let relatives: Vec<_> = others.iter().map(relative).collect();
    let mut inverse_depth = (first_from_world * *world).z.recip();
    let mut fit = Fit::default();
    for _ in 0..STEPS {
        fit = Fit::default();
        for (view, (rotation, shift)) in others.iter().zip(&relatives) {
            let p = predict(&map.camera, rotation, shift, &ray, inverse_depth, &view.pixel)?;
            fit.add(p.residual, p.by_inverse_depth, &view.information);
        }
        inverse_depth += fit.step()?;
        if !(inverse_depth > 0.0 && inverse_depth.is_finite()) {
            return None;
        }
    }
    let sigma = fit.sigma()? / inverse_depth;
    (sigma <= TELLS).then(|| (world_from_first * (ray / inverse_depth), sigma))
}

/// The length of the way between a keyframe and a view of a point.
fn length_by(map: &LocalMap, view: &View, world: &Vector3<f64>, from: usize) -> Option<Length> {
    let eye = map.keyframes[from].camera_from_world.inverse().translation;
    let pose = map.keyframes[view.keyframe].camera_from_world;
    // As the way becomes longer, what is seen moves back along it.
    let (seen, back) = (pose * *world, pose * eye);
    let p = predict(&map.camera, &Matrix3::identity(), &back, &seen, 0.0, &view.pixel)?;
    let mut fit = Fit::default();
    fit.add(p.residual, p.by_inverse_depth, &view.information);
    let [u, v] = p.by_inverse_depth;
    Some(Length { log: fit.step()?, sigma: fit.sigma()?, flow: u.hypot(v) })
}

/// Least squares for one unknown.
#[derive(Clone, Copy, Default)]
struct Fit {
    hessian: f64,
    gradient: f64,
    cost: f64,
    count: f64,
}

impl Fit {
    /// Adds a residual, its derivative by the unknown, and its information.
    fn add(&mut self, e: [f64; 2], j: [f64; 2], information: &[f64; 3]) {
        let [a, b, c] = information;
        let w = [a * j[0] + b * j[1], b * j[0] + c * j[1]];
        self.hessian += w[0] * j[0] + w[1] * j[1];
        self.gradient += w[0] * e[0] + w[1] * e[1];
        self.cost += mahalanobis(&e, information);
        self.count += 1.0;
    }

    /// What is to be added to the unknown.
    fn step(&self) -> Option<f64> {
        (self.hessian > 0.0).then(|| -self.gradient / self.hessian)
    }

    /// Standard deviation of the unknown: that of the residuals, where they are larger than assumed.
    fn sigma(&self) -> Option<f64> {
        let left = self.cost - self.gradient * self.gradient / self.hessian;
        (self.hessian > 0.0).then(|| ((left / self.count).max(1.0) / self.hessian).sqrt())
    }
}

#[cfg(test)]
mod tests;
