//! The checks, in the order in which they run.

mod capture;
mod listing;
mod loopback;
mod refusals;
mod slam;
mod truth;
mod unplugging;

pub use slam::{CALIBRATION, sequence_of};
pub use unplugging::{plug_in, unplug};

use anyhow::Result;
use image::{GrayImage, Luma};

/// A check: a note for people when it passes, what is wrong when it does not.
pub type Check = fn() -> Result<String>;

/// All of them by name.
pub const ALL: &[(&str, Check)] = &[
    ("the_driver_loops_every_format", loopback::every_format),
    ("cameras_lists_the_device_its_formats_sizes_and_rates", listing::webcam),
    ("pictures_arrive_as_played_in_every_format", capture::every_format),
    ("frames_missed_while_nobody_reads_are_counted", capture::stalled_reader),
    ("gain_is_locked_and_given_back", capture::locks),
    ("a_busy_device_is_refused_with_its_holder", refusals::busy),
    ("missing_permission_is_refused_with_the_mending", refusals::permission),
    ("what_the_device_does_not_have_is_refused_with_what_it_has", refusals::unsupported),
    ("a_played_sequence_becomes_a_map", slam::played_sequence),
    ("a_stopped_process_misses_frames_and_goes_on", slam::stopped_process),
    ("without_reconnect_an_unplugged_camera_ends_the_run_with_its_map", unplugging::ends_the_run),
    ("with_reconnect_the_run_continues", unplugging::the_run_continues),
];

/// A textured picture, another for each seed.
fn pattern(width: u32, height: u32, seed: u32) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        Luma([((x * 37 + y * 91 + (x * y) / 7 + seed * 53) % 251) as u8])
    })
}
