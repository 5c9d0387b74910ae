//! Similarities from samples of matches, and the best of them.

use super::error::{both_directions, projected, squared};
use super::{GeneralisedPoseParams, Pool};
use geometry::pnp::{self, p3p};
use geometry::{Sampler, Sim3, samples_needed};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Key points that must agree with a keyframe's pose, those that it comes from with them, before its scale is asked for.
const MIN_SUPPORT: usize = 5;
/// Matches that are asked for the scale of a pose.
const SCALES: usize = 6;

/// Matches that samples are drawn from and scored by at most: evenly spread ones of many. As many say as well as all
/// what is right, and the time does not grow with the texture.
const MAX_MATCHES: usize = 500;
/// How sure it should be that one sample was free of wrong matches.
const CONFIDENCE: f64 = 0.999;

/// The similarity target_from_source of least cost among those of all samples.
pub(super) fn search(pool: &Pool, sampler: &mut Sampler, params: &GeneralisedPoseParams) -> Option<Sim3> {
    let step = pool.matches.len().div_ceil(MAX_MATCHES).max(1);
    let matches = pool.matches.iter().step_by(step).copied().collect();
    let pool = &Pool { views: pool.views.clone(), matches };
    let mut best: Option<(f64, Sim3)> = None;
    for to in [1, 0] {
        let by_view = of_each_view(pool, to);
        let all: Vec<usize> = by_view.values().flatten().copied().collect();
        if all.is_empty() {
            continue;
        }
        let mut support = MIN_SUPPORT;
        let (mut samples, mut needed) = (0, params.max_samples.max(1));
        while samples < needed {
            samples += 1;
            // Keyframes of many matches are drawn more often.
            let view = pool.matches[all[sampler.below(all.len())]].sides[to].view;
            let own = &by_view[&view];
            if own.len() < MIN_SUPPORT {
                continue;
            }
            let drawn = sampler.sample::<3>(own.len()).map(|i| own[i]);
            let sample = Sample { view, own, drawn };
            for to_from in poses(pool, to, &sample, &mut support, sampler, params) {
                let motion = if to == 1 { to_from } else { to_from.inverse() };
                let cost = cost(pool, &motion, params);
                if motion.is_valid() && best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, motion));
                    // Every match that does not agree costs the gate.
                    let share = 1.0 - cost / (params.gate * pool.matches.len() as f64);
                    let enough = samples_needed(share, 4, CONFIDENCE);
                    needed = needed.min(enough.max(1.0).min(params.max_samples as f64) as usize);
                }
            }
        }
    }
    best.map(|(_, motion)| motion)
}

/// The matches with depth on the other side, by the views of side `to`.
fn of_each_view(pool: &Pool, to: usize) -> BTreeMap<usize, Vec<usize>> {
    let mut by_view: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (index, m) in pool.matches.iter().enumerate() {
        if m.sides[1 - to].point.is_some() {
            by_view.entry(m.sides[to].view).or_default().push(index);
        }
    }
    by_view
}

/// Three matches of one keyframe.
struct Sample<'a> {
    /// The keyframe.
    view: usize,
    /// All matches of that keyframe, by index.
    own: &'a [usize],
    /// The three that were drawn.
    drawn: [usize; 3],
}

/// The similarities, to side `to` from the other, that a sample allows: poses of its keyframe with scales that other matches
/// tell. `support` is the most key points that agreed with one so far; poses with which not half as many do are not worth a
/// scale.
fn poses(
    pool: &Pool,
    to: usize,
    &Sample { view, own, drawn }: &Sample,
    support: &mut usize,
    sampler: &mut Sampler,
    params: &GeneralisedPoseParams,
) -> Vec<Sim3> {
    let sightings = drawn.map(|index| {
        let sides = &pool.matches[index].sides;
        let point = sides[1 - to].point.map_or(Vector3::zeros(), |point| point.position);
        pnp::Sighting { point, ray: sides[to].ray }
    });
    let mut found = Vec::new();
    for pose in p3p([&sightings[0], &sightings[1], &sightings[2]]) {
        // Seen from one keyframe the scale does not show.
        let unscaled = pool.views[to][view].side_from_view * Sim3::from(pose);
        let agrees = |index: &&usize| {
            projected(pool, &pool.matches[**index], to, &unscaled, params)
                .is_some_and(|seen| seen.squared() <= params.gate)
        };
        let consistent: Vec<usize> = own.iter().filter(agrees).copied().collect();
        let mut features: Vec<u32> =
            consistent.iter().map(|&index| pool.matches[index].sides[to].feature).collect();
        features.sort_unstable();
        features.dedup();
        if features.len() < MIN_SUPPORT || 2 * features.len() < *support {
            continue;
        }
        *support = features.len().max(*support);
        for _ in 0..SCALES {
            // Half of them among those that agree already, half among all.
            let index = match sampler.below(2) {
                0 => consistent[sampler.below(consistent.len())],
                _ => sampler.below(pool.matches.len()),
            };
            let centre = pool.views[to][view].side_from_view.translation;
            found.extend(scaled(pool, to, &unscaled, &centre, index));
        }
    }
    found
}

/// `unscaled`, scaled about `centre` such that a match fits best: its depth there, or where two rays meet.
fn scaled(pool: &Pool, to: usize, unscaled: &Sim3, centre: &Vector3<f64>, index: usize) -> Option<Sim3> {
    let sides = &pool.matches[index].sides;
    let (there, here) = (&sides[to], &sides[1 - to]);
    let seen_from = &pool.views[to][there.view].side_from_view;
    let scale = match (there.point, here.point) {
        // A depth on both sides tells it alone.
        (Some(there), Some(here)) => {
            let (a, b) = (there.position - centre, *unscaled * here.position - centre);
            (a.norm() / b.norm()).is_finite().then(|| a.dot(&b) / b.norm_squared())
        }
        // centre + s b on the other keyframe's ray.
        (None, Some(here)) => {
            let ray = seen_from.rotation * there.ray;
            intersection(&ray, &(*unscaled * here.position - centre), &(seen_from.translation - centre))
        }
        // The point on the ray from centre + s b.
        (Some(there), None) => {
            let view = &pool.views[1 - to][here.view].side_from_view;
            let ray = unscaled.rotation * (view.rotation * here.ray);
            intersection(&ray, &(*unscaled * view.translation - centre), &(there.position - centre))
        }
        (None, None) => None,
    }?;
    let about = Sim3 { scale, translation: centre * (1.0 - scale), ..Sim3::identity() };
    let motion = about * *unscaled;
    (scale > 0.0 && motion.is_valid()).then_some(motion)
}

/// s for which `s b − c` is along `ray`, in least squares; `None` where b is along it.
fn intersection(ray: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Option<f64> {
    let (across, offset) = (ray.cross(b), ray.cross(c));
    let parallax = across.norm() / (ray.norm() * b.norm());
    // Rays closer than this to each other tell no scale; it is about half a pixel.
    (parallax > 1e-3).then(|| across.dot(&offset) / across.norm_squared())
}

/// Sum of the squared errors, each cut off at the gate.
fn cost(pool: &Pool, target_from_source: &Sim3, params: &GeneralisedPoseParams) -> f64 {
    let motions = both_directions(target_from_source);
    pool.matches.iter().map(|m| squared(pool, m, &motions, params).min(params.gate)).sum()
}
