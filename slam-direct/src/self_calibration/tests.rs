use super::*;
use geometry::sensor::{Sensor, Twist};
use geometry::{Distortion, Pinhole, RadTan, Se3, Sim3};
use map::{FramePose, Keyframe, KeyframeId, Observation, Point, SemiDense};
use nalgebra::{Vector2, Vector3, Vector6};
use std::sync::Arc;

const SIZE: (usize, usize) = (640, 480);

fn lens(focal: f64, k1: f64) -> Camera {
    let pinhole = Pinhole { width: SIZE.0, height: SIZE.1, fx: focal, fy: focal, cx: 324.0, cy: 236.0 };
    let distortion = match k1 {
        0.0 => Distortion::None,
        _ => Distortion::RadTan(RadTan::new(&[k1, 0.0, 0.0, 0.0]).unwrap()),
    };
    Camera::new(pinhole, distortion).unwrap()
}

/// A deterministic number in ±1.
fn noise(i: usize) -> f64 {
    let x = ((i as f64 + 1.0) * 12.9898).sin() * 43758.5453;
    2.0 * (x - x.floor()) - 1.0
}

/// The map that is made with a guess at the lens of what `truth` sees along these poses (`world_from_camera`): raw pixels
/// with noise of `sigma`, poses and depths somewhat off.
fn map_of(truth: &Camera, guess: &Pinhole, poses: &[Se3], sigma: f64) -> Map {
    let mut map = Map::new(*guess);
    let mut count = 0;
    for (k, world_from_host) in poses.iter().enumerate() {
        let mut points = Vec::new();
        for i in 0..60 {
            let n = 60 * k + i;
            let pixel = Vector2::new(320.0 + 300.0 * noise(7 * n), 240.0 + 220.0 * noise(7 * n + 1));
            let depth = 3.0 + 2.0 * noise(7 * n + 2);
            let ray = truth.unproject(&pixel).unwrap();
            let x = ray * (depth / ray.z);
            let mut observations = Vec::new();
            for (j, world_from_other) in
                poses.iter().enumerate().filter(|(j, _)| *j != k && j.abs_diff(k) < 5)
            {
                let seen = world_from_other.inverse() * *world_from_host;
                let Some(at) = truth.project(&(seen.rotation_matrix() * x + seen.translation)) else {
                    continue;
                };
                if !truth.contains(&at) {
                    continue;
                }
                count += 1;
                let pixel =
                    [at.x + sigma * noise(3 * count), at.y + sigma * noise(3 * count + 1)].map(|v| v as f32);
                let information = 1.0 / (sigma * sigma).max(1e-4) as f32;
                observations.push(Observation {
                    keyframe: KeyframeId(j as u32),
                    pixel,
                    information: [information, 0.0, information],
                });
            }
            // Depths are somewhat off: the solver has to find them.
            let inverse_depth = (1.0 / depth * (1.0 + 0.05 * noise(n))) as f32;
            points.push(Point {
                pixel: [pixel.x as f32, pixel.y as f32],
                inverse_depth,
                variance: 1e-4,
                observations,
            });
        }
        let off = Se3::exp(&(Vector6::repeat(0.005) * noise(k)));
        let pose = if k == 0 { *world_from_host } else { off * *world_from_host };
        let mut keyframe = keyframe(k as u32, pose);
        keyframe.points = points;
        map.keyframes.insert(keyframe.id, keyframe);
    }
    map
}

fn keyframe(id: u32, pose: Se3) -> Keyframe {
    Keyframe {
        id: KeyframeId(id),
        agent: Default::default(),
        timestamp: f64::from(id),
        frame_index: u64::from(id),
        world_from_keyframe: Sim3::new(pose.rotation, pose.translation, 1.0),
        image: Arc::new(geometry::GrayImage::filled(SIZE.0, SIZE.1, 0)),
        color: None,
        scan: None,
        features: None,
        words: None,
        semi_dense: SemiDense::default().into(),
        points: Vec::new(),
    }
}

