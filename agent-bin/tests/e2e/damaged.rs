//! Files that are broken or missing.

use crate::support::{Case, Outcome, RATE, drive};
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

/// How messages lie in an MCAP file.
#[derive(Clone, Copy, PartialEq)]
enum Layout {
    /// One after the other.
    Plain,
    /// Ten at a time, compressed.
    Chunks,
}

/// Writes the images as ROS 2 `sensor_msgs/msg/CompressedImage`; gives the size of the file after each message
/// or chunk.
fn write_mcap(recording: &Recording, path: &Path, layout: Layout) -> Vec<u64> {
    let file = fs::File::create(path).expect("the temporary folder takes a file");
    let options = mcap::WriteOptions::new()
        .use_chunks(layout == Layout::Chunks)
        .compression(Some(mcap::Compression::Lz4))
        .profile("ros2");
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
        if layout == Layout::Plain || i % 10 == 9 {
            writer.flush().expect("the file can be written");
            sizes.push(fs::metadata(path).expect("the file is there").len());
        }
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

fn mcap_case(layout: Layout) -> (Case, std::path::PathBuf, Vec<u64>) {
    let case = Case::new(&drive());
    let path = case.out().with_file_name("recording.mcap");
    let sizes = write_mcap(&drive(), &path, layout);
    (case, path, sizes)
}

fn run_mcap(case: &Case, path: &Path) -> Outcome {
    let camera = case.source().join("camera.yaml");
    Outcome::of(case.command_on(path, &["--calib", &camera.to_string_lossy()]))
}

#[test]
fn an_mcap_of_images_is_mapped() {
    for layout in [Layout::Plain, Layout::Chunks] {
        let (case, path, _) = mcap_case(layout);
        let outcome = run_mcap(&case, &path);
        case.assert_mapped(&outcome, 2);
    }
}

/// Cuts a file in the middle of its message or chunk number `cut`, counted from 0.
fn truncated(layout: Layout, cut: usize) -> (Case, Outcome) {
    let (case, path, sizes) = mcap_case(layout);
    let file = fs::OpenOptions::new().write(true).open(&path).expect("we wrote it");
    file.set_len((sizes[cut - 1] + sizes[cut]) / 2).expect("a file can be cut");
    let outcome = run_mcap(&case, &path);
    outcome.assert_says(&["recording.mcap", "ends"]);
    (case, outcome)
}

/// Index of the last frame of the trajectory.
fn last_frame(case: &Case) -> Option<u64> {
    case.map().frames.last().map(|frame| (frame.timestamp * RATE).round() as u64)
}

#[test]
fn a_truncated_mcap_gives_all_its_whole_messages() {
    let (case, outcome) = truncated(Layout::Plain, 70);
    case.assert_mapped(&outcome, 90 - 70 + 2);
    assert_eq!(last_frame(&case), Some(69), "{outcome}");
}

/// A chunk is compressed as one: of a cut one, whatever can still be unpacked may be used.
#[test]
fn a_truncated_mcap_gives_all_its_whole_chunks() {
    let (case, outcome) = truncated(Layout::Chunks, 7);
    case.assert_mapped(&outcome, 90 - 70 + 2);
    assert!(last_frame(&case).is_some_and(|last| (69..80).contains(&last)), "{outcome}");
}
