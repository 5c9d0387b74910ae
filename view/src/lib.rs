//! What people look at: the report of a run or a merge ([`report`], one HTML file), the page to watch from while it
//! goes on and Foxglove's server ([`watch`]). HTML and JavaScript of both live here.

pub mod process;
pub mod report;
pub mod slot;
#[cfg(feature = "page")]
pub mod watch;
#[cfg(not(feature = "page"))]
#[path = "watch/off.rs"]
pub mod watch;
