//! The filter on analytically rendered planes with exact depth.

use super::*;
use geometry::sensor::{Sensor, Twist};
use nalgebra::{UnitQuaternion, Vector3};

/// A textured plane `normal · X = distance` in the keyframe's frame, seen where `x < right` on the plane.
#[derive(Clone, Copy)]
struct Plane {
    normal: Vector3<f64>,
    distance: f64,
    right: f64,
    phase: f64,
}

const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 140.0, fy: 140.0, cx: 79.5, cy: 59.5 };

const SLANTED: Plane =
    Plane { normal: Vector3::new(0.25, -0.15, 1.0), distance: 2.0, right: f64::INFINITY, phase: 0.0 };

/// A nearer plane that covers the left part of the view.
const NEAR: Plane = Plane { normal: Vector3::new(0.0, 0.0, 1.0), distance: 1.0, right: -0.05, phase: 2.0 };

/// Aperiodic texture on a plane, grey levels around 0.
fn texture(x: f64, y: f64) -> f64 {
    let wave = |fx: f64, fy: f64, p: f64| (fx * x + fy * y + p).sin();
    18.0 * wave(11.0, 4.3, 0.3)
        + 16.0 * wave(-17.3, 9.1, 1.1)
        + 14.0 * wave(27.1, -6.7, 2.0)
        + 10.0 * wave(39.7, 21.3, 0.7)
}

/// Inverse depth and intensity seen by `camera_from_keyframe` along the ray through a pixel.
fn trace(planes: &[Plane], camera_from_keyframe: &Se3, x: f64, y: f64) -> (f64, f64) {
    let keyframe_from_camera = camera_from_keyframe.inverse();
    let ray = keyframe_from_camera.rotation * CAMERA.unproject(x, y);
    let start = keyframe_from_camera.translation;
    let mut nearest = (0.0, 0.0);
    for plane in planes {
        let depth = (plane.distance - plane.normal.dot(&start)) / plane.normal.dot(&ray);
        let hit = start + ray * depth;
        if depth > 0.0 && hit.x < plane.right && 1.0 / depth > nearest.0 {
            nearest = (1.0 / depth, 128.0 + texture(hit.x + plane.phase, hit.y + plane.phase));
        }
    }
    nearest
}

/// An image with Gaussian noise of standard deviation `noise`, and `gain · I + bias` before it.
fn render(planes: &[Plane], pose: &Se3, noise: f64, (gain, bias): (f64, f64), seed: u64) -> GrayImage {
    let mut random = geometry::Random::new(seed);
    let mut image = GrayImage::filled(CAMERA.width, CAMERA.height, 0);
    for y in 0..CAMERA.height {
        for x in 0..CAMERA.width {
            let value = gain * trace(planes, pose, x as f64, y as f64).1 + bias + noise * random.normal();
            image.set(x, y, value.round().clamp(0.0, 255.0) as u8);
        }
    }
    image
}

/// Poses on either side of the keyframe, growing baselines, slightly turned.
fn poses() -> Vec<Se3> {
    [(0.06, 0.01, 0.0), (-0.12, 0.0, 0.02), (0.2, -0.02, -0.03), (-0.25, 0.01, 0.04)]
        .iter()
        .map(|&(x, y, z)| {
            Se3::new(UnitQuaternion::from_euler_angles(0.01 * x, -0.05 * x, 0.01), Vector3::new(x, y, z))
        })
        .collect()
}

fn params() -> DepthParams {
    DepthParams { max_candidate_share: 0.5, ..DepthParams::default() }
}

/// Backbone points on a grid, exact.
fn seeds(planes: &[Plane]) -> Vec<SeedPoint> {
    let mut points = Vec::new();
    for y in (5..CAMERA.height).step_by(12) {
        for x in (5..CAMERA.width).step_by(12) {
            let inverse_depth = trace(planes, &Se3::identity(), x as f64, y as f64).0 as f32;
            points.push(SeedPoint { pixel: [x as f32, y as f32], inverse_depth, variance: 1e-4 });
        }
    }
    points
}

fn stereo(image: &GrayImage, frame_from_keyframe: Se3) -> StereoFrame<'_> {
    let shift = Shift::none(CAMERA);
    StereoFrame { image, frame_from_keyframe, brightness: (0.0, 0.0), pose_sigma_px: 0.02, shift }
}

