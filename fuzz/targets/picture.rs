//! Pictures: PNG, JPEG and PNM files, and pixels as cameras and recordings have them.
#![no_main]

use agent_bin::pictures::{Picture, RawPicture};
use libfuzzer_sys::arbitrary::{self, Arbitrary};

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
enum Input {
    Encoded(Vec<u8>),
    Raw {
        width: u16,
        height: u16,
        step: u16,
        encoding: u8,
        big_endian: bool,
        data: Vec<u8>,
    },
    /// Sizes from damaged messages.
    Wild {
        width: usize,
        height: usize,
        step: usize,
        encoding: u8,
        data: Vec<u8>,
    },
}

libfuzzer_sys::fuzz_target!(|input: Input| {
    let name = |index: u8| ENCODINGS[index as usize % ENCODINGS.len()].to_owned();
    let picture = match input {
        Input::Encoded(bytes) => Picture::Encoded(bytes),
        Input::Raw { width, height, step, encoding, big_endian, data } => Picture::Raw(RawPicture {
            width: width.into(),
            height: height.into(),
            step: step.into(),
            encoding: name(encoding),
            big_endian,
            data,
        }),
        Input::Wild { width, height, step, encoding, data } => Picture::Raw(RawPicture {
            width,
            height,
            step,
            encoding: name(encoding),
            big_endian: false,
            data,
        }),
    };
    let _ = picture.into_grey();
});
