use super::*;
use geometry::{GrayImage, Pinhole};
use map::{AgentInfo, FramePose, Keyframe, KeyframeId, Sensor};
use nalgebra::{UnitQuaternion, Vector3};
use std::sync::Arc;

/// The camera looks ahead, 20 cm before the LiDAR and 30 cm below.
fn lidar_from_camera() -> Se3 {
    extrinsic("0.2, 0.05, -0.3, -0.5, 0.5, -0.5, 0.5").unwrap()
}

/// Where the LiDAR is, `metres` along a way that bends.
fn world_from_lidar(time: f64, metres: f64) -> Se3 {
    let yaw = 0.4 * (0.5 * time).sin();
    Se3::new(
        UnitQuaternion::from_scaled_axis(Vector3::z() * yaw),
        Vector3::new(metres * time / 10.0, 0.2 * metres * (0.3 * time).sin(), 0.0),
    )
}

/// A map whose frames are at `poses`, each against the first, in a world and unit of its own.
fn map(sensor: impl Into<Sensor>, poses: &[(f64, Se3)], unit: f64) -> Map {
    let mut map = Map::of(AgentInfo::new("one", sensor));
    let (first, id) = (poses[0].1.inverse(), KeyframeId(0));
    let image = Arc::new(GrayImage::filled(8, 6, 90));
    map.keyframes.insert(id, Keyframe::of_image(id, poses[0].0, 0, Sim3::identity(), image));
    map.frames.extend(poses.iter().zip(0..).map(|((timestamp, pose), frame_index)| {
        let mut keyframe_from_frame = first * *pose;
        keyframe_from_frame.translation /= unit;
        FramePose { timestamp: *timestamp, frame_index, reference: id, keyframe_from_frame }
    }));
    map
}

/// The maps of a robot on its way of `metres`; the camera's clock is `late`.
fn rig(metres: f64, late: f64) -> [Map; 2] {
    let camera = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
    let at = |time: f64| world_from_lidar(time, metres);
    let scans: Vec<_> = (0..100).map(|i| 0.1 * f64::from(i) + 0.05).map(|t| (t, at(t))).collect();
    let images: Vec<_> =
        (0..300).map(|i| f64::from(i) / 30.0).map(|t| (t + late, at(t) * lidar_from_camera())).collect();
    [map(camera, &images, 3.7), map(Sensor::Lidar, &scans, 1.0)]
}

#[test]
fn a_cameras_map_gets_scale_and_pose_from_the_lidar_on_its_rig() {
    let [camera, lidar] = rig(8.0, 0.0);
    let tied = tie(&camera, &lidar, &lidar_from_camera()).unwrap();
    assert!((tied.lidar_world_from_camera_world.scale / 3.7 - 1.0).abs() < 1e-3, "{tied:?}");
    // The LiDAR's world is at its first sweep, the camera's at its first image.
    let start = world_from_lidar(0.05, 8.0).inverse() * world_from_lidar(0.0, 8.0) * lidar_from_camera();
    let off = start.inverse() * tied.lidar_world_from_camera_world.rigid();
    assert!(off.translation.norm() < 5e-3 && off.rotation.angle() < 2e-3, "{off:?}");
    let there = tied.lidar_world_from_camera(4.02).unwrap();
    let truth = world_from_lidar(0.05, 8.0).inverse() * world_from_lidar(4.02, 8.0) * lidar_from_camera();
    assert!((truth.inverse() * there).log().norm() < 2e-3);
    assert!(tied.lidar_world_from_camera(40.0).is_none());
}

#[test]
fn what_tells_no_metres_is_refused_by_its_reason() {
    let known = lidar_from_camera();
    let upside_down =
        known * Se3::new(UnitQuaternion::from_scaled_axis(Vector3::x() * 0.5), Vector3::zeros());
    for (metres, late, extrinsic, reason) in [
        (0.3, 0.0, known, "drive farther"),
        (8.0, 100.0, known, "one clock"),
        (8.0, 0.0, upside_down, "the extrinsic is another one"),
        (8.0, 1.5, known, "their clocks differ"),
    ] {
        let [camera, lidar] = rig(metres, late);
        let error = format!("{:#}", tie(&camera, &lidar, &extrinsic).unwrap_err());
        assert!(error.contains(reason), "{metres} {late}: {error}");
    }
    let [camera, lidar] = rig(8.0, 0.0);
    assert!(format!("{:#}", tie(&lidar, &camera, &known).unwrap_err()).contains("has a LiDAR"));
    // The camera stood at another robot's place, which turned as this one did.
    let mut stood = camera;
    stood.frames.iter_mut().for_each(|frame| frame.keyframe_from_frame.translation = Vector3::zeros());
    let error = format!("{:#}", tie(&stood, &lidar, &known).unwrap_err());
    assert!(error.contains("does not tell metres"), "{error}");
}

#[test]
fn extrinsics_are_numbers_or_a_file_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let rows = write("rows.txt", "0 0 1 0.2\n-1 0 0 0.05\n0 -1 0 -0.3\n");
    let seven = write("seven.txt", "0.2 0.05 -0.3 -0.5 0.5 -0.5 0.5\n");
    for file in [rows, seven] {
        assert!((extrinsic(&file).unwrap().inverse() * lidar_from_camera()).log().norm() < 1e-9, "{file}");
    }
    let mirrored = write("mirrored.txt", "0 0 1 0 1 0 0 0 0 1 0 0\n-");
    let no_rotation = write("no.txt", "1 0 0 0 0 -1 0 0 0 0 1 0");
    for (bad, reason) in [
        ("0,0,0,0,0,0,2", "length 2.000"),
        ("0,0,0", "not 3"),
        ("nowhere.txt", "neither a pose nor a file"),
        (&mirrored, "not a list of numbers"),
        (&no_rotation, "no rotation"),
    ] {
        let error = format!("{:#}", extrinsic(bad).unwrap_err());
        assert!(error.contains(reason), "{bad}: {error}");
    }
}
