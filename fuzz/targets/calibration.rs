//! Camera calibrations in every form that is read; what is read can be written and read again.
#![no_main]

libfuzzer_sys::fuzz_target!(|text: &str| {
    if let Ok(file) = calib::parse_camera(text, "fuzzed") {
        let written = calib::format_camera(&file.camera, file.fps);
        let again = calib::parse_camera(&written, "written").expect("what was written is read");
        assert_eq!(again.camera, file.camera, "{written}");
    }
});
