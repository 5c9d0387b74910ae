//! Files that are broken or missing.

use crate::support::{Case, Outcome, drive};
use loopbox_tests::{Encoding, Recording};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

#[test]
fn a_truncated_jpeg_costs_one_frame() {
    let case = Case::with_encoding(&drive(), Encoding::Jpeg);
    let name = case.source().join("images/000050.jpg");
    let bytes = fs::read(&name).expect("we wrote it");
    fs::write(&name, &bytes[..bytes.len() / 3]).expect("we may write it");
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 3);
    outcome.assert_says(&["frame 50"]);
}

#[test]
fn a_frame_of_another_size_costs_one_frame() {
    let case = Case::new(&drive());
    let small = geometry::GrayImage::filled(160, 120, 90);
    let bytes = Encoding::Png.encode(&small).expect("an image can be encoded");
    fs::write(case.source().join("images/000050.png"), bytes).expect("we may write it");
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 3);
    outcome.assert_says(&["frame 50", "160", "320"]);
}

/// Writes `images` as ROS 2 `sensor_msgs/msg/CompressedImage`, uncompressed and without chunks; gives the size of
/// the file after each message.
fn write_mcap(recording: &Recording, path: &Path) -> Vec<u64> {
    let file = fs::File::create(path).expect("the temporary folder takes a file");
    let options = mcap::WriteOptions::new().use_chunks(false).profile("ros2");
    let mut writer = options.create(std::io::BufWriter::new(file)).expect("a file can be begun");
    let schema = "std_msgs/Header header\nstring format\nuint8[] data\n";
    let schema = writer.add_schema("sensor_msgs/msg/CompressedImage", "ros2msg", schema.as_bytes());
    let channel = writer
        .add_channel(schema.expect("a schema is taken"), "/camera/image", "cdr", &BTreeMap::new())
        .expect("a channel is taken");
    let mut sizes = Vec::new();
    for (i, shot) in recording.shots.iter().enumerate() {
        let nanoseconds = (shot.timestamp * 1e9).round() as u64;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: i as u32,
            log_time: nanoseconds,
            publish_time: nanoseconds,
        };
        let image = Encoding::Jpeg.encode(&shot.image).expect("an image can be encoded");
        let message = compressed_image(nanoseconds, &image);
        writer.write_to_known_channel(&header, &message).expect("a message is taken");
        writer.flush().expect("the file can be written");
        sizes.push(fs::metadata(path).expect("the file is there").len());
    }
    writer.finish().expect("the file can be ended");
    sizes
}

/// A `CompressedImage` in little-endian CDR: stamp, frame name, format, data; 4-byte values aligned to 4 bytes.
fn compressed_image(nanoseconds: u64, data: &[u8]) -> Vec<u8> {
    let mut cdr = vec![0, 1, 0, 0];
    let mut word = |value: u32, bytes: &[u8]| {
        while cdr.len() % 4 != 0 {
            cdr.push(0);
        }
        cdr.extend(value.to_le_bytes());
        cdr.extend(bytes);
    };
    word((nanoseconds / 1_000_000_000) as u32, &[]);
    word((nanoseconds % 1_000_000_000) as u32, &[]);
    word(7, b"camera\0");
    word(5, b"jpeg\0");
    word(data.len() as u32, data);
    cdr
}

fn mcap_case() -> (Case, std::path::PathBuf, Vec<u64>) {
    let case = Case::new(&drive());
    let path = case.out().with_file_name("recording.mcap");
    let sizes = write_mcap(&drive(), &path);
    (case, path, sizes)
}

fn run_mcap(case: &Case, path: &Path) -> Outcome {
    let camera = case.source().join("camera.yaml");
    Outcome::of(case.command_on(path, &["--calib", &camera.to_string_lossy()]))
}

#[test]
fn an_mcap_of_images_is_mapped() {
    let (case, path, _) = mcap_case();
    let outcome = run_mcap(&case, &path);
    case.assert_mapped(&outcome, 2);
}

/// Cut in the middle of message 70: the 70 whole ones are used, and it is said that the file ends early.
#[test]
fn a_truncated_mcap_gives_all_its_whole_messages() {
    let (case, path, sizes) = mcap_case();
    let file = fs::OpenOptions::new().write(true).open(&path).expect("we wrote it");
    file.set_len((sizes[69] + sizes[70]) / 2).expect("a file can be cut");
    let outcome = run_mcap(&case, &path);
    case.assert_mapped(&outcome, 90 - 70 + 2);
    outcome.assert_says(&["recording.mcap"]);
    let last = case.map().trajectory().last().map(|pose| pose.timestamp);
    assert_eq!(last.map(|t| (t * 30.0).round()), Some(69.0), "the last whole message is used\n{outcome}");
}
