//! Pixels as cameras and recordings have them.
#![no_main]

use libfuzzer_sys::arbitrary::{self, Arbitrary};
use sources::pictures::{Picture, RawPicture};

/// The layouts that are read, and one that is not.
const ENCODINGS: [&str; 12] = [
    "mono8",
    "mono16",
    "16UC1",
    "rgb8",
    "bgr8",
    "rgba8",
    "bgra8",
    "yuv422",
    "yuv422_yuy2",
    "UYVY",
    "nv12",
    "odd",
];

#[derive(Arbitrary, Debug)]
enum Size {
    Small(u8, u8, u8),
    /// From a damaged message.
    Wild(usize, usize, usize),
}

#[derive(Arbitrary, Debug)]
struct Input {
    size: Size,
    encoding: u8,
    big_endian: bool,
    data: Vec<u8>,
}

libfuzzer_sys::fuzz_target!(|input: Input| {
    let (width, height, step) = match input.size {
        Size::Small(width, height, step) => (width.into(), height.into(), step.into()),
        Size::Wild(width, height, step) => (width, height, step),
    };
    let encoding = ENCODINGS[input.encoding as usize % ENCODINGS.len()].to_owned();
    let raw = RawPicture { width, height, step, encoding, big_endian: input.big_endian, data: input.data };
    let _ = Picture::Raw(raw).into_grey();
});
