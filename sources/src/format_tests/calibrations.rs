//! Calibrations that come with images, and those that change while these go on.

use super::*;
use crate::bag::{BagWriter, MessageType};
use crate::{FoundCalibration, SourceFrame};
use calib::CameraHint;

/// A message of a calibration with this focal length, pixels; in CDR, or as ROS 1 writes it.
fn camera_info(time: u64, focal: f64, is_cdr: bool) -> Vec<u8> {
    let mut body = Vec::new();
    let mut put = |bytes: &[u8]| {
        let size = if is_cdr { bytes.len().clamp(1, 8) } else { 1 };
        body.resize(body.len().next_multiple_of(size), 0u8);
        body.extend(bytes);
    };
    if !is_cdr {
        put(&0u32.to_le_bytes());
    }
    put(&((time / 1_000_000_000) as u32).to_le_bytes());
    put(&((time % 1_000_000_000) as u32).to_le_bytes());
    let text = |put: &mut dyn FnMut(&[u8]), text: &str| {
        let end = if is_cdr { "\0" } else { "" };
        let bytes = format!("{text}{end}");
        put(&(bytes.len() as u32).to_le_bytes());
        bytes.bytes().for_each(|byte| put(&[byte]));
    };
    text(&mut put, "cam");
    put(&12u32.to_le_bytes());
    put(&16u32.to_le_bytes());
    text(&mut put, "plumb_bob");
    put(&0u32.to_le_bytes());
    let k = match focal {
        0.0 => [0.0; 9],
        focal => [focal, 0.0, 7.5, 0.0, focal, 5.5, 0.0, 0.0, 1.0],
    };
    let r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    k.iter().chain(&r).chain(&[0.0; 12]).for_each(|number| put(&number.to_le_bytes()));
    (0..6).for_each(|_| put(&0u32.to_le_bytes()));
    put(&[0]);
    if is_cdr { [&[0, 1, 0, 0][..], &body].concat() } else { body }
}

/// Which of ten images are those of the first calibration, if the focal length is this at each of them.
fn kept(source: &mut dyn FrameSource, expects_camera: bool) -> (Vec<u64>, Vec<String>) {
    if let Some(FoundCalibration::Inside { camera, .. }) = source.info().calibration.clone()
        && expects_camera
    {
        source.expect_camera(&camera);
    }
    let (mut kept, mut reasons) = (Vec::new(), Vec::new());
    while let Some(SourceFrame { index, picture, .. }) = source.next_frame() {
        match picture.into_grey() {
            Ok(_) => kept.push(index),
            Err(reason) => reasons.push(reason),
        }
    }
    (kept, reasons)
}

const INFO: &str = "/cam/camera_info";
const IMAGE: &str = "/cam/image_raw";

/// Messages of images, each behind that of its calibration.
fn messages(focal: fn(usize) -> f64, which: std::ops::Range<usize>) -> Vec<(&'static str, u64, Vec<u8>)> {
    let both = |i: usize| {
        let time = nanoseconds(i);
        [(INFO, time, camera_info(time, focal(i), true)), (IMAGE, time, cdr(time))]
    };
    which.flat_map(both).collect()
}

fn write_mcap(path: &Path, focal: fn(usize) -> f64, which: std::ops::Range<usize>) {
    let schema = |topic| if topic == INFO { "sensor_msgs/msg/CameraInfo" } else { "sensor_msgs/msg/Image" };
    let all = messages(focal, which);
    let all: Vec<_> =
        all.into_iter().map(|(topic, time, data)| (topic, schema(topic), "cdr", time, data)).collect();
    mcap_file(path, None, &all);
}

