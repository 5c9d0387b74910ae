//! ROS 2 bags in SQLite as sources, through the binary.
#![cfg(feature = "sqlite")]

mod common;

use common::*;
use image::ImageFormat;
use tempfile::tempdir;

/// A little-endian CDR message of words and of bytes with their length before them.
#[derive(Default)]
struct Cdr(Vec<u8>);

impl Cdr {
    fn number<const N: usize>(mut self, bytes: [u8; N]) -> Self {
        self.0.resize(self.0.len().next_multiple_of(N), 0);
        self.0.extend(bytes);
        self
    }

    fn word(self, word: u32) -> Self {
        self.number(word.to_le_bytes())
    }

    fn bytes(mut self, bytes: &[u8]) -> Self {
        self = self.word(bytes.len() as u32);
        self.0.extend(bytes);
        self
    }

    fn message(self) -> Vec<u8> {
        [&[0, 1, 0, 0], &self.0[..]].concat()
    }
}

#[test]
fn ros2_bags_in_sqlite_are_read_like_others() {
    let bag = tempdir().unwrap();
    write(bag.path().join("metadata.yaml"), "rosbag2_bagfile_information:\n  version: 5\n");
    let topics = [
        ("/cam0/image_raw/compressed", "sensor_msgs/msg/CompressedImage"),
        ("/cam0/camera_info", "sensor_msgs/msg/CameraInfo"),
        ("/imu", "sensor_msgs/msg/Imu"),
    ];
    let header = |i: u32| Cdr::default().word(1700000000).word(i * 100_000_000).bytes(b"cam0\0");
    let image = |i: u32| header(i).bytes(b"png\0").bytes(&encoded(i, ImageFormat::Png)).message();
    let camera = [80.0, 0.0, 47.5, 0.0, 80.0, 31.5, 0.0, 0.0, 1.0f64];
    let info_message = header(0).word(64).word(96).bytes(b"plumb_bob\0").word(0);
    let rectification = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = [80.0, 0.0, 47.5, 0.0, 0.0, 80.0, 31.5, 0.0, 0.0, 0.0, 1.0, 0.0];
    let numbers = camera.into_iter().chain(rectification).chain(projection);
    let info_message = numbers.fold(info_message, |m, v| m.number(v.to_le_bytes()));
    // No binning, and no region of interest.
    let info_message = (0..7).fold(info_message, |m, _| m.word(0)).message();
    // The recorder was late by 50 ms: stamps are the camera's. The bag was split, the later file first by its name.
    let received = |i: u32| 1_700_000_000_050_000_000 + i64::from(i) * 100_000_000;
    let rest: Vec<_> = (2..4).map(|i| (0, received(i), image(i))).collect();
    write_db3(&bag.path().join("bag_10.db3"), &topics, &rest);
    let mut first: Vec<_> = (0..2).map(|i| (0, received(i), image(i))).collect();
    first.extend([(1, received(0), info_message), (2, received(1), vec![0, 1, 0, 0])]);
    write_db3(&bag.path().join("bag_9.db3"), &topics, &first);

    let printed = info(bag.path(), &[]);
    assert_eq!((&printed["kind"], &printed["frames"]), (&"ROS 2 bag".into(), &4.into()));
    assert_eq!(printed["size"], serde_json::json!([96, 64]));
    assert!(printed["calibration"].as_str().unwrap().contains("/cam0/camera_info"), "{printed}");
    let times: Vec<f64> = (0..4).map(|i| 1700000000.0 + f64::from(i) * 0.1).collect();
    assert_eq!(processed_times(&read_through(bag.path(), &[])), times);
    assert_eq!(info(&bag.path().join("bag_9.db3"), &[])["frames"], 2);

    let folder = tempdir().unwrap();
    let out = folder.path().join("images");
    let output = loopbox(&["convert", arg(bag.path()), arg(&out)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(processed_times(&read_through(&out, &[])), times);
    for i in 0..4 {
        let kept = std::fs::read(out.join(format!("images/{i:06}.png"))).unwrap();
        assert_eq!(kept, encoded(i, ImageFormat::Png), "encoded images pass as they are");
    }
    assert_refused(&["info", arg(bag.path()), "--topic", "/imu"], &["no images on topic /imu", "/cam0"]);
    write(bag.path().join("bag_11.db3"), "SQLite format 3\0 cut off");
    assert_refused(&["info", arg(bag.path())], &["bag_11.db3", "cannot be read"]);
}
