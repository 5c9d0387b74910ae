//! ROS 1 bags, down to the grey images.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    // What begins otherwise is no bag, and has a target of its own.
    loopbox_fuzz::read_recording(&[b"#ROSBAG V2.0\n", data].concat());
});
