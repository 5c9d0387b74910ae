//! The pose of a camera that sees points of known position: from three of them, and from many of which some are wrong.

use crate::{Sampler, Se3, samples_needed, umeyama};
use nalgebra::linalg::Schur;
use nalgebra::{Complex, Matrix4, Vector3};

/// A point and the direction in which the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Position in the world.
    pub point: Vector3<f64>,
    /// Ray through the pixel, z = 1.
    pub ray: Vector3<f64>,
}

/// When a pose is accepted, and how long RANSAC searches for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consensus {
    /// Largest distance of a sighting from where the pose has it, in focal lengths.
    pub max_error: f64,
    /// Triples that are tried at most.
    pub max_samples: usize,
    /// Sightings that must agree.
    pub min_inliers: usize,
}

/// The poses `camera_from_world` under which three points are seen in three directions: none to four (Grunert 1841, in
/// the form of Haralick et al., IJCV 1994, §3.1).
pub fn p3p(sightings: [&Sighting; 3]) -> Vec<Se3> {
    let [p1, p2, p3] = sightings.map(|s| s.point);
    let [j1, j2, j3] = sightings.map(|s| s.ray.normalize());
    let (a2, b2, c2) = ((p2 - p3).norm_squared(), (p1 - p3).norm_squared(), (p1 - p2).norm_squared());
    if !(a2 > 0.0 && b2 > 0.0 && c2 > 0.0) {
        return Vec::new();
    }
    let (cos_a, cos_b, cos_c) = (j2.dot(&j3), j1.dot(&j3), j1.dot(&j2));
    // Shares of b² by which Haralick's coefficients are short.
    let (minus, plus) = ((a2 - c2) / b2, (a2 + c2) / b2);
    let (a, c) = (a2 / b2, c2 / b2);
    let quartic = [
        (minus - 1.0).powi(2) - 4.0 * c * cos_a * cos_a,
        4.0 * (minus * (1.0 - minus) * cos_b - (1.0 - plus) * cos_a * cos_c
            + 2.0 * c * cos_a * cos_a * cos_b),
        2.0 * (minus * minus - 1.0 + 2.0 * minus * minus * cos_b * cos_b + 2.0 * (1.0 - c) * cos_a * cos_a
            - 4.0 * plus * cos_a * cos_b * cos_c
            + 2.0 * (1.0 - a) * cos_c * cos_c),
        4.0 * (-minus * (1.0 + minus) * cos_b + 2.0 * a * cos_c * cos_c * cos_b
            - (1.0 - plus) * cos_a * cos_c),
        (1.0 + minus).powi(2) - 4.0 * a * cos_c * cos_c,
    ];
    let pose = |v: f64| {
        let below = 2.0 * (cos_c - v * cos_a);
        let u = ((minus - 1.0) * v * v - 2.0 * minus * cos_b * v + 1.0 + minus) / below;
        let s1 = (b2 / (1.0 + v * v - 2.0 * v * cos_b)).sqrt();
        let seen = [j1 * s1, j2 * (u * s1), j3 * (v * s1)];
        let in_front = v > 0.0 && u > 0.0 && s1.is_finite();
        in_front.then(|| umeyama::se3(&[p1, p2, p3], &seen).ok()).flatten().filter(Se3::is_finite)
    };
    real_roots(&quartic).into_iter().filter_map(pose).collect()
}

/// Steps of the Schur decomposition of a quartic's companion matrix at the most. Some ten do; for some matrices no number does.
const SCHUR_STEPS: usize = 1000;

