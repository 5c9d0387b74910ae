use super::*;
use crate::test_support::Numbers;
use geometry::Pinhole;
use nalgebra::{UnitQuaternion, Vector3};

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 500.0, fy: 505.0, cx: 319.5, cy: 239.5 };

/// Which side knows the depth of a point.
#[derive(Clone, Copy)]
enum Depth {
    Source,
    Target,
    Alternating,
}

/// Keyframes of two maps side by side before points 4 to 10 away, and the true target_from_source. `wrong` of the
/// matches are between unrelated pixels.
fn pool(seed: u64, depth: Depth, count: usize, wrong: f64, noise: f64) -> (Sim3, Pool) {
    let numbers = &mut Numbers::new(seed);
    let motion = Sim3::new(numbers.rotation(0.2), numbers.vector(2.0), numbers.uniform(-1.0, 1.0).exp());
    let views = |numbers: &mut Numbers, from: &Sim3| -> Vec<View> {
        let view = |i: i32| {
            let pose = Sim3::new(numbers.rotation(0.05), Vector3::new(0.4 * f64::from(i), 0.0, 0.0), 1.0);
            View::new(
                *from * pose * Sim3 { scale: numbers.uniform(-0.3, 0.3).exp(), ..Sim3::identity() },
                &CAMERA,
            )
        };
        (-2..3).map(view).collect()
    };
    let views = [views(numbers, &Sim3::identity()), views(numbers, &motion)];
    let mut matches = Vec::new();
    while matches.len() < count {
        let point =
            Vector3::new(numbers.uniform(-3.0, 3.0), numbers.uniform(-2.0, 2.0), numbers.uniform(4.0, 10.0));
        let number = matches.len() as u32;
        let is_wrong = (f64::from(number) + 0.5) / (count as f64) < wrong;
        let mut side = |index: usize, point: Vector3<f64>, known: bool| {
            let view = numbers.uniform(0.0, 5.0) as usize;
            let local = views[index][view].view_from_side * point;
            let jitter =
                Vector3::new(numbers.normal() / CAMERA.fx, numbers.normal() / CAMERA.fy, 0.0) * noise;
            let mut ray = local / local.z + jitter;
            if is_wrong && index == 1 {
                ray = CAMERA.unproject(numbers.uniform(0.0, 640.0), numbers.uniform(0.0, 480.0));
            }
            let place =
                |relative: f64| views[index][view].side_from_view * (ray * local.z * (1.0 + relative));
            let measured = place(0.02 * noise * numbers.normal());
            let point =
                known.then(|| Located { position: measured, depth_deviation: place(0.02) - place(0.0) });
            (local.z > 0.0).then_some(Sighting { view, feature: number, ray, point })
        };
        let known = match depth {
            Depth::Source => [true, false],
            Depth::Target => [false, true],
            Depth::Alternating => [number.is_multiple_of(2), !number.is_multiple_of(2)],
        };
        let sides = (side(0, point, known[0]), side(1, motion * point, known[1]));
        if let (Some(source), Some(target)) = sides {
            matches.push(Match { sides: [source, target] });
        }
    }
    (motion, Pool { views, matches })
}

/// How far an estimate is from the truth in its own standard deviations, squared.
fn deviation(found: &GeneralisedPose, truth: &Sim3) -> f64 {
    let error = (*truth * found.estimate.a_from_b.inverse()).log();
    error.dot(&(found.estimate.information * error))
}

#[test]
fn depth_on_one_side_suffices_whichever_it_is() {
    for depth in [Depth::Source, Depth::Target, Depth::Alternating] {
        for seed in 0..6 {
            let (truth, pool) = pool(seed, depth, 150, 0.5, 0.5);
            let found = generalised_pose(&pool, &GeneralisedPoseParams::default()).unwrap();
            let wrong = found.inliers.iter().filter(|&&index| index < 75).count();
            assert!(found.inliers.len() > 65 && wrong < 5, "seed {seed}: {wrong} of {}", found.inliers.len());
            let scale = found.estimate.a_from_b.scale / truth.scale;
            assert!((scale - 1.0).abs() < 0.02, "seed {seed}: scale {scale}");
            let deviation = deviation(&found, &truth);
            assert!(deviation < 40.0, "seed {seed}: {deviation} for 7 degrees of freedom");
        }
    }
}

#[test]
fn the_same_pool_gives_the_same_pose() {
    let (_, pool) = pool(3, Depth::Alternating, 120, 0.6, 0.5);
    let params = GeneralisedPoseParams::default();
    assert_eq!(generalised_pose(&pool, &params), generalised_pose(&pool, &params));
}

#[test]
fn matches_of_unrelated_pixels_give_no_pose() {
    for seed in 0..6 {
        let (_, pool) = pool(seed, Depth::Alternating, 200, 1.0, 0.5);
        assert!(generalised_pose(&pool, &GeneralisedPoseParams::default()).is_err(), "seed {seed}");
    }
}

/// One camera in one place sees no unit of the other map.
#[test]
fn from_one_centre_the_scale_stays_open() {
    let (_, mut pool) = pool(1, Depth::Source, 120, 0.0, 0.5);
    let here = |m: &mut Match| {
        let local = m.sides[1].ray;
        m.sides[1] = Sighting { view: 0, ray: local, ..m.sides[1] };
    };
    let first = pool.views[1][0];
    let motion = Sim3::new(UnitQuaternion::identity(), Vector3::new(0.1, 0.0, 0.0), 1.0);
    for m in &mut pool.matches {
        here(m);
        let point = m.sides[0].point.unwrap().position;
        let local = first.view_from_side * (motion * point);
        m.sides[1].ray = local / local.z;
    }
    pool.matches.retain(|m| m.sides[1].ray.iter().all(|v| v.abs() < 10.0));
    assert!(generalised_pose(&pool, &GeneralisedPoseParams::default()).is_err());
}

/// A key point that matches in many keyframes is one.
#[test]
fn every_key_point_counts_once() {
    let (_, mut pool) = pool(2, Depth::Alternating, 10, 0.0, 0.5);
    let again: Vec<Match> = pool
        .matches
        .iter()
        .map(|m| {
            let mut m = *m;
            m.sides[0].feature += 100;
            m
        })
        .collect();
    pool.matches.extend(again);
    assert_eq!(distinct(&pool, 0..20), 10);
    let refusal = generalised_pose(&pool, &GeneralisedPoseParams::default()).unwrap_err();
    assert_eq!(refusal, GeneralisedPoseRefusal::FewInliers { inliers: 10, given: 10, needed: 12 });
}
