//! Images of more than eight bits, and what is no recording.

use super::*;
use crate::messages::{Content, Form};
use crate::pictures::{GreyRange, Picture, RawPicture};
use crate::recording::RecordingWriter;
use image::{ImageBuffer, Luma};

/// A folder of images of 16 bits, whose samples go from one to the other.
fn deep(from: u16, to: u16, name: fn(usize) -> String, count: usize) -> TempDir {
    let level = |x: u32, y: u32| from + ((to - from) as f32 * (y * 64 + x) as f32 / 4095.0) as u16;
    let image = ImageBuffer::<Luma<u16>, _>::from_fn(64, 64, |x, y| Luma([level(x, y)]));
    let format = if name(0).ends_with("png") { ImageFormat::Png } else { ImageFormat::Tiff };
    let bytes = encoded(&image.into(), format);
    let names: Vec<String> = (0..count).map(name).collect();
    folder(&names.iter().map(|name| (name.as_str(), &bytes[..])).collect::<Vec<_>>())
}

#[test]
fn more_than_eight_bits_keep_their_grey_levels() {
    let png: fn(usize) -> String = |i| format!("{i}.png");
    let tiff: fn(usize) -> String = |i| format!("{i}.tiff");
    for (from, to, name, least) in [
        (0, 1023, png, 250),
        (0, 4095, png, 250),
        (0, 4095, tiff, 250),
        (0, 16383, png, 250),
        (0, 65535, png, 250),
        (7000, 7400, png, 150),
        (29_500, 31_500, tiff, 150),
    ] {
        let room = deep(from, to, name, 3);
        let mut source = open(room.path(), &SourceOptions { fps: Some(10.0), ..Default::default() }).unwrap();
        let mut levels = source.next_frame().unwrap().picture.into_grey().unwrap().data().to_vec();
        levels.sort_unstable();
        levels.dedup();
        assert!(levels.len() >= least, "{from} to {to}: {} levels", levels.len());
        assert!(source.facts().iter().any(|(label, _)| *label == "bits"), "{:?}", source.facts());
    }
}

#[test]
fn a_replay_sees_the_levels_of_the_run() {
    let sample = |level: u16| {
        let data = [7000 + level, 7400].into_iter().cycle().take(192).flat_map(u16::to_le_bytes).collect();
        RawPicture { width: 16, height: 12, step: 32, encoding: "mono16".into(), big_endian: false, data }
    };
    let range = GreyRange { from: 6900, to: 7500, numbers: [0, 3] };
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = RecordingWriter::create(&mut bytes, &Head::default()).unwrap();
    let mut expected = Vec::new();
    for i in 0..6u16 {
        let picture = Picture::Ranged(Box::new(Picture::Raw(sample(10 * i))), range);
        expected.push(picture.clone().into_grey().unwrap());
        writer.grey_range(range);
        writer.frame(i.into(), f64::from(i), crate::recording::encode(picture).unwrap()).unwrap();
    }
    writer.finish(0).unwrap();
    drop(writer);
    let mut replay = crate::open_bytes(bytes.get_ref(), &SourceOptions::default()).unwrap();
    let again = std::iter::from_fn(|| replay.next_frame()).map(|frame| frame.picture.into_grey().unwrap());
    assert!(again.eq(expected));
}

#[test]
fn mosaics_are_read_as_grey() {
    let room = tempdir().unwrap();
    let path = room.path().join("a.mcap");
    for (encoding, pixel) in
        [("bayer_rggb8", 1), ("bayer_gbrg8", 1), ("bayer_bggr16", 2), ("rgb16", 6), ("mono16", 2)]
    {
        let pixels: Vec<u8> = match pixel {
            1 => vec![LEVEL; 192],
            _ => std::iter::repeat_n([0, LEVEL], 96 * pixel).flatten().collect(),
        };
        let image = |i| {
            (
                "/cam",
                "sensor_msgs/msg/Image",
                "cdr",
                nanoseconds(i),
                cdr_image(nanoseconds(i), encoding, pixel, &pixels),
            )
        };
        mcap_file(&path, None, &(0..4).map(image).collect::<Vec<_>>());
        let seen = read(&path);
        assert!(
            seen.levels.iter().all(|level| level.abs_diff(LEVEL) <= 1),
            "{encoding}: {:?} {:?}",
            seen.levels,
            seen.reasons
        );
    }
    assert!(matches!(Content::of("sensor_msgs/msg/Image", "cdr"), Some(Content::Image(Form::Ros2Raw))));
}

/// What is no recording is told before anything else: see `kinds`. Paths that name none are, too.
#[test]
fn what_is_nothing_is_reported() {
    let room = folder(&[("notes.txt", b"nothing"), ("a.zip", b"PK\x03\x04")]);
    assert!(refused(room.path()).contains("no recording here"));
    assert!(refused(&room.path().join("a.zip")).contains("unzip"));
    assert!(refused(&PathBuf::from("rtsp://host/stream")).contains("an address"));
}