/// Sideways with turns of the camera.
fn around() -> Vec<Se3> {
    let pose = |i: usize| {
        let t = i as f64;
        let rotation_vector =
            Vector3::new(0.08 * (t * 0.9).sin(), 0.15 * (t * 0.5).sin(), 0.1 * (t * 0.7).cos());
        Se3::new(
            nalgebra::UnitQuaternion::from_scaled_axis(rotation_vector),
            Vector3::new(0.15 * t, 0.1 * (t * 0.8).sin(), 0.1 * (t * 0.3).cos()),
        )
    };
    (0..16).map(pose).collect()
}

/// Straight ahead without a turn.
fn ahead() -> Vec<Se3> {
    (0..16).map(|i| Se3::new(Default::default(), Vector3::new(0.0, 0.0, 0.05 * i as f64))).collect()
}

#[test]
fn a_focal_length_far_off_is_found() {
    let truth = lens(500.0, 0.0);
    for guess in [350.0, 650.0] {
        let guess = lens(guess, 0.0);
        let map = map_of(&truth, guess.intrinsics(), &around(), 0.2);
        let found = self_calibrate(&map, &guess, FreeLens::Focal, &LensPrior::default()).unwrap();
        let off = found.camera.intrinsics().fx / 500.0 - 1.0;
        assert!(off.abs() < 0.005, "{off} from {}", guess.intrinsics().fx);
        assert!(found.focal_deviation < 0.01, "{}", found.focal_deviation);
    }
}

#[test]
fn only_a_focal_length_that_is_off_is_contradicted() {
    let truth = lens(500.0, 0.0);
    let other = |guess: f64| {
        let guess = lens(guess, 0.0);
        let map = map_of(&truth, guess.intrinsics(), &around(), 0.2);
        other_focal_length(&map, &guess, 0.06).unwrap()
    };
    assert_eq!(other(500.0), None);
    assert_eq!(other(515.0), None);
    let found = other(600.0).expect("a fifth too long");
    assert!((found.camera.intrinsics().fx / 500.0 - 1.0).abs() < 0.01, "{found:?}");
    assert!(found.focal_deviation < 0.01, "{found:?}");
}

#[test]
fn a_sample_keeps_the_observations_of_its_points() {
    let truth = lens(500.0, 0.0);
    let map = map_of(&truth, truth.intrinsics(), &around(), 0.2);
    let problem = || Problem::new(&map, 0..16, &truth, FreeLens::Focal, &LensPrior::default()).unwrap();
    let (whole, mut sample) = (problem(), problem());
    let most = whole.observations.len() / 3;
    sample.thin(most);
    assert!(sample.observations.len().abs_diff(most) < most / 10, "{}", sample.observations.len());
    let seen = |problem: &Problem, i: usize| {
        let point = &problem.points[i];
        let seen = problem.observations[point.observations.clone()].iter();
        (point.pixel, seen.map(|observation| observation.pixel).collect::<Vec<_>>())
    };
    let all: Vec<_> = (0..whole.points.len()).map(|i| seen(&whole, i)).collect();
    for i in 0..sample.points.len() {
        assert!(all.contains(&seen(&sample, i)), "point {i} of the sample");
    }
    sample.thin(usize::MAX);
    assert!(sample.observations.len().abs_diff(most) < most / 10, "nothing is left out where all is wanted");
}

#[test]
fn the_whole_lens_is_found() {
    let truth = lens(500.0, -0.12);
    let guess = lens(560.0, 0.0);
    let map = map_of(&truth, guess.intrinsics(), &around(), 0.2);
    let found = self_calibrate(&map, &guess, FreeLens::All, &LensPrior::default()).unwrap();
    let pinhole = found.camera.intrinsics();
    assert!((pinhole.fx / 500.0 - 1.0).abs() < 0.01, "{pinhole:?}");
    for pixel in [[60.0, 40.0], [320.0, 240.0], [560.0, 300.0]] {
        let pixel = Vector2::from(pixel);
        let off = truth.project(&found.camera.unproject(&pixel).unwrap()).unwrap() - pixel;
        assert!(off.norm() < 3.0, "{off:?} at {pixel:?}");
    }
}

