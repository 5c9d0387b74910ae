use super::*;
use crate::test_support::Numbers;
use proptest::prelude::*;
use std::f64::consts::PI;

/// Angle of a pixel of a camera with 500 pixels of focal length.
const PIXEL: f64 = 1.0 / 500.0;

/// What two cameras look at.
#[derive(Clone, Copy)]
enum Points {
    /// Between 3 and 12 units ahead.
    Volume,
    /// A wall 5 units ahead, not square to the camera.
    Wall,
}

/// A pair of views with its truth.
struct Views {
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
    points: Points,
    /// Standard deviation of a pixel coordinate.
    noise: f64,
    right: usize,
    wrong: usize,
}

impl Views {
    /// A step mostly to the side with a small turn, at points of many depths.
    fn sideways(right: usize, wrong: usize) -> Self {
        let rotation = UnitQuaternion::from_euler_angles(0.02, 0.1, -0.03);
        Self {
            rotation,
            translation: Vector3::new(0.6, 0.05, 0.2),
            points: Points::Volume,
            noise: 0.5,
            right,
            wrong,
        }
    }

    /// A pixel's ray within a field of view of 65° by 51°.
    fn any_ray(numbers: &mut Numbers) -> Vector3<f64> {
        Vector3::new(numbers.uniform(-320.0, 320.0) * PIXEL, numbers.uniform(-240.0, 240.0) * PIXEL, 1.0)
    }

    fn noisy(&self, point: &Vector3<f64>, numbers: &mut Numbers) -> Vector3<f64> {
        let error = Vector3::new(numbers.normal(), numbers.normal(), 0.0) * (self.noise * PIXEL);
        (point / point.z + error).normalize()
    }

    fn matches(&self, seed: u64) -> Vec<BearingMatch> {
        let mut numbers = Numbers::new(seed);
        let mut matches = Vec::new();
        while matches.len() < self.right {
            let ray = Self::any_ray(&mut numbers);
            let depth = match self.points {
                Points::Volume => numbers.uniform(3.0, 12.0),
                Points::Wall => 5.0 / (wall().dot(&ray)),
            };
            let point = ray * depth;
            let seen = self.rotation * point + self.translation;
            let (x, y) = (seen.x / seen.z / PIXEL, seen.y / seen.z / PIXEL);
            if seen.z > 0.1 && x.abs() < 320.0 && y.abs() < 240.0 {
                let (source, target) = (self.noisy(&point, &mut numbers), self.noisy(&seen, &mut numbers));
                matches.push(BearingMatch { source, target });
            }
        }
        for _ in 0..self.wrong {
            let (source, target) = (Self::any_ray(&mut numbers), Self::any_ray(&mut numbers));
            // Scattered among the right ones.
            let at = numbers.uniform(0.0, matches.len() as f64 + 1.0) as usize;
            matches.insert(at.min(matches.len()), BearingMatch { source, target });
        }
        matches
    }

    fn find(&self, seed: u64) -> Result<RelativePose, TwoViewRefusal> {
        relative_pose(&self.matches(seed), PIXEL, &TwoViewParams::default())
    }

    /// Errors of rotation and direction, degrees.
    fn errors(&self, found: &RelativePose) -> (f64, f64) {
        let direction = found.direction.as_ref().map_or(f64::NAN, |d| d.vector.angle(&self.translation));
        (found.target_from_source.angle_to(&self.rotation).to_degrees(), direction.to_degrees())
    }
}

fn wall() -> Vector3<f64> {
    Vector3::new(0.3, -0.1, 1.0).normalize()
}

#[test]
fn finds_rotation_and_direction_among_wrong_matches() {
    for (wrong, bound) in [(0, 0.15), (100, 0.15), (200, 0.2), (450, 0.2)] {
        let views = Views::sideways(300, wrong);
        for seed in 0..5 {
            let found = views.find(seed).unwrap();
            let (rotation, direction) = views.errors(&found);
            assert!(rotation < bound, "{wrong} wrong: rotation off by {rotation}°");
            assert!(direction < 15.0 * bound, "{wrong} wrong: direction off by {direction}°");
            assert_eq!(found.scene, Scene::Depth);
            assert!(found.match_count() >= 294 && found.match_count() <= 300 + wrong / 20, "{found:?}");
            assert!((0.35..0.65).contains(&found.rmse), "{}", found.rmse);
        }
    }
}

#[test]
fn same_matches_same_result() {
    let views = Views::sideways(200, 150);
    assert_eq!(views.find(3), views.find(3));
}

#[test]
fn sees_the_same_place_from_the_other_direction_of_travel() {
    // The other camera comes from the right and looks 20° to the side of the first one's view.
    let mut views = Views::sideways(300, 150);
    views.rotation = UnitQuaternion::from_euler_angles(0.0, 20f64.to_radians(), 0.01);
    views.translation = Vector3::new(-2.6, 0.0, 0.4);
    for seed in 0..5 {
        let (rotation, direction) = views.errors(&views.find(seed).unwrap());
        assert!(rotation < 0.15 && direction < 1.0, "off by {rotation}° and {direction}°");
    }
}

