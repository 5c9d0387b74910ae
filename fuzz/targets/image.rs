//! Image files with their metadata, and the JPEGs that cameras send.
#![no_main]

use sources::pictures::{Picture, whole_jpeg};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(whole) = whole_jpeg(data.to_vec()) {
        let _ = Picture::Encoded(whole).into_grey();
    }
    let _ = Picture::Encoded(data.to_vec()).stated_focal((640, 480));
    let _ = Picture::Encoded(data.to_vec()).into_grey();
});