/// What happens to a camera, its focal length at each image, and the images that are kept.
type Row = (&'static str, fn(usize) -> f64, Vec<u64>);

#[test]
fn images_of_another_calibration_are_left_out() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    let open = || open(&path, &SourceOptions::default()).unwrap();
    let rows: [Row; 4] = [
        // Whether a message is that of the image before it or behind it nobody knows.
        ("a zoom", |i| if i < 6 { 20.0 } else { 30.0 }, (0..5).collect()),
        (
            "a zoom that is taken back",
            |i| if (3..5).contains(&i) { 30.0 } else { 20.0 },
            vec![0, 1, 5, 6, 7, 8, 9],
        ),
        ("a zoom in steps", |i| 20.0 * 1.1f64.powi(i as i32), vec![]),
        ("a focus that follows", |i| 20.0 + 0.01 * (i as f64).sin(), (0..10).collect()),
    ];
    for (what, focal, expected) in rows {
        write_mcap(&path, focal, 0..10);
        let (found, reasons) = kept(open().as_mut(), true);
        assert_eq!(found, expected, "{what}");
        for reason in &reasons {
            assert!(
                reason.contains("calibration changes: from frame") && reason.contains("--start"),
                "{reason}"
            );
        }
        // With a calibration that the user gives it is his own affair.
        assert_eq!(kept(open().as_mut(), false).0.len(), 10, "{what}");
    }
    write_mcap(&path, |i| if i < 6 { 20.0 } else { 30.0 }, 0..10);
    let (_, reasons) = kept(open().as_mut(), true);
    for word in ["from frame 5, 0.50 s after the first", "fx 30.0", "before it was", "fx 20.0"] {
        assert!(reasons[0].contains(word), "{}", reasons[0]);
    }
}

#[test]
fn parts_of_a_recording_are_held_to_one_calibration() {
    let room = tempdir().unwrap();
    for (part, which) in [(0, 0..4), (1, 4..7), (2, 7..10)] {
        let focal: fn(usize) -> f64 = |i| if (4..7).contains(&i) { 25.0 } else { 20.0 };
        write_mcap(&room.path().join(format!("bag_{part}.mcap")), focal, which);
    }
    let mut source = open(room.path(), &SourceOptions::default()).unwrap();
    let (found, reasons) = kept(source.as_mut(), true);
    assert_eq!((found, reasons.len()), (vec![0, 1, 2, 3, 7, 8, 9], 3), "{reasons:?}");
}

#[test]
fn bags_are_held_to_one_calibration() {
    let focal: fn(usize) -> f64 = |i| if i < 7 { 20.0 } else { 24.0 };
    let room = tempdir().unwrap();
    let path = room.path().join("a.bag");
    let mut writer = BagWriter::create(fs::File::create(&path).unwrap()).unwrap();
    let kind = |name| MessageType { name, md5sum: "", definition: "" };
    let info = writer.connect(INFO, kind("sensor_msgs/CameraInfo"));
    let image = writer.connect("/cam/image_raw/compressed", kind("sensor_msgs/CompressedImage"));
    for i in 0..10 {
        let time = nanoseconds(i);
        writer.message(info, time, &camera_info(time, focal(i), false)).unwrap();
        let mut message: Vec<u8> = [0, (time / 1_000_000_000) as u32, (time % 1_000_000_000) as u32, 0, 0]
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect();
        message.extend((png().len() as u32).to_le_bytes());
        message.extend(png());
        writer.message(image, time, &message).unwrap();
    }
    writer.finish().unwrap();
    let (found, reasons) = kept(open(&path, &SourceOptions::default()).unwrap().as_mut(), true);
    assert_eq!((found, reasons.len()), ((0..6).collect(), 4), "{reasons:?}");
}

