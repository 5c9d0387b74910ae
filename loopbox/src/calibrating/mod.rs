//! `loopbox calib`: from images of a board to a camera's calibration.

#[cfg(feature = "view")]
mod coaching;
#[cfg(not(feature = "view"))]
#[path = "coaching_off.rs"]
mod coaching;
mod collect;
mod in_map;
mod input;
mod output;
mod report;
mod summary;

pub use coaching::Coaching;
pub use collect::{CollectProgress, Collected, collect};
pub use in_map::sightings;
pub use input::{Input, Shots};
pub use output::{Output, camera_text};
pub use report::render as render_report;
pub use summary::{Numbers, table};
