//! `loopbox cameras`.

use crate::driver;
use crate::program;
use anyhow::{Result, ensure};

/// The driver as a webcam, whose sizes and rates are listed one by one.
pub fn webcam() -> Result<String> {
    driver::be_a_webcam()?;
    let ended = program::run("cameras", &["cameras"])?.succeeded()?;
    let text = &ended.output;
    for word in [
        "/dev/video0",
        "vivid",
        "GREY",
        "Y16",
        "YUYV",
        "UYVY",
        "NV12",
        "320x180",
        "640x360",
        "1280x720",
        "30",
    ] {
        ensure!(text.contains(word), "no '{word}' in:\n{text}");
    }
    ensure!(!text.contains("/dev/video1"), "an output is listed as a camera:\n{text}");
    Ok(String::new())
}
