//! RANSAC: hypotheses from the fewest matches, scored on all.

use super::epipolar::{self, EpipolarFit};
use super::least_squares::minimise;
use super::linear::{PlanePose, Pose, decompose, eight_point, essential_poses, four_point};
use super::rays::Rays;
use super::transfer::{self, PlaneFit};
use super::{TwoViewParams, plane_limit};
use geometry::{Sampler, samples_needed};
use nalgebra::{Matrix3, Vector3};

/// How many samples of `size` matches must be drawn so that one is free of wrong matches with `confidence`.
fn enough(inlier_share: f64, size: i32, params: &TwoViewParams) -> usize {
    let needed = samples_needed(inlier_share, size, params.confidence);
    needed.ceil().min(params.max_samples as f64).max(1.0) as usize
}

/// The homography that most matches fit, if any.
pub(super) fn homography(
    rays: &Rays,
    limit: f64,
    sampler: &mut Sampler,
    params: &TwoViewParams,
) -> Option<Matrix3<f64>> {
    let limit = plane_limit(limit);
    let mut best: Option<Matrix3<f64>> = None;
    // A hypothesis that nothing fits.
    let mut lowest = limit * rays.len() as f64;
    let (mut drawn, mut needed) = (0, params.max_samples);
    while drawn < needed {
        drawn += 1;
        let Some(hypothesis) = four_point(rays, &sampler.sample(rays.len())) else {
            continue;
        };
        let Some(cost) = transfer::cost(rays, &hypothesis, limit, lowest) else {
            continue;
        };
        (best, lowest) = (Some(hypothesis), cost);
        let mut fits = transfer::inliers(rays, &hypothesis, limit);
        if let Some((polished, cost)) = polish_homography(rays, &hypothesis, &fits, limit, lowest) {
            (best, lowest) = (Some(polished), cost);
            fits = transfer::inliers(rays, &polished, limit);
        }
        needed = needed.min(enough(fits.len() as f64 / rays.len() as f64, 4, params));
    }
    best
}

/// Fits a homography to its inliers; nothing where that is no better.
fn polish_homography(
    rays: &Rays,
    homography: &Matrix3<f64>,
    fits: &[usize],
    limit: f64,
    lowest: f64,
) -> Option<(Matrix3<f64>, f64)> {
    let start = decompose(homography, &mean_ray(rays, fits))?[0].clone();
    let fit = PlaneFit { rays, on_plane: fits, off_plane: &[] };
    let polished = minimise(&fit, start, limit.sqrt(), 4).homography();
    let cost = transfer::cost(rays, &polished, limit, lowest)?;
    Some((polished, cost))
}

/// The mean ray of the source among some matches.
fn mean_ray(rays: &Rays, matches: &[usize]) -> Vector3<f64> {
    matches.iter().map(|&i| rays.source[i]).sum()
}

/// The two poses with plane that the plane's matches allow, refined on them.
pub(super) fn plane_poses(rays: &Rays, homography: &Matrix3<f64>, limit: f64) -> Vec<PlanePose> {
    let fits = transfer::inliers(rays, homography, plane_limit(limit));
    let Some(poses) = decompose(homography, &mean_ray(rays, &fits)) else {
        return Vec::new();
    };
    let fit = PlaneFit { rays, on_plane: &fits, off_plane: &[] };
    poses.into_iter().map(|pose| minimise(&fit, pose, limit.sqrt(), 10)).collect()
}

/// The best pose so far, with its cost.
pub(super) struct Leader {
    pub(super) pose: Pose,
    cost: f64,
}

/// The pose that most matches fit: of `seeds` and of samples of eight matches.
pub(super) fn pose(
    rays: &Rays,
    limit: f64,
    seeds: &[Pose],
    sampler: &mut Sampler,
    params: &TwoViewParams,
) -> Option<Pose> {
    let mut leader: Option<Leader> = None;
    let mut needed = params.max_samples;
    for seed in seeds {
        needed = needed.min(challenge(rays, limit, seed.essential(), Some(seed), &mut leader, params));
    }
    let mut drawn = 0;
    while drawn < needed {
        drawn += 1;
        if let Some(essential) = eight_point(rays, &sampler.sample(rays.len())) {
            needed = needed.min(challenge(rays, limit, essential, None, &mut leader, params));
        }
    }
    leader.map(|leader| leader.pose)
}

/// Scores a hypothesis; if it beats the leader, it takes the lead, refined. Returns how many samples are enough.
fn challenge(
    rays: &Rays,
    limit: f64,
    essential: Matrix3<f64>,
    known: Option<&Pose>,
    leader: &mut Option<Leader>,
    params: &TwoViewParams,
) -> usize {
    let lowest = leader.as_ref().map_or(limit * rays.len() as f64, |leader| leader.cost);
    let Some(cost) = epipolar::cost(rays, &essential, limit, lowest) else {
        return params.max_samples;
    };
    let Some(mut pose) = known.cloned().or_else(|| most_in_front(rays, &essential, limit)) else {
        return params.max_samples;
    };
    let mut cost = cost;
    let mut fits = epipolar::inliers(rays, &pose, limit);
    for _ in 0..3 {
        let polished = minimise(&EpipolarFit { rays, matches: &fits }, pose.clone(), 0.5 * limit.sqrt(), 3);
        let Some(lower) = epipolar::cost(rays, &polished.essential(), limit, cost) else {
            break;
        };
        (pose, cost) = (polished, lower);
        fits = epipolar::inliers(rays, &pose, limit);
    }
    *leader = Some(Leader { pose, cost });
    enough(fits.len() as f64 / rays.len() as f64, 8, params)
}

/// Of the four poses of an essential matrix the one with most of its inliers in front of both cameras.
fn most_in_front(rays: &Rays, essential: &Matrix3<f64>, limit: f64) -> Option<Pose> {
    let poses = essential_poses(essential)?;
    let fits = epipolar::inliers(rays, &poses[0], limit);
    let ahead = |pose: &Pose| fits.iter().filter(|&&i| epipolar::in_front(rays, pose, i, 0.0)).count();
    // Of equals the first, so that the choice does not depend on the iterator.
    let mut best: Option<(usize, Pose)> = None;
    for pose in poses {
        let count = ahead(&pose);
        if best.as_ref().is_none_or(|(most, _)| count > *most) {
            best = Some((count, pose));
        }
    }
    best.map(|(_, pose)| pose)
}
