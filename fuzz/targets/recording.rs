//! MCAP recordings, down to the grey images.
#![no_main]

use agent_bin::sources::{self, SourceOptions};
use loopbox_fuzz::with_file;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    with_file("recording.mcap", data, |path| {
        let Ok(mut source) = sources::open(path, &SourceOptions::default()) else { return };
        while let Some(frame) = source.next_frame() {
            let _ = frame.picture.into_grey();
        }
        let _ = source.warning();
    });
});
