//! `loopbox calib` through the binary, on drawn boards and on the shared images of real ones.

#[path = "../common/mod.rs"]
mod common;
mod drawn;
#[cfg(feature = "view")]
mod page;
mod photometric;
mod real;
mod refusals;
mod support;
