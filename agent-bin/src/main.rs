//! `loopbox`: direct monocular SLAM for one agent or several.
fn main() {}