#[cfg(feature = "sqlite")]
#[test]
fn bags_in_sqlite_are_held_to_one_calibration() {
    let room = tempdir().unwrap();
    let path = room.path().join("bag_0.db3");
    let database = rusqlite::Connection::open(&path).unwrap();
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
             INSERT INTO topics VALUES (1, '/cam/camera_info', 'sensor_msgs/msg/CameraInfo', 'cdr');
             INSERT INTO topics VALUES (2, '/cam/image_raw', 'sensor_msgs/msg/Image', 'cdr');",
        )
        .unwrap();
    for (topic, time, data) in messages(|i| if i < 3 { 20.0 } else { 22.0 }, 0..10) {
        let row = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        database.execute(row, (1 + i64::from(topic == IMAGE), time as i64, data)).unwrap();
    }
    drop(database);
    let (found, reasons) = kept(open(&path, &SourceOptions::default()).unwrap().as_mut(), true);
    assert_eq!((found, reasons.len()), (vec![0, 1], 8), "{reasons:?}");
}

/// Drivers send K = 0 until they have read their calibration.
#[test]
fn a_driver_that_knows_its_calibration_later_is_calibrated() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    write_mcap(&path, |i| if i < 3 { 0.0 } else { 20.0 }, 0..10);
    let mut source = open(&path, &SourceOptions::default()).unwrap();
    assert!(
        matches!(&source.info().calibration, Some(FoundCalibration::Inside { camera, .. }) if camera.intrinsics().fx == 20.0)
    );
    assert_eq!(kept(source.as_mut(), true).0.len(), 10);
    write_mcap(&path, |_| 0.0, 0..10);
    let source = open(&path, &SourceOptions::default()).unwrap();
    assert!(matches!(source.info().calibration, Some(FoundCalibration::Uncalibrated { .. })));
}

#[test]
fn a_camera_is_given_no_other_ones_calibration() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    let images = |topics: &[&'static str], info: &'static str| {
        let mut all = Vec::new();
        for i in 0..4 {
            let time = nanoseconds(i);
            all.push((info, "sensor_msgs/msg/CameraInfo", "cdr", time, camera_info(time, 20.0, true)));
            all.extend(topics.iter().map(|topic| (*topic, "sensor_msgs/msg/Image", "cdr", time, cdr(time))));
        }
        mcap_file(&path, None, &all);
    };
    let found = |topic: &str| {
        let options = SourceOptions { topic: Some(topic.into()), ..SourceOptions::default() };
        open(&path, &options).unwrap().info().calibration.clone()
    };
    for (own, others) in [
        (["/rear/image", "/rear/camera_info"], ["/front/image", "/left/image"]),
        (["/cam1/image_raw", "/cam1/camera_info"], ["/cam10/image_raw", "/cam0/image_raw"]),
        (
            ["/camera/depth/image_rect", "/camera/depth/camera_info"],
            ["/camera/color/image_raw", "/camera/infra1/image_rect"],
        ),
    ] {
        images(&[own[0], others[0], others[1]], own[1]);
        assert!(matches!(found(own[0]), Some(FoundCalibration::Inside { .. })), "{own:?}");
        for other in others {
            assert!(found(other).is_none(), "{other} {:?}", found(other));
        }
        // Where it is the only camera with images, that another's calibration is there says nothing.
        images(&others[..1], own[1]);
        let Some(FoundCalibration::Unusable { reason, .. }) = found(others[0]) else { panic!("{others:?}") };
        assert!(reason.contains("nothing tells whether it is the camera's"), "{reason}");
    }
}

