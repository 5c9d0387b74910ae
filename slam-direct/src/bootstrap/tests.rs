//! First maps from rendered motions of which the truth is known.

use super::*;
use crate::mask::Mask;
use crate::test_scene::{CAMERA, View, pose, quantile, yard};
use geometry::GrayImage;
use loopbox_tests::{Cuboid, Recording, World};
use nalgebra::Vector3;

/// Ends of a run through the views.
struct Run {
    started: Option<Started>,
    /// Frames taken, the first included.
    frames: usize,
    restarts: usize,
}

/// Follows the views, ten a second, until there is a map. Restarts go on with the frame that caused them.
fn run(views: impl IntoIterator<Item = Pyramid>, params: &BootstrapParams) -> Run {
    run_at(10.0, views, params)
}

/// The same of so many views a second.
fn run_at(rate: f64, views: impl IntoIterator<Item = Pyramid>, params: &BootstrapParams) -> Run {
    let all = Params { bootstrap: params.clone(), ..Params::default() };
    let (mut start, mut run) = (None, Run { started: None, frames: 0, restarts: 0 });
    for pyramid in views {
        let (time, index) = (run.frames as f64 / rate, run.frames as u64);
        run.frames += 1;
        let Some(mut bootstrap) = start.take() else {
            start =
                Bootstrap::new(Sensor::ideal(CAMERA), pyramid, time, index, &Mask::default(), params.block);
            continue;
        };
        match Bootstrap::add(&mut bootstrap, &pyramid, time, index, &all) {
            Progress::Waiting(_) => start = Some(bootstrap),
            Progress::Restart(_) => {
                run.restarts += 1;
                start = Bootstrap::new(
                    Sensor::ideal(CAMERA),
                    pyramid,
                    time,
                    index,
                    &Mask::default(),
                    params.block,
                );
            }
            Progress::Done(started) => {
                run.started = Some(*started);
                break;
            }
        }
    }
    run
}

/// Poses with the camera `per_frame` metres farther each frame.
fn motion(count: usize, per_frame: [f64; 3]) -> impl Iterator<Item = Se3> {
    let [x, y, z] = per_frame;
    (0..count).map(move |i| i as f64).map(move |i| pose(x * i, y * i, z * i, 0.002 * i, 0.0))
}

/// Median relative error of the first keyframe's depths up to one scale, the share that is off by more than a
/// fifth, and the scale.
fn depth_errors(started: &Started, first: &View) -> (f64, f64, f64) {
    let points = started.map.keyframes[0].points.iter().filter(|p| first.smooth_around(p.pixel));
    let ratios: Vec<f64> = points.map(|p| p.inverse_depth / first.depth_at(p.pixel) as f64).collect();
    let scale = quantile(ratios.clone(), 0.5);
    let errors: Vec<f64> = ratios.iter().map(|r| (r / scale - 1.0).abs()).collect();
    let gross = errors.iter().filter(|&&e| e > 0.2).count() as f64 / errors.len() as f64;
    (quantile(errors, 0.5), gross, scale)
}

#[test]
fn sideways_forward_and_diagonal_motion_give_the_true_map() {
    for per_frame in [[0.03, 0.0, 0.0], [0.0, 0.0, 0.06], [-0.02, 0.01, 0.04]] {
        let poses: Vec<Se3> = motion(40, per_frame).collect();
        let first = View::new(poses[0]);
        let run = run(poses.iter().map(|&p| View::new(p).pyramid), &BootstrapParams::default());
        let started =
            run.started.unwrap_or_else(|| panic!("no map for {per_frame:?} in {} frames", run.frames));
        assert_eq!(run.restarts, 0);
        let (median, gross, scale) = depth_errors(&started, &first);
        assert!(median < 0.02 && gross < 0.05, "{per_frame:?}: median {median}, gross {gross}");
        let points = &started.map.keyframes[0].points;
        assert!(points.len() >= 40, "{per_frame:?}: {} points", points.len());
        let unit = quantile(points.iter().map(|p| p.inverse_depth).collect(), 0.5);
        assert!((unit - 1.0).abs() < 0.1, "the median depth is the unit: {unit}");
        assert_eq!(started.frames.len(), run.frames - 1);
        for (i, (_, index, frame_from_first)) in started.frames.iter().enumerate() {
            assert_eq!(*index, i as u64 + 1);
            let truth = poses[i + 1].inverse() * poses[0];
            let translation_error = frame_from_first.translation * scale - truth.translation;
            assert!(
                translation_error.norm() < 0.02 + 0.1 * truth.translation.norm(),
                "{per_frame:?} {i}: {translation_error}"
            );
            assert!(frame_from_first.rotation.angle_to(&truth.rotation) < 0.006, "{per_frame:?} {i}");
        }
    }
}

