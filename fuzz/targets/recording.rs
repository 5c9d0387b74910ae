//! MCAP recordings, down to the grey images.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| loopbox_fuzz::read_recording(data));
