//! Trajectories, ground truth and lists of times.
#![no_main]

use loopbox_fuzz::with_file;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    with_file("trajectory.txt", data, |path| {
        let _ = eval::read_trajectory(path);
        let _ = eval::read_times(path);
    });
});