/// The keyframe of the planes, and its filter with the backbone points.
fn seeded(planes: &[Plane], noise: f64) -> (GrayImage, DepthFilter) {
    let keyframe = render(planes, &Se3::identity(), noise, (1.0, 0.0), 1);
    let mut filter = DepthFilter::new(&keyframe, &CAMERA, Shift::none(CAMERA), &params());
    filter.seed(&seeds(planes));
    (keyframe, filter)
}

/// Maps the planes from the usual poses.
fn mapped(planes: &[Plane], noise: f64) -> DepthFilter {
    let (keyframe, mut filter) = seeded(planes, noise);
    for (k, pose) in poses().into_iter().enumerate() {
        let image = render(planes, &pose, noise, (1.0, 0.0), 2 + k as u64);
        filter.update(&keyframe, &stereo(&image, pose));
    }
    filter
}

/// Sorted relative errors and sorted squared normalised errors of the exported pixels.
fn errors(filter: &DepthFilter, planes: &[Plane]) -> (Vec<f32>, Vec<f32>) {
    let (mut relative, mut normalised2) = (Vec::new(), Vec::new());
    for (pixel, d, v) in filter.to_semi_dense().iter() {
        let (x, y) = (pixel as usize % CAMERA.width, pixel as usize / CAMERA.width);
        let exact = trace(planes, &Se3::identity(), x as f64, y as f64).0 as f32;
        relative.push((d - exact).abs() / exact);
        normalised2.push((d - exact) * (d - exact) / v);
    }
    relative.sort_by(f32::total_cmp);
    normalised2.sort_by(f32::total_cmp);
    (relative, normalised2)
}

fn share_above(sorted: &[f32], limit: f32) -> f32 {
    sorted.iter().filter(|&&r| r > limit).count() as f32 / sorted.len().max(1) as f32
}

#[test]
fn slanted_plane_is_measured_accurately() {
    let mut filter = mapped(&[SLANTED], 2.0);
    filter.regularise();
    let (relative, _) = errors(&filter, &[SLANTED]);
    assert!(relative.len() > CAMERA.width * CAMERA.height / 10, "only {} pixels", relative.len());
    assert!(relative[relative.len() / 2] < 0.006, "median {}", relative[relative.len() / 2]);
    assert!(share_above(&relative, 0.1) < 0.005, "outliers {}", share_above(&relative, 0.1));
}

#[test]
fn variances_are_honest_for_weak_and_strong_noise() {
    for noise in [2.0, 4.0, 7.0] {
        let mut filter = mapped(&[SLANTED], noise);
        filter.regularise();
        let (_, normalised2) = errors(&filter, &[SLANTED]);
        let mean = normalised2.iter().sum::<f32>() / normalised2.len() as f32;
        // Smoothing lessens errors and leaves the variances, so the mean lies below 1.
        assert!((0.15..1.5).contains(&mean), "noise {noise}: mean normalised squared error {mean}");
    }
}

#[test]
fn occlusion_leaves_few_outliers() {
    let planes = [SLANTED, NEAR];
    let mut filter = mapped(&planes, 2.0);
    filter.regularise();
    let (relative, _) = errors(&filter, &planes);
    assert!(relative.len() > 1000, "only {} pixels", relative.len());
    assert!(share_above(&relative, 0.1) < 0.03, "outliers {}", share_above(&relative, 0.1));
}

#[test]
fn an_unrelated_reference_adds_no_outliers() {
    let planes = [SLANTED];
    let (keyframe, mut filter) = seeded(&planes, 2.0);
    let moved = [Plane { phase: 5.0, ..SLANTED }];
    for (k, pose) in poses().into_iter().enumerate() {
        let rendered = if k == 0 { &moved } else { &planes };
        filter.update(&keyframe, &stereo(&render(rendered, &pose, 2.0, (1.0, 0.0), 2), pose));
    }
    filter.regularise();
    let (relative, _) = errors(&filter, &planes);
    assert!(relative.len() > 1000, "only {} pixels", relative.len());
    assert!(share_above(&relative, 0.1) < 0.01, "outliers {}", share_above(&relative, 0.1));
}

