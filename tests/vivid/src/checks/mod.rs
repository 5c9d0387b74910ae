//! The checks, in the order in which they run.

mod loopback;

use anyhow::Result;
use image::{GrayImage, Luma};

/// A check: a note for people when it passes, what is wrong when it does not.
pub type Check = fn() -> Result<String>;

/// All of them by name.
pub const ALL: &[(&str, Check)] = &[("the_driver_loops_every_format", loopback::every_format)];

/// A textured picture, another for each seed.
fn pattern(width: u32, height: u32, seed: u32) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| Luma([((x * 37 + y * 91 + (x * y) / 7 + seed * 53) % 251) as u8]))
}
