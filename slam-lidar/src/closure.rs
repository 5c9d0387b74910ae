//! Two submaps brought together, and what speaks for it.

use crate::degeneracy::{Conditioning, conditioning};
use crate::keyframe::{Seen, Submap, transformed};
use crate::motion::{Sweep, SweepMotion};
use crate::registration::{Prediction, RegistrationParams, agreement, register};
use crate::surfaces::SurfaceMap;
use geometry::Se3;
use nalgebra::{Matrix6, UnitQuaternion, Vector3};

/// What speaks for a pose between two submaps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evidence {
    /// Share of the one's points that lie on a surface the other saw, the lesser of both ways.
    pub overlap: f64,
    /// Of the points that the other map can judge, the share that lie where it saw free space; the larger of both ways.
    pub violated: f64,
    /// Share of the points which surfaces of the other hold that agree with them, the lesser of both ways.
    pub inlier_ratio: f64,
    /// Root mean square distance of points from the surfaces that they agree with, metres.
    pub rmse: f64,
    /// How well the pose is determined.
    pub conditioning: Conditioning,
}

/// A pose between two submaps.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// `target_from_source`.
    pub target_from_source: Se3,
    /// Its information, tangent (υ, ω) at the source's origin in the axes of the target.
    pub information: Matrix6<f64>,
    /// What speaks for it.
    pub evidence: Evidence,
}

/// Translations tried around a guess, metres: lanes lie a few metres apart.
const OFFSETS: [f64; 5] = [-4.0, -2.0, 0.0, 2.0, 4.0];
/// Headings tried around a guess, radians: half a sector of a Scan Context.
const TURNED: [f64; 3] = [-0.05, 0.0, 0.05];
/// So many starts are registered.
const REGISTERED: usize = 3;
/// Every so many points find the start.
const EVERY: usize = 4;

/// Registers `source` in `target` from guesses of `target_from_source`; `wide` tries translations around them.
pub fn align(target: &Submap, source: &Submap, guess: &Se3, wide: bool) -> Alignment {
    aligned(target, source, &search(target, &source.points, guess, wide))
}

/// A pose that was found, with its evidence.
pub(crate) fn aligned(target: &Submap, source: &Submap, found: &Found) -> Alignment {
    let Found { pose, information, rmse, .. } = *found;
    Alignment {
        target_from_source: pose,
        information,
        evidence: evidence(target, source, &pose, &information, rmse),
    }
}

/// A pose at which points fit a submap, not judged yet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    /// Share of the points that agree, each counted by its weight in the kernel.
    pub score: f64,
    /// `target_from_source`.
    pub pose: Se3,
    /// As in [`Alignment`].
    pub information: Matrix6<f64>,
    /// Root mean square distance of the points that agree, metres.
    pub rmse: f64,
}

/// Registers points in `target` from guesses of `target_from_source`; `wide` tries translations around them.
pub(crate) fn search(target: &Submap, points: &[[f32; 3]], guess: &Se3, wide: bool) -> Found {
    let sweep = rigid(points);
    let (all, some) = (every(points, 1), every(points, EVERY));
    let params = RegistrationParams::default();
    let starts = if wide { starts(&sweep, &some, target, guess, &params) } else { vec![*guess] };
    let found = starts.iter().map(|start| {
        let coarse = converge(&sweep, &some, &target.coarse, start, &params).0;
        fine(&sweep, &all, target, &coarse, &params)
    });
    let nothing = Found { score: 0.0, pose: *guess, information: Matrix6::zeros(), rmse: f64::INFINITY };
    found.reduce(better).unwrap_or(nothing)
}

/// As [`search`], for many guesses: only the best of the starts is registered on fine surfaces, with fewer points.
pub(crate) fn coarse_search(target: &Submap, points: &[[f32; 3]], guess: &Se3, wide: bool) -> Found {
    let sweep = rigid(points);
    let (half, some) = (every(points, 2), every(points, EVERY));
    let params = RegistrationParams::default();
    let starts = if wide { starts(&sweep, &some, target, guess, &params) } else { vec![*guess] };
    let coarse = starts.iter().map(|start| {
        let pose = converge(&sweep, &some, &target.coarse, start, &params).0;
        let score = agreement(&sweep, &some, &target.fine, &SweepMotion::resting(pose), 2.0 * params.kernel);
        (score, pose)
    });
    let best = coarse.reduce(|a, b| if b.0 > a.0 { b } else { a }).map_or(*guess, |(_, pose)| pose);
    fine(&sweep, &half, target, &best, &params)
}