#[test]
fn the_two_keyframes_know_each_other() {
    let run = run(motion(40, [0.03, 0.0, 0.0]).map(|p| View::new(p).pyramid), &BootstrapParams::default());
    let started = run.started.unwrap();
    let [first, last] = &started.map.keyframes[..] else { panic!("there are two keyframes") };
    assert_eq!((first.frame_index, last.frame_index), (0, run.frames as u64 - 1));
    assert_eq!(first.camera_from_world, Se3::identity());
    assert_eq!(first.points.len(), last.seen.len());
    assert_eq!(started.map.covisible(0), [(1, first.points.len())]);
    assert!(first.points.iter().all(|p| p.alive && p.inverse_depth > 0.0 && p.variance > 0.0));
}

#[test]
fn a_pure_rotation_never_initialises_a_map() {
    let turned = |i: usize| View::new(pose(0.0, 0.0, 0.0, 0.006 * i as f64, 0.003 * (i as f64 * 0.5).sin()));
    let run = run((0..70).map(|i| turned(i).pyramid), &BootstrapParams::default());
    assert!(run.started.is_none(), "a map from frame {}", run.frames);
}

#[test]
fn a_still_camera_waits_and_begins_anew() {
    let params = BootstrapParams { max_seconds: 1.15, least_frames: 12, ..BootstrapParams::default() };
    let still = View::new(pose(0.0, 0.0, 0.0, 0.0, 0.0));
    let run = run((0..40).map(|_| still.pyramid.clone()), &params);
    assert!(run.started.is_none());
    assert_eq!(run.restarts, 3);
}

#[test]
fn a_slow_camera_starts_at_any_rate() {
    for (rate, frames) in [(10.0, 20), (120.0, 240)] {
        let poses = (0..frames).map(|i| pose(0.5 * i as f64 / frames as f64, 0.0, 0.0, 0.0, 0.0));
        let run = run_at(rate, poses.map(|p| View::new(p).pyramid), &BootstrapParams::default());
        assert!(run.started.is_some() && run.restarts == 0, "{rate} Hz: {} restarts", run.restarts);
    }
}

#[test]
fn black_and_flat_frames_are_refused_or_begin_anew() {
    let flat = |value| Pyramid::new(GrayImage::filled(CAMERA.width, CAMERA.height, value), 5);
    let params = BootstrapParams::default();
    assert!(Bootstrap::new(Sensor::ideal(CAMERA), flat(0), 0.0, 0, &Mask::default(), params.block).is_none());
    assert!(
        Bootstrap::new(Sensor::ideal(CAMERA), flat(255), 0.0, 0, &Mask::default(), params.block).is_none()
    );
    let seen = |x| View::new(pose(x, 0.0, 0.0, 0.0, 0.0)).pyramid;
    let run = run([seen(0.0), seen(0.02), flat(0), flat(0), seen(0.06), flat(255)], &params);
    assert!(run.started.is_none());
    assert_eq!(run.restarts, 2);
}

#[test]
fn another_scene_begins_anew() {
    let seen = |yaw| View::new(pose(0.0, 0.0, 0.0, yaw, 0.0)).pyramid;
    let run = run([seen(0.0), seen(0.01), seen(2.0)], &BootstrapParams::default());
    assert!(run.started.is_none());
    assert_eq!(run.restarts, 1);
}

/// A single textured wall, turned away from the image plane by `yaw`.
fn wall(yaw: f64) -> World {
    let template = yard().cuboids[1];
    let rotation = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw);
    let wall = Cuboid {
        world_from_cuboid: Se3::new(rotation, Vector3::new(0.0, 0.0, 9.0)),
        half: Vector3::new(30.0, 30.0, 0.0),
        texture: 0,
        ..template
    };
    let textures = vec![loopbox_tests::Texture::procedural(5)];
    World { cuboids: vec![wall], textures }
}

#[test]
fn a_plane_gives_a_right_map_or_none() {
    for (yaw, per_frame) in [(0.0, [0.03, 0.0, 0.0]), (0.5, [0.03, 0.0, 0.0]), (0.3, [0.02, 0.0, 0.03])] {
        let world = wall(yaw);
        let poses: Vec<Se3> = motion(40, per_frame).collect();
        let first = View::of(&world, poses[0]);
        let run = run(poses.iter().map(|&p| View::of(&world, p).pyramid), &BootstrapParams::default());
        let Some(started) = run.started else { continue };
        let (median, gross, _) = depth_errors(&started, &first);
        assert!(median < 0.04 && gross < 0.05, "{yaw} {per_frame:?}: median {median}, gross {gross}");
    }
}

