//! Every row of the tables in `book/src/reference/formats.md`, and what people's own recordings have instead.

use crate::recording::Head;
use crate::{FrameSource, SourceOptions, open};
use foxglove::Encode;
use foxglove::messages::{CompressedImage, RawImage, Timestamp};
use image::{DynamicImage, GrayImage, ImageFormat, Luma};
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use tempfile::{TempDir, tempdir};

mod calibrations;
mod containers;
mod folders;
mod levels;
mod videos;

/// The times of the images that all of them hold, and the level of their pixels.
const TIMES: [f64; 4] = [10.0, 10.1, 10.2, 10.3];
const LEVEL: u8 = 120;

fn image() -> DynamicImage {
    GrayImage::from_pixel(16, 12, Luma([LEVEL])).into()
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Vec::new();
    image.write_to(&mut Cursor::new(&mut bytes), format).unwrap();
    bytes
}

fn png() -> Vec<u8> {
    encoded(&image(), ImageFormat::Png)
}

/// A folder of files; those without content are images.
fn folder(files: &[(&str, &[u8])]) -> TempDir {
    let (room, image) = (tempdir().unwrap(), png());
    for (name, content) in files {
        let path = room.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, if content.is_empty() { &image[..] } else { content }).unwrap();
    }
    room
}

struct Seen {
    times: Vec<f64>,
    levels: Vec<u8>,
    reasons: Vec<String>,
    reported: String,
    facts: String,
    kind: &'static str,
}

fn seen(source: &mut dyn FrameSource) -> Seen {
    let kind = source.info().kind;
    let (mut times, mut levels, mut reasons) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(frame) = source.next_frame() {
        match frame.picture.into_grey() {
            Ok(image) => {
                times.push(frame.timestamp);
                levels.push(image.get(3, 3));
            }
            Err(reason) => reasons.push(reason),
        }
    }
    let reported = source.problems().into_iter().chain(source.warning()).collect::<Vec<_>>().join("\n");
    let facts = source.facts().into_iter().map(|(label, text)| format!("{label}: {text}\n")).collect();
    Seen { times, levels, reasons, reported, facts, kind }
}

fn read(path: &Path) -> Seen {
    read_at(path, None)
}

fn read_at(path: &Path, fps: Option<f64>) -> Seen {
    let options = SourceOptions { fps, ..SourceOptions::default() };
    let mut source = open(path, &options).unwrap_or_else(|error| panic!("{}: {error:#}", path.display()));
    seen(source.as_mut())
}

fn refused(path: &Path) -> String {
    format!("{:#}", open(path, &SourceOptions::default()).err().expect("it is refused"))
}

fn assert_times(seen: &Seen, what: &str) {
    assert!(seen.reasons.is_empty(), "{what}: {:?}", seen.reasons);
    assert_eq!(seen.times.len(), TIMES.len(), "{what}: {:?} {}", seen.times, seen.reported);
    let first = seen.times[0] - TIMES[0];
    let is_near = |(found, expected): (&f64, &f64)| (found - first - expected).abs() < 1e-6;
    assert!(seen.times.iter().zip(&TIMES).all(is_near), "{what}: {:?}", seen.times);
    assert!(seen.levels.iter().all(|level| *level == LEVEL), "{what}: {:?}", seen.levels);
}

/// An MCAP file of messages `(topic, schema, encoding, nanoseconds, data)`.
fn mcap_file(path: &Path, compression: Option<Compression>, messages: &[(&str, &str, &str, u64, Vec<u8>)]) {
    let options = WriteOptions::new().compression(compression).chunk_size(Some(500));
    let mut writer = Writer::with_options(fs::File::create(path).unwrap(), options).unwrap();
    let mut channels = BTreeMap::new();
    for (topic, schema, encoding, time, data) in messages {
        let channel_id = *channels.entry(*topic).or_insert_with(|| {
            let schema = writer.add_schema(schema, "unused", b"").unwrap();
            writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
        });
        let header = MessageHeader { channel_id, sequence: 0, log_time: *time, publish_time: *time };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
}

fn nanoseconds(i: usize) -> u64 {
    10_000_000_000 + 100_000_000 * i as u64
}

fn foxglove_compressed(time: u64) -> Vec<u8> {
    let timestamp = Some(Timestamp::new((time / 1_000_000_000) as u32, (time % 1_000_000_000) as u32));
    let message =
        CompressedImage { timestamp, data: png().into(), format: "png".into(), ..Default::default() };
    let mut data = Vec::new();
    message.encode(&mut data).unwrap();
    data
}

fn foxglove_raw(time: u64) -> Vec<u8> {
    let timestamp = Some(Timestamp::new((time / 1_000_000_000) as u32, (time % 1_000_000_000) as u32));
    let (width, height) = (16, 12);
    let data = vec![LEVEL; 192].into();
    let message =
        RawImage { timestamp, width, height, step: 16, encoding: "mono8".into(), data, ..Default::default() };
    let mut data = Vec::new();
    message.encode(&mut data).unwrap();
    data
}

/// `sensor_msgs/msg/Image` in CDR.
fn cdr_image(time: u64, encoding: &str, pixel: usize, pixels: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    let put = |body: &mut Vec<u8>, value: u32| {
        body.resize(body.len().next_multiple_of(4), 0);
        body.extend(value.to_le_bytes());
    };
    put(&mut body, (time / 1_000_000_000) as u32);
    put(&mut body, (time % 1_000_000_000) as u32);
    put(&mut body, 4);
    body.extend(b"cam\0");
    put(&mut body, 12);
    put(&mut body, 16);
    put(&mut body, encoding.len() as u32 + 1);
    body.extend(encoding.as_bytes());
    body.extend([0, 0]);
    put(&mut body, 16 * pixel as u32);
    put(&mut body, pixels.len() as u32);
    body.extend(pixels);
    [&[0, 1, 0, 0][..], &body].concat()
}

fn cdr(time: u64) -> Vec<u8> {
    cdr_image(time, "mono8", 1, &[LEVEL; 192])
}
