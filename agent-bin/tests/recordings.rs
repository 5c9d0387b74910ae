//! MCAP files as sources, through the binary.

mod common;

use common::*;
use foxglove::Encode;
use foxglove::messages::{CameraCalibration, CompressedImage, RawImage, Timestamp};
use image::ImageFormat;
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use tempfile::tempdir;

/// Writes messages of one topic each.
struct Recording {
    writer: Writer<BufWriter<File>>,
    channels: BTreeMap<&'static str, u16>,
}

impl Recording {
    fn create(path: &Path, compression: Option<Compression>) -> Self {
        let file = BufWriter::new(File::create(path).unwrap());
        // Small chunks, so that a truncated file has whole ones.
        let options = WriteOptions::new().compression(compression).chunk_size(Some(20_000));
        Self { writer: options.create(file).unwrap(), channels: BTreeMap::new() }
    }

    fn add(&mut self, topic: &'static str, schema: &str, encoding: &str, time: f64, data: &[u8]) {
        let writer = &mut self.writer;
        let channel_id = *self.channels.entry(topic).or_insert_with(|| {
            let schema = writer.add_schema(schema, "unused", b"").unwrap();
            writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
        });
        let log_time = (time * 1e9).round() as u64;
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, data).unwrap();
    }

    fn add_foxglove<T: Encode>(&mut self, topic: &'static str, schema: &str, time: f64, message: &T) {
        let mut data = Vec::new();
        assert!(message.encode(&mut data).is_ok());
        self.add(topic, schema, "protobuf", time, &data);
    }

    fn compressed(&mut self, topic: &'static str, index: u32) {
        let time = 10.0 + index as f64 * 0.1;
        let message = CompressedImage {
            timestamp: Some(Timestamp::new(10, index * 100_000_000)),
            data: encoded(index, ImageFormat::Jpeg).into(),
            format: "jpeg".into(),
            ..CompressedImage::default()
        };
        self.add_foxglove(topic, "foxglove.CompressedImage", time, &message);
    }

    fn calibration(&mut self, topic: &'static str) {
        let message = CameraCalibration {
            width: WIDTH,
            height: HEIGHT,
            k: vec![80.0, 0.0, 47.5, 0.0, 80.0, 31.5, 0.0, 0.0, 1.0],
            ..CameraCalibration::default()
        };
        self.add_foxglove(topic, "foxglove.CameraCalibration", 9.9, &message);
    }

    fn finish(mut self) {
        self.writer.finish().unwrap();
    }
}

#[test]
fn foxglove_compressed_with_its_own_calibration() {
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let folder = tempdir().unwrap();
        let path = folder.path().join("walk.mcap");
        let mut recording = Recording::create(&path, compression);
        recording.calibration("/camera/calibration");
        (0..4).for_each(|i| recording.compressed("/camera/image", i));
        recording.finish();
        let printed = info(&path, &[]);
        assert_eq!((&printed["frames"], &printed["size"]), (&4.into(), &serde_json::json!([96, 64])));
        assert!(printed["calibration"].as_str().unwrap().contains("/camera/calibration"));
        assert_eq!(processed_times(&read_through(&path, &[])), [10.0, 10.1, 10.2, 10.3]);
    }
}

#[test]
fn foxglove_raw_and_json() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("raw.mcap");
    let mut recording = Recording::create(&path, None);
    recording.calibration("/calibration");
    let message = RawImage {
        timestamp: Some(Timestamp::new(10, 0)),
        width: WIDTH,
        height: HEIGHT,
        encoding: "mono8".into(),
        step: WIDTH,
        data: picture(0).into_raw().into(),
        ..RawImage::default()
    };
    recording.add_foxglove("/raw", "foxglove.RawImage", 10.0, &message);
    let text = serde_json::json!({
        "timestamp": { "sec": 11, "nsec": 0 }, "frame_id": "c", "format": "png",
        "data": base64::Engine::encode(&base64::engine::general_purpose::STANDARD, encoded(1, ImageFormat::Png)),
    });
    recording.add("/json", "foxglove.CompressedImage", "json", 11.0, text.to_string().as_bytes());
    recording.finish();
    let out = tempdir().unwrap();
    let refused = ["several topics", "--topic", "/raw", "/json"];
    assert_refused(&["run", arg(&path), "--out", arg(out.path())], &refused);
    assert_refused(&["info", arg(&path), "--topic", "/none"], &["/none", "/raw"]);
    assert_eq!(processed_times(&read_through(&path, &["--topic", "/raw"])), [10.0]);
    assert_eq!(processed_times(&read_through(&path, &["--topic", "/json"])), [11.0]);
}

