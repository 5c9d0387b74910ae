//! `loopbox calib`: from images of a board to a camera's calibration.

mod collect;
mod detect;
mod input;
mod output;
mod report;
mod summary;

pub use collect::{Collected, collect};
pub use input::{Input, Shots};
pub use output::{Output, camera_text};
pub use report::render as render_report;
pub use summary::{Numbers, table};
