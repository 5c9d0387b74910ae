//! Map files; what is read can be written and is then whole.
#![no_main]

use loopbox_fuzz::{scratch, with_file};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    with_file("map.mcap", data, |path| {
        map::is_map_file(path);
        if let Ok(loaded) = map::load_map(path) {
            let written = scratch().join("again.mcap");
            map::save_map(&written, &loaded.map).expect("what was read can be written");
            let again = map::load_map(&written).expect("what was written can be read");
            assert!(again.complete, "{:?}", again.warnings);
        }
    });
});