#[test]
fn a_plane_gives_the_pose_of_its_homography() {
    let mut views = Views::sideways(300, 150);
    views.points = Points::Wall;
    views.translation = Vector3::new(0.9, 0.1, 0.3);
    let mut right = 0;
    for seed in 0..8 {
        let found = views.find(seed).unwrap();
        let Scene::Plane { normal, alternative } = &found.scene else {
            panic!("{:?}", found.scene);
        };
        let (rotation, direction) = views.errors(&found);
        if rotation < 0.4 && direction < 4.0 {
            right += 1;
            assert!(normal.angle(&wall()).to_degrees() < 4.0);
        } else {
            // Nothing off the plane tells the two poses apart: then both are given.
            let (rotation, direction) = alternative.expect("a wrong pose must be given with its alternative");
            assert!(rotation.angle_to(&views.rotation).to_degrees() < 0.4);
            assert!(direction.angle(&views.translation).to_degrees() < 4.0);
        }
    }
    assert!(right > 0);
}

#[test]
fn a_few_points_off_a_plane_decide_between_its_poses() {
    let mut views = Views::sideways(280, 100);
    views.points = Points::Wall;
    views.translation = Vector3::new(0.9, 0.1, 0.3);
    let mut others = Views::sideways(25, 0);
    others.translation = views.translation;
    for seed in 0..8 {
        let mut matches = views.matches(seed);
        matches.extend(others.matches(100 + seed));
        let found = relative_pose(&matches, PIXEL, &TwoViewParams::default()).unwrap();
        assert!(matches!(found.scene, Scene::Plane { alternative: None, .. }), "{:?}", found.scene);
        let (rotation, direction) = views.errors(&found);
        assert!(rotation < 0.2 && direction < 2.0, "off by {rotation}° and {direction}°");
    }
}

#[test]
fn a_pure_rotation_has_a_rotation_and_no_direction() {
    for (wrong, translation) in [(0, 0.0), (200, 0.0), (100, 1e-3)] {
        let mut views = Views::sideways(300, wrong);
        views.translation = Vector3::new(translation, 0.0, 0.0);
        for seed in 0..5 {
            let found = views.find(seed).unwrap();
            assert_eq!(found.scene, Scene::NoParallax);
            assert_eq!(found.direction, None);
            let (rotation, _) = views.errors(&found);
            assert!(rotation < 0.03, "off by {rotation}°");
            assert!(found.parallax < 3.0 * PIXEL);
        }
    }
}

/// Mean of the normalised squared errors of rotation (3 degrees of freedom) and pose (5).
fn nees(views: &Views, runs: u64) -> (f64, f64) {
    let (mut of_rotation, mut of_pose) = (0.0, 0.0);
    for seed in 0..runs {
        let found = views.find(seed).unwrap();
        let direction = found.direction.as_ref().unwrap();
        let rotation_step = (views.rotation * found.target_from_source.inverse()).scaled_axis();
        let across = direction.basis.tr_mul(&views.translation.normalize());
        let error =
            nalgebra::Vector5::new(rotation_step.x, rotation_step.y, rotation_step.z, across.x, across.y);
        of_rotation += rotation_step.dot(&(found.rotation_covariance.try_inverse().unwrap() * rotation_step));
        of_pose += error.dot(&(direction.covariance.try_inverse().unwrap() * error));
    }
    (of_rotation / runs as f64, of_pose / runs as f64)
}

#[test]
fn the_covariance_of_right_matches_is_that_of_their_errors() {
    // The mean over 100 runs deviates by 0.245 (3 degrees of freedom) and 0.316 (5): bounds of four deviations.
    for noise in [0.3, 0.7] {
        let mut views = Views::sideways(200, 0);
        views.noise = noise;
        let (rotation, pose) = nees(&views, 100);
        assert!((2.0..4.0).contains(&rotation), "rotation {rotation}");
        assert!((3.7..6.3).contains(&pose), "pose {pose}");
    }
}

#[test]
fn wrong_matches_make_the_covariance_too_small_by_no_more_than_documented() {
    // Not consistent: above the bounds of the test before. The documentation of the covariance says by how much;
    // this holds it to that.
    let mut views = Views::sideways(200, 60);
    views.noise = 0.5;
    let (rotation, pose) = nees(&views, 100);
    assert!((2.0..5.0).contains(&rotation), "rotation {rotation}");
    assert!((3.7..9.0).contains(&pose), "pose {pose}");
}