#[test]
fn changed_brightness_is_accounted_for() {
    let planes = [SLANTED];
    let (keyframe, mut filter) = seeded(&planes, 1.0);
    for pose in poses() {
        let image = render(&planes, &pose, 1.0, (1.3, -20.0), 2);
        let frame = StereoFrame { brightness: (1.3f32.ln(), -20.0), ..stereo(&image, pose) };
        filter.update(&keyframe, &frame);
    }
    let (relative, _) = errors(&filter, &planes);
    assert!(relative.len() > 1000, "only {} pixels", relative.len());
    assert!(relative[relative.len() / 2] < 0.006, "median {}", relative[relative.len() / 2]);
}

#[test]
fn works_without_backbone_when_the_range_is_known() {
    let planes = [SLANTED];
    let keyframe = render(&planes, &Se3::identity(), 1.0, (1.0, 0.0), 1);
    let range = DepthParams { min_inverse_depth: 0.2, max_inverse_depth: 1.5, ..params() };
    let mut filter = DepthFilter::new(&keyframe, &CAMERA, Shift::none(CAMERA), &range);
    for pose in poses() {
        filter.update(&keyframe, &stereo(&render(&planes, &pose, 1.0, (1.0, 0.0), 2), pose));
    }
    filter.regularise();
    let (relative, _) = errors(&filter, &planes);
    assert!(relative.len() > 500, "only {} pixels", relative.len());
    assert!(share_above(&relative, 0.1) < 0.02, "outliers {}", share_above(&relative, 0.1));
}

#[test]
fn featureless_and_unfit_images_give_nothing() {
    let black = GrayImage::filled(CAMERA.width, CAMERA.height, 0);
    let small = GrayImage::filled(8, 8, 0);
    let mut filter = DepthFilter::new(&black, &CAMERA, Shift::none(CAMERA), &params());
    filter.seed(&seeds(&[SLANTED]));
    filter.update(&black, &stereo(&black, poses()[0]));
    filter.regularise();
    assert!(filter.is_empty() && filter.to_semi_dense().is_empty());
    assert!(DepthFilter::new(&small, &CAMERA, Shift::none(CAMERA), &params()).is_empty());
    let tiny = Pinhole { width: 8, height: 8, ..CAMERA };
    assert!(DepthFilter::new(&small, &tiny, Shift::none(tiny), &params()).is_empty());

    let keyframe = render(&[SLANTED], &Se3::identity(), 0.0, (1.0, 0.0), 1);
    let mut filter = DepthFilter::new(&keyframe, &CAMERA, Shift::none(CAMERA), &params());
    let skipped = UpdateStats { skipped: filter.len(), ..UpdateStats::default() };
    assert_eq!(filter.update(&keyframe, &stereo(&small, poses()[0])), skipped);
    let nan = Se3::new(UnitQuaternion::identity(), Vector3::new(f64::NAN, 0.0, 0.0));
    assert_eq!(filter.update(&keyframe, &stereo(&keyframe, nan)), skipped);
    // No baseline: nothing to learn, nothing divided by zero.
    filter.update(&keyframe, &stereo(&keyframe, Se3::identity()));
    // Black references fit nowhere.
    filter.update(&keyframe, &stereo(&black, poses()[0]));
    filter.update(&keyframe, &stereo(&black, poses()[1]));
    assert!(filter.to_semi_dense().is_empty());
}

#[test]
fn motion_along_the_axis_is_measured_away_from_the_epipole() {
    let planes = [SLANTED];
    let (keyframe, mut filter) = seeded(&planes, 1.0);
    for z in [-0.15, -0.25, 0.2, -0.4] {
        let pose = Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, z));
        filter.update(&keyframe, &stereo(&render(&planes, &pose, 1.0, (1.0, 0.0), 2), pose));
    }
    let (relative, _) = errors(&filter, &planes);
    assert!(relative.len() > 200, "only {} pixels", relative.len());
    assert!(relative[relative.len() / 2] < 0.02, "median {}", relative[relative.len() / 2]);
}