/// What the map of an ideal camera would show had the camera moved by `twist`, a second, while its rows were read one after the
/// other in `readout` seconds; the map knows of both.
fn rolling(mut map: Map, camera: &Pinhole, twist: &Twist, readout: f64) -> Map {
    let sensor = Sensor { readout: [0.0, readout], ..Sensor::ideal(*camera) };
    let about = map.agents.values_mut().next().expect("the agent of every map");
    about.provenance.extend(map::sensor_entries(&sensor).map(|(key, text)| (key.to_owned(), text)));
    let worlds: Vec<Sim3> = map.keyframes.values().map(|keyframe| keyframe.world_from_keyframe).collect();
    for (k, keyframe) in map.keyframes.values_mut().enumerate() {
        let frame = |seconds: f64| FramePose {
            timestamp: keyframe.timestamp + seconds,
            frame_index: 0,
            reference: keyframe.id,
            keyframe_from_frame: Se3::exp(&(twist * seconds)).inverse(),
        };
        map.frames.extend([-0.03, 0.0, 0.03].map(frame));
        let bent = |pixel: [f32; 2], inverse_depth: f64| {
            sensor.distorted_pixel(pixel.map(f64::from), twist, inverse_depth).map(|v| v as f32)
        };
        for point in &mut keyframe.points {
            let inverse_depth = f64::from(point.inverse_depth);
            let x = camera.unproject(point.pixel[0].into(), point.pixel[1].into()) / inverse_depth;
            for seen in &mut point.observations {
                let depth = (worlds[seen.keyframe.0 as usize].inverse() * (worlds[k] * x)).z;
                seen.pixel = bent(seen.pixel, 1.0 / depth);
            }
            point.pixel = bent(point.pixel, inverse_depth);
        }
    }
    map
}

/// Upwards at 60° a second an image comes out higher by 2.5 % than the lens shows it.
#[test]
fn a_rolling_shutter_is_not_taken_for_the_lens() {
    let truth = lens(500.0, 0.0);
    let camera = truth.intrinsics();
    let twist = Twist::new(0.2, 0.0, 0.0, 1.05, 0.0, 0.0);
    let map = rolling(map_of(&truth, camera, &around(), 0.2), camera, &twist, 0.024);
    let found = self_calibrate(&map, &truth, FreeLens::All, &LensPrior::default()).unwrap();
    let off = found.camera.intrinsics().fx / 500.0 - 1.0;
    assert!(off.abs() < 0.002, "{off}");
    let shifted = found.camera.intrinsics().cy - camera.cy;
    assert!(shifted.abs() < 1.0, "{shifted} pixels");
}

#[test]
fn straight_motion_leaves_the_focal_length_open() {
    let truth = lens(500.0, 0.0);
    let deviation = |poses: &[Se3]| {
        let map = map_of(&truth, truth.intrinsics(), poses, 0.2);
        self_calibrate(&map, &truth, FreeLens::All, &LensPrior::default()).unwrap().focal_deviation
    };
    let (around, ahead) = (deviation(&around()), deviation(&ahead()));
    assert!(ahead > 3.0 * around, "{around} {ahead}");
}

#[test]
fn a_map_of_nothing_is_too_small() {
    let truth = lens(500.0, 0.0);
    let map = map_of(&truth, truth.intrinsics(), &around()[..4], 0.2);
    let refused = self_calibrate(&map, &truth, FreeLens::Focal, &LensPrior::default());
    assert!(matches!(refused, Err(SelfCalibrationError::TooSmall { keyframes: 4, .. })), "{refused:?}");
    let nothing = Map::new(*truth.intrinsics());
    assert!(self_calibrate(&nothing, &truth, FreeLens::All, &LensPrior::default()).is_err());
}
