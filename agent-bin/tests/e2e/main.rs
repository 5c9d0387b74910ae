//! Runs the built `loopbox` on rendered recordings, whole and damaged, and looks at what it leaves behind.
//!
//! Each test holds loopbox to one rule: either the map survives, or a clear message and a non-zero exit
//! say why.

mod accuracy;
mod damaged;
mod ending;
mod images;
mod input;
mod memory;
mod motion;
mod normal;
mod support;