fn better(a: Found, b: Found) -> Found {
    if b.score > a.score { b } else { a }
}

fn every(points: &[[f32; 3]], step: usize) -> Vec<u32> {
    (0..points.len() as u32).step_by(step).collect()
}

/// The best of many translations and headings around a guess.
fn starts(
    sweep: &Sweep,
    used: &[u32],
    target: &Submap,
    guess: &Se3,
    params: &RegistrationParams,
) -> Vec<Se3> {
    let mut starts = Vec::new();
    for (x, y, yaw) in
        OFFSETS.iter().flat_map(|&x| OFFSETS.iter().flat_map(move |&y| TURNED.map(|yaw| (x, y, yaw))))
    {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
        let start = Se3::new(rotation * guess.rotation, guess.translation + Vector3::new(x, y, 0.0));
        let score = agreement(sweep, used, &target.coarse, &SweepMotion::resting(start), 2.0 * params.kernel);
        starts.push((score, start));
    }
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.truncate(REGISTERED);
    starts.into_iter().map(|(_, start)| start).collect()
}

fn fine(sweep: &Sweep, used: &[u32], target: &Submap, start: &Se3, params: &RegistrationParams) -> Found {
    let (pose, information, rmse) = converge(sweep, used, &target.fine, start, params);
    let score = agreement(sweep, used, &target.fine, &SweepMotion::resting(pose), params.kernel);
    Found { score, pose, information, rmse }
}

fn rigid(points: &[[f32; 3]]) -> Sweep {
    Sweep { points: points.to_vec(), shares: vec![0.5; points.len()], ..Sweep::default() }
}

fn converge(
    sweep: &Sweep,
    used: &[u32],
    map: &SurfaceMap,
    start: &Se3,
    params: &RegistrationParams,
) -> (Se3, Matrix6<f64>, f64) {
    let motion = SweepMotion::resting(*start);
    let prediction = Prediction { motion, begin: (5.0, 0.5), displacement: (1e-6, 1e-6) };
    let found = register(sweep, used, map, &prediction, params);
    (found.motion.begin, found.information, found.rmse)
}

/// Judges a pose, whoever found it.
fn evidence(target: &Submap, source: &Submap, pose: &Se3, information: &Matrix6<f64>, rmse: f64) -> Evidence {
    let back = pose.inverse();
    let (one, other) = (judge(target, source, pose), judge(source, target, &back));
    Evidence {
        overlap: one.0.min(other.0),
        violated: one.1.max(other.1),
        inlier_ratio: held(target, source, pose).min(held(source, target, &back)),
        rmse,
        conditioning: conditioning(information),
    }
}

/// Share of the source's points on surfaces that the target saw, and of those it can judge the share in free space.
fn judge(target: &Submap, source: &Submap, pose: &Se3) -> (f64, f64) {
    let (mut surface, mut free) = (0.0, 0.0);
    for &p in &source.points {
        match target.look(transformed(pose, p)) {
            Seen::Surface => surface += 1.0,
            Seen::Free => free += 1.0,
            Seen::Hidden => {}
        }
    }
    (surface / source.points.len().max(1) as f64, free / f64::max(surface + free, 1.0))
}

/// Of the points within voxels that know a surface, the share within three standard deviations of it.
pub(crate) fn held(target: &Submap, source: &Submap, pose: &Se3) -> f64 {
    let (asked, within) = counted(target, &source.points, pose);
    within as f64 / asked.max(1) as f64
}

/// Points within voxels of the target that know a surface, and of these, those within three standard deviations of it.
pub(crate) fn counted(target: &Submap, points: &[[f32; 3]], pose: &Se3) -> (usize, usize) {
    let (mut asked, mut within) = (0, 0);
    for &p in points {
        let q = transformed(pose, p);
        let Some(surface) = target.fine.surface_at(q) else { continue };
        asked += 1;
        let off = |n: [f32; 3]| (0..3).map(|i| n[i] * (q[i] - surface.mean[i])).sum::<f32>();
        let fits = (0..3).all(|k| {
            surface.variances[k] == 0.0 || off(surface.axes[k]).powi(2) < 9.0 * surface.variances[k]
        });
        within += usize::from(fits);
    }
    (asked, within)
}