#[test]
fn the_covariance_of_a_plane_and_of_a_pure_rotation_is_that_of_the_errors() {
    let mut views = Views::sideways(200, 0);
    views.points = Points::Wall;
    views.translation = Vector3::new(1.2, 0.1, 0.3);
    let (mut sum, mut runs) = (0.0, 0.0);
    for seed in 0..40 {
        let found = views.find(seed).unwrap();
        let rotation_step = (views.rotation * found.target_from_source.inverse()).scaled_axis();
        // Nothing is off the plane, so the wrong one of its two poses comes as often, degrees away.
        if rotation_step.norm() < 0.02 {
            sum += rotation_step.dot(&(found.rotation_covariance.try_inverse().unwrap() * rotation_step));
            runs += 1.0;
        }
    }
    let mean: f64 = sum / runs;
    assert!(runs > 10.0 && (1.7..4.3).contains(&mean), "plane: {mean} in {runs} runs");

    views.translation = Vector3::zeros();
    let mut sum = 0.0;
    for seed in 0..40 {
        let found = views.find(seed).unwrap();
        let rotation_step = (views.rotation * found.target_from_source.inverse()).scaled_axis();
        sum += rotation_step.dot(&(found.rotation_covariance.try_inverse().unwrap() * rotation_step));
    }
    let mean = sum / 40.0;
    assert!((1.7..4.3).contains(&mean), "turn: {mean}");
}

#[test]
fn unrelated_views_are_refused() {
    for count in [20, 50, 100, 400] {
        for seed in 0..6 {
            let views = Views::sideways(0, count);
            let refusal = views.find(seed).expect_err("random matches");
            let by_chance =
                matches!(refusal, TwoViewRefusal::Chance { .. } | TwoViewRefusal::TooFewInliers { .. });
            assert!(by_chance, "{refusal}");
        }
    }
}

#[test]
fn says_why_it_refuses() {
    let params = TwoViewParams::default();
    let matches = Views::sideways(30, 0).matches(0);
    assert_eq!(
        relative_pose(&matches[..7], PIXEL, &params),
        Err(TwoViewRefusal::TooFewMatches { given: 7, needed: 16 })
    );
    assert_eq!(
        relative_pose(&[], PIXEL, &params),
        Err(TwoViewRefusal::TooFewMatches { given: 0, needed: 16 })
    );
    for ray in [Vector3::new(f64::NAN, 0.0, 1.0), Vector3::zeros(), Vector3::new(0.0, f64::INFINITY, 1.0)] {
        let mut wrong = matches.clone();
        wrong[9].target = ray;
        assert_eq!(relative_pose(&wrong, PIXEL, &params), Err(TwoViewRefusal::InvalidMatch { index: 9 }));
    }
    for pixel_angle in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refusal = relative_pose(&matches, pixel_angle, &params).expect_err("a wrong unit");
        assert!(matches!(refusal, TwoViewRefusal::InvalidPixelAngle { .. }));
    }
    let one = vec![matches[0]; 50];
    assert!(relative_pose(&one, PIXEL, &params).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Exact matches from anywhere around give the exact pose, even beyond a field of view of 180°.
    #[test]
    fn exact_rays_of_any_field_of_view_give_the_exact_pose(seed in 0u64..1000, rotation_step in 0.0..PI) {
        let mut numbers = Numbers::new(seed);
        let rotation = UnitQuaternion::from_scaled_axis(numbers.vector(1.0).normalize() * rotation_step);
        let translation = numbers.vector(1.0);
        prop_assume!(translation.norm() > 0.3);
        let matches: Vec<_> = (0..100)
            .map(|_| {
                let point = numbers.vector(1.0).normalize() * numbers.uniform(2.0, 6.0);
                BearingMatch { source: point, target: rotation * point + translation }
            })
            .collect();
        let found = relative_pose(&matches, PIXEL, &TwoViewParams::default()).unwrap();
        prop_assert!(found.target_from_source.angle_to(&rotation) < 1e-6);
        prop_assert!(found.direction.unwrap().vector.angle(&translation) < 1e-6);
        prop_assert_eq!(found.inliers.len(), 100);
    }

    /// With source and target exchanged the pose is the inverse, as far as it is known: other samples are drawn, and
    /// which matches at the gate's edge count may differ.
    #[test]
    fn exchanged_views_give_the_inverse(seed in 0u64..1000) {
        let views = Views::sideways(150, 50);
        let matches = views.matches(seed);
        let back: Vec<_> =
            matches.iter().map(|m| BearingMatch { source: m.target, target: m.source }).collect();
        let found = relative_pose(&matches, PIXEL, &TwoViewParams::default()).unwrap();
        let back = relative_pose(&back, PIXEL, &TwoViewParams::default()).unwrap();
        let between = back.target_from_source.inverse().angle_to(&found.target_from_source);
        let deviation = found.rotation_covariance.trace().sqrt();
        prop_assert!(between < 2.0 * deviation, "{} of {}", between, deviation);
    }
}
