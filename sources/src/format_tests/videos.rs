//! Videos whose packets are messages. The packets are FFmpeg's own.

use super::*;
use foxglove::messages::CompressedVideo;
use std::io::Write;
use std::process::{Command, Stdio};

const COUNT: usize = 24;
/// Packets from key frame to key frame.
const KEYS: usize = 8;

/// The grey level of a video's image.
fn level(i: usize) -> u8 {
    40 + 7 * i as u8
}

/// The packets of a video in H.264 or H.265, each beginning with an access unit delimiter.
fn packets(encoder: &str) -> Vec<Vec<u8>> {
    let (options, form, delimiter): (String, _, &[u8]) = match encoder {
        "libx264" => (format!("aud=1:bframes=0:scenecut=0:keyint={KEYS}"), "h264", &[0, 0, 0, 1, 9]),
        _ => (
            format!("aud=1:bframes=0:scenecut=0:open-gop=0:keyint={KEYS}:repeat-headers=1:log-level=none"),
            "hevc",
            &[0, 0, 0, 1, 0x46, 1],
        ),
    };
    let mut ffmpeg = Command::new("ffmpeg")
        .args(["-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "gray", "-s", "96x64", "-i", "pipe:0"])
        .args(["-pix_fmt", "yuv420p", "-c:v", encoder, "-crf", "5"])
        .args([if encoder == "libx264" { "-x264-params" } else { "-x265-params" }, &options])
        .args(["-f", form, "pipe:1"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("these tests need ffmpeg: apt install ffmpeg");
    let mut input = ffmpeg.stdin.take().unwrap();
    (0..COUNT).for_each(|i| input.write_all(&[level(i); 96 * 64]).unwrap());
    drop(input);
    let stream = ffmpeg.wait_with_output().unwrap().stdout;
    let mut starts: Vec<usize> =
        (0..stream.len()).filter(|at| stream[*at..].starts_with(delimiter)).collect();
    starts.push(stream.len());
    let packets: Vec<_> = starts.windows(2).map(|pair| stream[pair[0]..pair[1]].to_vec()).collect();
    assert_eq!(packets.len(), COUNT, "{encoder}");
    packets
}

/// Little-endian CDR.
#[derive(Default)]
struct Cdr(Vec<u8>);

impl Cdr {
    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        self.0.resize(self.0.len().next_multiple_of(N), 0);
        self.0.extend(bytes);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.number((bytes.len() as u32).to_le_bytes());
        self.0.extend(bytes);
    }

    fn header(time: u64) -> Self {
        let mut cdr = Self::default();
        cdr.number(((time / 1_000_000_000) as u32).to_le_bytes());
        cdr.number(((time % 1_000_000_000) as u32).to_le_bytes());
        cdr.bytes(b"cam\0");
        cdr
    }

    fn message(self) -> Vec<u8> {
        [&[0, 1, 0, 0][..], &self.0].concat()
    }
}

fn protobuf(time: u64, codec: &str, packet: &[u8]) -> Vec<u8> {
    let timestamp = Some(Timestamp::new((time / 1_000_000_000) as u32, (time % 1_000_000_000) as u32));
    let data = packet.to_vec().into();
    let message = CompressedVideo { timestamp, data, format: codec.into(), ..Default::default() };
    let mut bytes = Vec::new();
    message.encode(&mut bytes).unwrap();
    bytes
}

fn json(time: u64, codec: &str, packet: &[u8]) -> Vec<u8> {
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, packet);
    let stamp = format!("{{\"sec\":{},\"nsec\":{}}}", time / 1_000_000_000, time % 1_000_000_000);
    format!("{{\"timestamp\":{stamp},\"format\":\"{codec}\",\"data\":\"{data}\"}}").into_bytes()
}

fn ros2(time: u64, codec: &str, packet: &[u8]) -> Vec<u8> {
    let mut cdr = Cdr::header(time);
    cdr.bytes(packet);
    cdr.bytes(format!("{codec}\0").as_bytes());
    cdr.message()
}

fn ffmpeg_packet(time: u64, codec: &str, packet: &[u8]) -> Vec<u8> {
    let mut cdr = Cdr::header(time);
    cdr.number(96u32.to_le_bytes());
    cdr.number(64u32.to_le_bytes());
    cdr.bytes(format!("{codec};yuv420p;bgr8;bgr8\0").as_bytes());
    cdr.number(77u64.to_le_bytes());
    cdr.number([1]);
    cdr.number([0]);
    cdr.bytes(packet);
    cdr.message()
}

type Form = (&'static str, &'static str, fn(u64, &str, &[u8]) -> Vec<u8>);

const FORMS: [Form; 4] = [
    ("foxglove.CompressedVideo", "protobuf", protobuf),
    ("foxglove.CompressedVideo", "json", json),
    ("foxglove_msgs/msg/CompressedVideo", "cdr", ros2),
    ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", "cdr", ffmpeg_packet),
];

/// A recording of these packets of a video, by their numbers.
fn recording(path: &Path, form: Form, codec: &str, which: &[(usize, &[u8])]) {
    let (schema, encoding, made) = form;
    let message = |(i, packet): &(usize, &[u8])| {
        // Logged later than taken.
        let time = nanoseconds(*i);
        ("/video", schema, encoding, time + 5_000_000, made(time, codec, packet))
    };
    mcap_file(path, Some(Compression::Zstd), &which.iter().map(message).collect::<Vec<_>>());
}

/// Whether images have the times and grey levels of these packets.
fn assert_images(seen: &Seen, which: &[usize]) {
    assert_eq!(seen.times.len(), which.len(), "{} {}", seen.reported, seen.facts);
    for ((time, found), i) in seen.times.iter().zip(&seen.levels).zip(which) {
        assert!((time - (10.0 + 0.1 * *i as f64)).abs() < 1e-6, "{i}: {time}");
        assert!(found.abs_diff(level(*i)) <= 2, "{i}: {found} for {}", level(*i));
    }
}

#[test]
fn a_video_in_messages_gives_each_image_the_time_of_its_packet() {
    let room = tempdir().unwrap();
    for (encoder, codec) in [("libx264", "h264"), ("libx265", "h265")] {
        let packets = packets(encoder);
        let all: Vec<(usize, &[u8])> = packets.iter().map(Vec::as_slice).enumerate().collect();
        for form in FORMS {
            let path = room.path().join("a.mcap");
            recording(&path, form, codec, &all);
            let seen = read(&path);
            assert_images(&seen, &(0..COUNT).collect::<Vec<_>>());
            assert_eq!(seen.reported, "", "{form:?}");
        }
    }
}

#[test]
fn a_video_that_begins_between_key_frames_begins_at_the_next_and_says_so() {
    let room = tempdir().unwrap();
    for (encoder, codec) in [("libx264", "h264"), ("libx265", "hevc")] {
        let packets = packets(encoder);
        let late: Vec<(usize, &[u8])> = packets.iter().map(Vec::as_slice).enumerate().skip(3).collect();
        let path = room.path().join("a.mcap");
        recording(&path, FORMS[0], codec, &late);
        let seen = read(&path);
        assert_images(&seen, &(KEYS..COUNT).collect::<Vec<_>>());
        let refusal = format!("{} of {} packets of the video gave no image", KEYS - 3, COUNT - 3);
        assert!(seen.reported.contains(&refusal), "{}", seen.reported);

        recording(&path, FORMS[0], codec, &late[..2]);
        assert!(refused(&path).contains("key frame"), "{}", refused(&path));
    }
}

#[test]
fn a_video_of_a_codec_that_is_not_read_is_refused_by_name() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    recording(&path, FORMS[0], "theora", &[(0, &[1, 2, 3])]);
    let refusal = refused(&path);
    assert!(refusal.contains("'theora'") && refusal.contains("a.mcap"), "{refusal}");
}

#[test]
fn images_are_taken_before_the_same_as_a_video() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    let mut all: Vec<_> = (0..4)
        .map(|i| ("/cam", "foxglove.RawImage", "protobuf", nanoseconds(i), foxglove_raw(nanoseconds(i))))
        .collect();
    all.push(("/video", FORMS[0].0, FORMS[0].1, nanoseconds(0), protobuf(nanoseconds(0), "h264", &[0])));
    mcap_file(&path, None, &all);
    assert_times(&read(&path), "images");
}

#[test]
fn a_video_alone_in_a_folder_is_read() {
    let room = tempdir().unwrap();
    let make = |name: &str| {
        let made = Command::new("ffmpeg")
            .args([
                "-loglevel",
                "error",
                "-f",
                "lavfi",
                "-i",
                "testsrc=size=96x64:rate=10:duration=1",
                "-pix_fmt",
                "yuv420p",
            ])
            .arg(room.path().join(name))
            .status();
        assert!(made.expect("these tests need ffmpeg: apt install ffmpeg").success());
    };
    make("GX010042.MP4");
    fs::write(room.path().join("GX010042.THM"), "a thumbnail").unwrap();
    assert_eq!(read(room.path()).times.len(), 10);
    make("other.mkv");
    let refusal = refused(room.path());
    assert!(refusal.contains("of GX010042.MP4, other.mkv") && !refusal.contains("looked for"), "{refusal}");
}
