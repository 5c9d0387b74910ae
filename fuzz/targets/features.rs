//! Features; what is read is written and read again, with the key points where they were.
#![no_main]

use features::codec::{decode, encode};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(features) = decode(data) {
        let again = decode(&encode(&features)).expect("what was written is read");
        assert_eq!(again.len(), features.len());
        for (again, first) in again.keypoints.iter().zip(&features.keypoints) {
            for (again, first) in again.pixel.iter().zip(first.pixel) {
                assert!((again - first).abs() <= 0.5, "a key point moved from {first} to {again}");
            }
        }
    }
});
