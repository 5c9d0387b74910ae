//! The paper's chain to a pose between two maps, as `emr`: normals, Harris 3-D key points, FPFH, reciprocal matches
//! (Algorithm 1), RANSAC with SVD. What follows is common to all methods: refinement on voxels of Gaussians (VGICP's), the
//! evidence, which takes the place of the paper's confidence, and the graph of merges.
//!
//! The paper gives no parameters.

use super::key_points::{Descriptor, KeyPoint};
use super::robot_map::RobotMap;
use geometry::{Random, Se3, umeyama};
use nalgebra::Vector3;
use rayon::prelude::*;

/// `k` of Algorithm 1: that of the software which the paper builds on.
const NEAREST: usize = 5;
/// A match is an inlier within this distance, metres: one and a half steps of the grid.
const INLIER: f64 = 0.75;
/// Samples of RANSAC.
const SAMPLES: usize = 100_000;
/// Two sides of a sample's triangles differ by no more than this share, or it is not tried.
const SIMILAR: f64 = 0.9;
/// Shortest side of a sample's triangle, metres.
const LEAST_SIDE: f64 = 3.0;

/// A pose found by the chain.
#[derive(Clone, Copy, Debug)]
pub struct Proposed {
    /// The pose.
    pub a_from_b: Se3,
    /// Reciprocal matches.
    pub matches: usize,
    /// Of them, those that agree with the pose.
    pub inliers: usize,
}

/// The chain up to RANSAC; `None` where fewer than three matches agree.
pub fn propose(a: &RobotMap, b: &RobotMap) -> Option<Proposed> {
    let (of_a, of_b) = rayon::join(|| a.key_points(), || b.key_points());
    let matches = reciprocal(of_a, of_b);
    let pairs: Vec<[Vector3<f64>; 2]> = matches.iter().map(|&(i, j)| [of_a[i].0, of_b[j].0]).collect();
    let (a_from_b, inliers) = ransac(&pairs)?;
    Some(Proposed { a_from_b, matches: pairs.len(), inliers })
}

/// Algorithm 1: pairs of which each is among the other's [`NEAREST`] nearest.
fn reciprocal(a: &[KeyPoint], b: &[KeyPoint]) -> Vec<(usize, usize)> {
    let nearest = |of: &[KeyPoint], among: &[KeyPoint]| -> Vec<Vec<u32>> {
        of.par_iter()
            .map(|(_, descriptor)| {
                let squared = |other: &Descriptor| -> f32 {
                    descriptor.iter().zip(other).map(|(x, y)| (x - y) * (x - y)).sum()
                };
                let mut all: Vec<(f32, u32)> = (0..).zip(among).map(|(j, (_, o))| (squared(o), j)).collect();
                let rank = NEAREST.min(all.len());
                let order = |x: &(f32, u32), y: &(f32, u32)| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1));
                if rank > 0 && rank < all.len() {
                    all.select_nth_unstable_by(rank - 1, order);
                }
                all[..rank].iter().map(|(_, j)| *j).collect()
            })
            .collect()
    };
    let (forth, back) = rayon::join(|| nearest(a, b), || nearest(b, a));
    let pairs = forth.iter().enumerate().flat_map(|(i, near)| near.iter().map(move |&j| (i, j as usize)));
    let mut found: Vec<(usize, usize)> = pairs.filter(|&(i, j)| back[j].contains(&(i as u32))).collect();
    found.sort_unstable();
    found
}

/// The pose on which most pairs agree, from samples of three by SVD (Umeyama 1991), always the same ones; refined on its
/// inliers.
fn ransac(pairs: &[[Vector3<f64>; 2]]) -> Option<(Se3, usize)> {
    if pairs.len() < 3 {
        return None;
    }
    let inliers = |pose: &Se3| -> Vec<usize> {
        let agrees = |&i: &usize| (*pose * pairs[i][1] - pairs[i][0]).norm() < INLIER;
        (0..pairs.len()).filter(agrees).collect()
    };
    let fit = |used: &[usize]| {
        let side = |k: usize| -> Vec<Vector3<f64>> { used.iter().map(|&i| pairs[i][k]).collect() };
        umeyama::se3(&side(1), &side(0)).ok()
    };
    let drawn = |sample: usize| {
        let mut random = Random::new(sample as u64);
        [(); 3].map(|()| random.index(pairs.len()))
    };
    let tested = |sample: usize| -> Option<(usize, usize)> {
        let chosen = drawn(sample);
        let similar = [(0, 1), (1, 2), (2, 0)].into_iter().all(|(x, y)| {
            let [one, other] = [0, 1].map(|k| (pairs[chosen[x]][k] - pairs[chosen[y]][k]).norm());
            one.min(other) > LEAST_SIDE && one.min(other) > SIMILAR * one.max(other)
        });
        let pose = similar.then(|| fit(&chosen)).flatten()?;
        Some((inliers(&pose).len(), sample))
    };
    // Of samples with as many inliers the first.
    let better = |x: (usize, usize), y: (usize, usize)| {
        if (y.0, std::cmp::Reverse(y.1)) > (x.0, std::cmp::Reverse(x.1)) { y } else { x }
    };
    let (count, sample) = (0..SAMPLES).into_par_iter().filter_map(tested).reduce_with(better)?;
    let mut pose = fit(&drawn(sample))?;
    let mut used = inliers(&pose);
    for _ in 0..5 {
        let Some(refined) = (used.len() >= 3).then(|| fit(&used)).flatten() else { break };
        (pose, used) = (refined, inliers(&refined));
    }
    (count >= 3).then_some((pose, used.len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn ransac_finds_the_pose_of_a_fifth_of_the_pairs() {
        let pose = Se3::exp(&Vector6::new(7.0, -3.0, 0.4, 0.02, -0.01, 2.0));
        let number = |i: u64| Random::new(i).unit();
        let point =
            |i: u64| Vector3::new(40.0 * number(3 * i), 30.0 * number(3 * i + 1), 5.0 * number(3 * i + 2));
        let pairs: Vec<_> = (0..200)
            .map(|i| if i % 5 == 0 { [pose * point(i), point(i)] } else { [point(1000 + i), point(i)] })
            .collect();
        let (found, inliers) = ransac(&pairs).unwrap();
        assert!((pose.inverse() * found).log().norm() < 0.05, "{found:?}");
        assert!((40..60).contains(&inliers), "{inliers}");
        assert_eq!(ransac(&pairs[..2]).map(|f| f.1), None);
    }
}
