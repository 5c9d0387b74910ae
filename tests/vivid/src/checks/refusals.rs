//! Devices that cannot be used: each message names the fix.

use super::pattern;
use crate::driver::{self, CAPTURE, Mode, OUTPUT};
use crate::player::{Pace, Player};
use crate::program::{self, SOME_USER};
use anyhow::{Context, Result, ensure};
use std::fs::{self, File};
use std::io::Read;
use std::os::unix::fs::PermissionsExt;

const CALIBRATION: &str = "/data/parking_a/camera.yaml";

fn arguments<'a>(device: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["run", "--camera", device, "--calib", CALIBRATION, "--out", "OUT"], more].concat()
}

/// This program streams from the device already.
pub fn busy() -> Result<String> {
    let mode = Mode::USUAL;
    let player = Player::start(&[pattern(mode.width, mode.height, 4)], &mode, Pace::OnDemand)?;
    let mut device = File::open(CAPTURE).context(CAPTURE)?;
    let read = device.read(&mut vec![0; (mode.width * mode.height) as usize])?;
    ensure!(read > 0, "no frame");
    let ended = program::run("busy", &arguments(CAPTURE, &[]))?;
    drop(device);
    player.stop()?;
    let ended = ended.refused(&[CAPTURE, "in use by vivid"])?;
    ensure!(!ended.out.exists(), "a refused run leaves {}", ended.out.display());
    Ok(String::new())
}

/// Another user than the device's.
pub fn permission() -> Result<String> {
    driver::connect(&Mode::USUAL)?;
    fs::set_permissions(CAPTURE, fs::Permissions::from_mode(0o600))?;
    let ended = program::start("permission", &arguments(CAPTURE, &[]), SOME_USER)?.wait()?;
    ended.refused(&[CAPTURE, "permission", "usermod"])?;
    let listed = program::start("permission_list", &["cameras"], SOME_USER)?.wait()?;
    ensure!(listed.output.contains("permission"), "`loopbox cameras` hides the device:\n{}", listed.output);
    Ok(String::new())
}

/// Formats and sizes that the device does not give, and devices that are no cameras.
pub fn unsupported() -> Result<String> {
    driver::connect(&Mode::USUAL)?;
    let cases: [(&str, &[&str], &[&str]); 4] = [
        (CAPTURE, &["--format", "MJPG"], &["MJPG", "GREY", "YUYV"]),
        (CAPTURE, &["--size", "650x480"], &["650x480", "640x480"]),
        (OUTPUT, &[], &[OUTPUT, "not a camera", CAPTURE]),
        ("/dev/video7", &[], &["/dev/video7", "no such device", CAPTURE]),
    ];
    for (device, more, words) in cases {
        program::run("unsupported", &arguments(device, more))?.refused(words)?;
    }
    Ok(String::new())
}