/// The real roots of a quartic, highest power first; none where they are not found in so many steps.
fn real_roots(coefficients: &[f64; 5]) -> Vec<f64> {
    let [lead, rest @ ..] = coefficients;
    let largest = coefficients.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if !largest.is_finite() || lead.abs() <= 1e-12 * largest {
        return Vec::new();
    }
    let mut companion = Matrix4::<f64>::zeros();
    for (i, value) in rest.iter().enumerate() {
        companion[(0, i)] = -value / lead;
    }
    (1..4).for_each(|i| companion[(i, i - 1)] = 1.0);
    let value = |x: f64| coefficients.iter().fold(0.0, |sum, c| sum * x + c);
    let slope = |x: f64| {
        let [a, b, c, d, _] = coefficients;
        ((4.0 * a * x + 3.0 * b) * x + 2.0 * c) * x + d
    };
    let polish = |root: Complex<f64>| {
        // A double root comes out as a pair with small imaginary parts.
        if root.im.abs() > 1e-3 * (1.0 + root.re.abs()) {
            return None;
        }
        let mut x = root.re;
        for _ in 0..3 {
            let step = value(x) / slope(x);
            if !step.is_finite() || step.abs() > 0.1 * (1.0 + x.abs()) {
                break;
            }
            x -= step;
        }
        x.is_finite().then_some(x)
    };
    let Some(schur) = Schur::try_new(companion, f64::EPSILON, SCHUR_STEPS) else { return Vec::new() };
    schur.complex_eigenvalues().iter().filter_map(|&root| polish(root)).collect()
}

/// The pose that most sightings agree with, and which these are (RANSAC; Fischler & Bolles 1981); `None` when too few
/// do. The same sightings give the same pose.
pub fn pose_by_consensus(sightings: &[Sighting], params: &Consensus) -> Option<(Se3, Vec<usize>)> {
    /// How sure it should be that one sample was free of wrong sightings.
    const CONFIDENCE: f64 = 0.999;
    let count = sightings.len();
    if count < 4 || count < params.min_inliers {
        return None;
    }
    let mut best: Option<(f64, Se3)> = None;
    let mut sampler = Sampler::new(0);
    let (mut drawn, mut needed) = (0, params.max_samples);
    while drawn < needed {
        drawn += 1;
        let triple = [0; 3].map(|_| sampler.below(count));
        if triple[0] == triple[1] || triple[1] == triple[2] || triple[0] == triple[2] {
            continue;
        }
        for pose in p3p(triple.map(|i| &sightings[i])) {
            let cost = cost(sightings, &pose, params.max_error);
            if best.as_ref().is_none_or(|b| cost < b.0) {
                best = Some((cost, pose));
                let share = inliers(sightings, &pose, params.max_error).len() as f64 / count as f64;
                let enough = samples_needed(share, 3, CONFIDENCE);
                needed = needed.min(enough.max(1.0).min(params.max_samples as f64) as usize);
            }
        }
    }
    let (_, pose) = best?;
    let agree = inliers(sightings, &pose, params.max_error);
    (agree.len() >= params.min_inliers).then_some((pose, agree))
}

/// Sum of the squared errors, each cut off at the largest that agrees (MSAC; Torr & Zisserman 2000).
fn cost(sightings: &[Sighting], camera_from_world: &Se3, max_error: f64) -> f64 {
    let limit = max_error * max_error;
    let rotation = camera_from_world.rotation_matrix();
    let translation = camera_from_world.translation;
    sightings.iter().map(|s| squared(s, &(rotation * s.point + translation)).min(limit)).sum()
}

/// Which sightings agree with a pose.
fn inliers(sightings: &[Sighting], camera_from_world: &Se3, max_error: f64) -> Vec<usize> {
    let limit = max_error * max_error;
    let agrees = |i: &usize| squared(&sightings[*i], &(*camera_from_world * sightings[*i].point)) < limit;
    (0..sightings.len()).filter(agrees).collect()
}