#[test]
fn runs_repeat_to_the_bit_on_any_processor() {
    let planes = [SLANTED, NEAR];
    let (keyframe, mut first) = seeded(&planes, 2.0);
    let image = render(&planes, &poses()[0], 2.0, (1.0, 0.0), 2);
    let mut second = first.clone();
    let frame = stereo(&image, poses()[0]);
    let params = params();
    let mut observer = Observer::new((&keyframe, Shift::none(CAMERA)), &frame, &CAMERA, &params);
    observer.learn_noise(&mut second.sampled_residuals(&observer));
    let mut stats = UpdateStats::default();
    second.observe_all_plain(&observer, &mut stats);
    assert_eq!(first.update(&keyframe, &frame), stats);
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&first.inverse_depth), bits(&second.inverse_depth));
    assert_eq!(bits(&first.variance), bits(&second.variance));
}

#[test]
fn references_grow_in_baseline_and_see_the_keyframe() {
    let at = |x: f64, angle: f64| {
        Se3::new(UnitQuaternion::from_euler_angles(0.0, angle, 0.0), Vector3::new(x, 0.0, 0.0))
    };
    // Too near, far, good, turned away, good on the other side, too far.
    let candidates =
        [at(0.001, 0.0), at(0.14, 0.0), at(0.03, 0.0), at(0.05, 2.0), at(-0.06, 0.0), at(3.0, 0.0)];
    let chosen = choose_references(&candidates, 1.0, &CAMERA, &DepthParams::default());
    assert_eq!(chosen, [2, 4, 1]);
    assert!(choose_references(&[], 1.0, &CAMERA, &DepthParams::default()).is_empty());
}

/// What a sensor makes of the planes from a pose, where its camera moves so.
fn bent(planes: &[Plane], pose: &Se3, sensor: &Sensor, motion: &Twist) -> GrayImage {
    let mut image = GrayImage::filled(CAMERA.width, CAMERA.height, 0);
    for y in 0..CAMERA.height {
        for x in 0..CAMERA.width {
            let mut seen = trace(planes, pose, x as f64, y as f64);
            for _ in 0..2 {
                let [u, v] = sensor.undistorted_pixel([x as f64, y as f64], motion, seen.0);
                seen = trace(planes, pose, u, v);
            }
            image.set(x, y, seen.1.round() as u8);
        }
    }
    image
}

/// Lens and shutter bend keyframe and references by some pixels, each by others; depth does not suffer.
#[test]
fn what_lens_and_shutter_do_is_undone() {
    let sensor = Sensor::ideal(CAMERA).with([-0.03, 0.0, 0.025]);
    let motion = |k: usize| Twist::new(0.5, 0.4, -0.2, 0.8, -0.5, 0.6) * (1.0 - 0.5 * k as f64);
    let keyframe = bent(&[SLANTED], &Se3::identity(), &sensor, &motion(0));
    let seeds: Vec<SeedPoint> =
        seeds(&[SLANTED]).into_iter().map(|s| SeedPoint { variance: 0.01, ..s }).collect();
    let median = |by: &dyn Fn(usize) -> Shift| {
        let mut filter = DepthFilter::new(&keyframe, &CAMERA, by(0), &params());
        filter.seed(&seeds);
        for (k, pose) in (1..).zip(poses()) {
            let image = bent(&[SLANTED], &pose, &sensor, &motion(k));
            filter.update(&keyframe, &StereoFrame { shift: by(k), ..stereo(&image, pose) });
        }
        let mut errors = Vec::new();
        for (pixel, d, _) in filter.to_semi_dense().iter() {
            let (x, y) = (pixel as usize % CAMERA.width, pixel as usize / CAMERA.width);
            let [u, v] = sensor.undistorted_pixel([x as f64, y as f64], &motion(0), d as f64);
            let exact = trace(&[SLANTED], &Se3::identity(), u, v).0 as f32;
            errors.push((d - exact).abs() / exact);
        }
        errors.sort_by(f32::total_cmp);
        (errors.len(), errors[errors.len() / 2])
    };
    let (count, error) = median(&|k| Shift::new(&sensor, &motion(k)));
    let (count_without, error_without) = median(&|_| Shift::none(CAMERA));
    assert!(error < 0.005 && error < 0.2 * error_without, "{error}, without {error_without}");
    assert!(count > count_without, "{count} pixels, without {count_without}");
}