/// Calibration files of other tools beside images are named with how to take them, and nothing else is.
#[test]
fn sidecar_calibration_files_of_images_are_named() {
    let chain = |names: &[&str]| -> String {
        names
            .iter()
            .map(|name| {
                format!(
                    "{name}:\n  camera_model: pinhole\n  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]\n  distortion_model: radtan\n  \
                     intrinsics: [20, 20, 7.5, 5.5]\n  resolution: [16, 12]\n"
                )
            })
            .collect()
    };
    let orb = "%YAML:1.0\nCamera.fx: 20\nCamera.fy: 20\nCamera.cx: 7.5\nCamera.cy: 5.5\nCamera.k1: -0.1\nCamera.fps: 15.0\n";
    let ros = "image_width: 16\nimage_height: 12\ncamera_name: left\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [20, 0, 7.5, 0, 20, 5.5, 0, 0, 1]\n\
               distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.1, 0, 0, 0, 0]\n";
    let xml = "<?xml version=\"1.0\"?>\n<opencv_storage><image_width>16</image_width><image_height>12</image_height><Camera_Matrix \
               type_id=\"opencv-matrix\"><rows>3</rows><cols>3</cols><dt>d</dt><data>20 0 7.5 0 20 5.5 0 0 1</data></Camera_Matrix>\
               <Distortion_Coefficients type_id=\"opencv-matrix\"><rows>5</rows><cols>1</cols><dt>d</dt><data>-0.1 0 0 0 0</data>\
               </Distortion_Coefficients></opencv_storage>";
    let nerf = r#"{"fl_x": 20.0, "fl_y": 20.0, "cx": 8.0, "cy": 6.0, "w": 16, "h": 12, "k1": -0.1, "camera_model": "OPENCV", "frames": []}"#;
    let kitti = "P0: 20 0 7.5 0 0 20 5.5 0 0 0 1 0\nP1: 20 0 7.5 -8 0 20 5.5 0 0 0 1 0\n";
    let heading = "# timestamp tx ty tz qx qy qz qw : world_from_camera\n";
    let row = |second: usize| format!("{second}.066667 -3.28 -6.51 1.31 -0.14 0.69 -0.68 0.14\n");
    let trajectory = heading.to_owned() + &(0..12).map(row).collect::<String>();
    for (name, text, words) in [
        ("camchain.yaml", chain(&["cam0"]), "--calib #camchain.yaml takes it"),
        (
            "camchain-imucam.yaml",
            chain(&["cam0", "cam1"]),
            "(cam0, cam1), and it is not used\nhint: name one, as --calib #camchain-imucam.yaml:cam0",
        ),
        ("transforms.json", nerf.to_owned(), "--calib #transforms.json takes it"),
        (
            "sparse/0/cameras.txt",
            "# Camera list\n1 OPENCV 16 12 20 20 8 6 -0.1 0.01 0 0\n".to_owned(),
            "--calib #sparse/0/cameras.txt takes it",
        ),
        ("ORB.yaml", orb.to_owned(), "--calib #ORB.yaml takes it"),
        ("left.yaml", ros.to_owned(), "--calib #left.yaml takes it"),
        ("calib.xml", xml.to_owned(), "--calib #calib.xml takes it"),
        ("calib.txt", kitti.to_owned(), "(image_00, image_01), and it is not used"),
        ("calib/mei.yaml", chain(&["cam0"]).replace("pinhole", "omni"), "which cannot be used"),
    ] {
        let images: Vec<String> = (0..4).map(|i| format!("images/{i}.png")).collect();
        let mut files: Vec<(&str, &[u8])> = images.iter().map(|image| (image.as_str(), &[][..])).collect();
        files.push((name, text.as_bytes()));
        files.push(("times.txt", b"10.0\n10.1\n10.2\n10.3\n"));
        files.push(("groundtruth.txt", trajectory.as_bytes()));
        files.push(("notes.txt", b"the camera of the second floor, fx unknown"));
        files.push(("run.json", b"{\"camera\": {\"fx\": 3}}"));
        let room = folder(&files);
        let source = open(room.path(), &SourceOptions::default()).unwrap();
        assert!(source.info().calibration.is_none(), "{name}");
        let refusal = crate::sidecar_calibrations(source.info());
        let words = words.replace('#', &format!("{}/", room.path().display()));
        assert!(refusal.len() == 1 && refusal[0].contains(&words), "{name}: {refusal:?}");
        // What is named can be given.
        if words.contains("takes it") {
            let hint: &CameraHint = &source.info().camera;
            assert_eq!(
                calib::read_camera_of(&room.path().join(name), hint).unwrap().camera.intrinsics().width,
                16
            );
        }
    }
}