/// Squared error of a sighting in focal lengths, its point given in the camera's frame; infinite behind it.
fn squared(sighting: &Sighting, x: &Vector3<f64>) -> f64 {
    if x.z <= 0.0 {
        return f64::INFINITY;
    }
    (x.x / x.z - sighting.ray.x).powi(2) + (x.y / x.z - sighting.ray.y).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    fn number() -> std::ops::Range<f64> {
        -1.0..1.0
    }

    fn scene(seed: &[f64]) -> (Se3, Vec<Sighting>) {
        let v: Vec<f64> = seed[..6].iter().map(|v| 1.5 * v).collect();
        let camera_from_world = Se3::exp(&Vector6::from_column_slice(&v));
        let sighting = |c: &[f64]| {
            let seen = Vector3::new(c[0], c[1], 1.0) * (4.0 + 3.0 * c[2]);
            Sighting { point: camera_from_world.inverse() * seen, ray: seen / seen.z }
        };
        (camera_from_world, seed[6..].chunks_exact(3).map(sighting).collect())
    }

    /// The steps of the decomposition turn in a circle for x⁴ = −½.
    #[test]
    fn a_quartic_whose_decomposition_does_not_converge_has_no_roots_in_place_of_no_end() {
        assert!(real_roots(&[2.0, 0.0, 0.0, 0.0, 1.0]).is_empty());
        let mut found = real_roots(&[1.0, -10.0, 35.0, -50.0, 24.0]);
        found.sort_by(f64::total_cmp);
        assert!(
            found.len() == 4 && found.iter().zip([1.0, 2.0, 3.0, 4.0]).all(|(a, b)| (a - b).abs() < 1e-9)
        );
    }

    /// As where features of one keyframe match one of the other's: these come to that quartic.
    #[test]
    fn three_points_in_one_direction_have_no_pose() {
        let ray = Vector3::new(-0.24479166666666669, 0.40937500000000004, 1.0);
        let seen = [0.6729166666666667, 0.8062500000000002, 0.9395833333333334]
            .map(|x| Sighting { point: Vector3::new(x, -0.3687500000000001, 2.0000000000000004), ray });
        assert!(p3p([&seen[0], &seen[1], &seen[2]]).is_empty());
    }

    fn distance(a: &Se3, b: &Se3) -> f64 {
        (*a * b.inverse()).log().norm()
    }

    proptest! {
        #[test]
        fn one_of_the_poses_from_three_points_is_the_true_one(
            seed in proptest::collection::vec(number(), 15),
        ) {
            let (truth, seen) = scene(&seed);
            let area = (seen[1].point - seen[0].point).cross(&(seen[2].point - seen[0].point)).norm();
            let rays = (seen[1].ray - seen[0].ray).cross(&(seen[2].ray - seen[0].ray)).norm();
            prop_assume!(area > 0.3 && rays > 0.1);
            let found = p3p([&seen[0], &seen[1], &seen[2]]);
            prop_assert!(found.len() <= 4);
            // Close to the danger cylinder two of them fall together, and the root is as exact as a double one can be.
            prop_assert!(found.iter().any(|pose| distance(pose, &truth) < 1e-3), "{found:?}\n{truth:?}");
        }

        #[test]
        fn the_pose_is_found_though_half_the_sightings_are_wrong(
            seed in proptest::collection::vec(number(), 6 + 3 * 60),
        ) {
            let (truth, mut seen) = scene(&seed);
            for i in 0..30 {
                seen[i].ray = seen[59 - i].ray + Vector3::new(0.1, -0.2, 0.0);
            }
            let params = Consensus { max_error: 0.004, max_samples: 500, min_inliers: 20 };
            let (found, agree) = pose_by_consensus(&seen, &params).expect("half of them agree");
            prop_assert!(distance(&found, &truth) < 1e-3);
            prop_assert!((30..60).all(|i| agree.contains(&i)) && agree.len() < 40);
            prop_assert_eq!(pose_by_consensus(&seen, &params), Some((found, agree)));
        }
    }

    #[test]
    fn sightings_that_have_nothing_to_do_with_each_other_give_no_pose() {
        let spread = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1000) as f64 / 500.0 - 1.0;
        let sighting = |i: usize| Sighting {
            point: Vector3::new(spread(i, 1), spread(i * i, 2), 4.0 + spread(3 * i, 3)),
            ray: Vector3::new(spread(i * i * i, 4), spread(5 * i, 5), 1.0),
        };
        let seen: Vec<Sighting> = (0..100).map(sighting).collect();
        let params = Consensus { max_error: 0.004, max_samples: 500, min_inliers: 15 };
        assert_eq!(pose_by_consensus(&seen, &params), None);
        assert_eq!(pose_by_consensus(&seen[..3], &params), None);
        assert!(p3p([&seen[0], &seen[0], &seen[1]]).is_empty(), "two points are not three");
    }
}