/// A CDR message of little-endian `u32`s and byte strings.
fn cdr(header_kind: u8, stamp: [u32; 2], rest: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut body = Vec::new();
    stamp.iter().for_each(|v| body.extend(v.to_le_bytes()));
    cdr_bytes(&mut body, b"camera\0");
    rest(&mut body);
    [&[0, header_kind, 0, 0], body.as_slice()].concat()
}

fn cdr_u32(body: &mut Vec<u8>, value: u32) {
    body.resize(body.len().next_multiple_of(4), 0);
    body.extend(value.to_le_bytes());
}

fn cdr_bytes(body: &mut Vec<u8>, bytes: &[u8]) {
    cdr_u32(body, bytes.len() as u32);
    body.extend(bytes);
}

#[test]
fn ros2_images() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("ros2.mcap");
    let mut recording = Recording::create(&path, None);
    let bgr: Vec<u8> = picture(0).into_raw().into_iter().flat_map(|v| [v, v, v]).collect();
    let raw = cdr(1, [20, 500_000_000], |body| {
        cdr_u32(body, HEIGHT);
        cdr_u32(body, WIDTH);
        cdr_bytes(body, b"bgr8\0");
        body.push(0);
        cdr_u32(body, WIDTH * 3);
        cdr_bytes(body, &bgr);
    });
    recording.add("/image_raw", "sensor_msgs/msg/Image", "cdr", 21.0, &raw);
    recording.add("/image_raw", "sensor_msgs/msg/Image", "cdr", 21.5, &raw[..40]);
    let compressed = cdr(1, [0, 0], |body| {
        cdr_bytes(body, b"jpeg\0");
        cdr_bytes(body, &encoded(1, ImageFormat::Jpeg));
    });
    recording.add("/compressed", "sensor_msgs/msg/CompressedImage", "cdr", 22.0, &compressed);
    recording.finish();
    let calibration = folder.path().join("camera.yaml");
    write(calibration.clone(), CAMERA);
    let calibrated = ["--calib", arg(&calibration), "--topic"];
    let run = read_through(&path, &[&calibrated[..], &["/image_raw"]].concat());
    assert_eq!(processed_times(&run), [20.5]);
    assert_eq!(run["frames"]["skipped"], serde_json::json!({ "unreadable": 1 }));
    // Without a stamp of its own, a message is timed by when it was logged.
    let run = read_through(&path, &[&calibrated[..], &["/compressed"]].concat());
    assert_eq!(processed_times(&run), [22.0]);
}

#[test]
fn all_whole_messages_of_a_truncated_file_are_used() {
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let folder = tempdir().unwrap();
        let path = folder.path().join("cut.mcap");
        let mut recording = Recording::create(&path, compression);
        recording.calibration("/camera/calibration");
        (0..40).for_each(|i| recording.compressed("/camera/image", i % 9));
        recording.finish();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() * 2 / 3]).unwrap();
        let out = tempdir().unwrap();
        let output = loopbox(&["run", arg(&path), "--out", arg(out.path())]);
        assert!(stderr(&output).contains("ends early"), "{}", stderr(&output));
        let offered = numbers(out.path())["frames"]["offered"].as_u64().unwrap();
        assert!((20..40).contains(&offered), "{offered} frames of {compression:?}");
    }
}

#[test]
fn files_that_are_no_recordings_are_refused() {
    let folder = tempdir().unwrap();
    let path = folder.path().join("empty.mcap");
    Recording::create(&path, None).finish();
    assert_refused(&["info", arg(&path)], &["no images", "foxglove.CompressedImage"]);
    let text = folder.path().join("text.mcap");
    write(text.clone(), "no recording");
    assert_refused(&["info", arg(&text)], &["MCAP"]);
    assert_refused(&["info", arg(&folder.path().join("nothing"))], &["no such file"]);
}