/// Goes on with a start after its map, whose poses are those of `frame_from_first`; the map that contradicts it, and the
/// frames it took.
fn contradicted(
    poses: &[Se3],
    frame_from_first: impl Fn(usize) -> Se3,
    params: &BootstrapParams,
) -> (usize, Option<Started>) {
    let view = |i: usize| View::new(poses[i]).pyramid;
    let mut start = Bootstrap::new(Sensor::ideal(CAMERA), view(0), 0.0, 0, &Mask::default(), params.block)
        .expect("there is texture");
    let (mut has_map, all) = (false, Params { bootstrap: params.clone(), ..Params::default() });
    for i in 1..poses.len() {
        if !has_map {
            has_map = matches!(start.add(&view(i), i as f64, i as u64, &all), Progress::Done(_));
            continue;
        }
        let pose_of = |index: u64| Some(frame_from_first(index as usize));
        match start.look_again(&view(i), (i as f64, i as u64), &pose_of, &all) {
            SecondLook::Nothing => {}
            SecondLook::Over => return (i, None),
            SecondLook::Contradicted(started) => return (i, Some(*started)),
            SecondLook::TwoMotions => panic!("nothing moves"),
        }
    }
    assert!(has_map);
    (poses.len(), None)
}

#[test]
fn a_right_map_is_never_contradicted_in_whatever_unit() {
    let params = BootstrapParams::default();
    for per_frame in [[0.03, 0.0, 0.0], [0.0, 0.0, 0.06], [-0.02, 0.01, 0.04]] {
        let poses: Vec<Se3> = motion(40, per_frame).collect();
        let truth = |i: usize| {
            let pose = poses[i].inverse() * poses[0];
            Se3::new(pose.rotation, pose.translation * 0.2)
        };
        assert!(contradicted(&poses, truth, &params).1.is_none(), "{per_frame:?}");
    }
}

#[test]
fn a_map_that_mistakes_the_path_is_replaced_by_the_right_one() {
    let params = BootstrapParams::default();
    let poses: Vec<Se3> = motion(40, [0.03, 0.0, 0.0]).collect();
    // Part of the way sideways is taken for a turn, and the rest for one forward.
    let mistaken = |i: usize| {
        let turned = poses[i].inverse() * poses[0] * pose(0.0, 0.0, 0.0, 0.004 * i as f64, 0.0);
        Se3::new(turned.rotation, Vector3::new(0.0, 0.0, -0.006 * i as f64))
    };
    let (frame, started) = contradicted(&poses, mistaken, &params);
    let started = started.expect("the map is wrong");
    assert_eq!(started.frames.len(), frame);
    let (median, gross, _) = depth_errors(&started, &View::new(poses[0]));
    assert!(median < 0.02 && gross < 0.05, "median {median}, gross {gross}");
}

/// What a camera that swings says of its shutter, asked from its first frame on, when it reads an image in so many seconds.
fn readout_times(readout: f64) -> Option<[f64; 2]> {
    let camera = Recording::SMALL_CAMERA;
    let swing = |i: usize| {
        let time = i as f64 / 30.0;
        pose(0.01 * i as f64, 0.0, 0.0, 0.12 * (12.0 * time).sin(), 0.05 * (9.0 * time).cos())
    };
    let path: Vec<Se3> = (0..20).map(swing).collect();
    let recording = Recording::render_rolling(yard(), camera, &path, 30.0, readout);
    let pyramid = |i: usize| Pyramid::new(recording.shots[i].image.as_ref().clone(), 5);
    let mut turning = Bootstrap::new(Sensor::ideal(camera), pyramid(0), 0.0, 0, &Mask::default(), 16)
        .expect("there is texture");
    (1..recording.shots.len()).find_map(|i| {
        match turning.track_rotation(&pyramid(i), recording.shots[i].timestamp, i as u64, &Params::default())
        {
            Turned::Readout(readout) => Some(readout),
            Turned::On | Turned::Nothing => None,
        }
    })
}

#[test]
fn a_rolling_shutter_is_distinguished_from_a_global_one_while_the_camera_turns() {
    assert_eq!(readout_times(0.0), Some([0.0; 2]));
    for readout in [0.02, -0.02] {
        let [columns, rows] = readout_times(readout).expect("it turns for long enough");
        assert!(columns == 0.0 && (rows / readout - 1.0).abs() < 0.3, "{columns} {rows} of {readout}");
    }
}
