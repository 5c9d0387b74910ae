//! Runs the built `loopbox` on rendered recordings, whole and damaged, and looks at what it leaves behind.
//!
//! Each test holds loopbox to one rule: either the map survives, or a clear message and a non-zero exit
//! say why.
//!
//! `LOOPBOX_KEEP=1` keeps each test's recording and results and says where; `LOOPBOX_DATA` names the folder of the
//! sequences with ground truth. A single test: `cargo test -p loopbox --test e2e -- --nocapture NAME`.

mod board;
mod claims;
mod color;
mod damaged;
#[path = "../common/documented.rs"]
mod documented;
mod ending;
mod golden;
mod images;
mod input;
mod lens;
mod memory;
mod motion;
mod normal;
mod resume;
mod scale;
mod support;
#[cfg(feature = "view")]
mod watch;
