//! `loopbox`: direct monocular SLAM for one agent or several.
#[cfg_attr(not(test), expect(dead_code))]
mod report;
fn main() {}
