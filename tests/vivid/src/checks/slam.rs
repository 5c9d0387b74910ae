//! Tracking and mapping what a camera sees.

use super::{pattern, truth};
use crate::driver::{CAPTURE, Mode};
use crate::player::{self, Player};
use crate::program;
use anyhow::{Context, Result, ensure};
use image::GrayImage;
use std::path::Path;
use std::thread;
use std::time::Duration;

const SEQUENCE: &str = "/data/parking_a";
/// Pictures per second: as fast as an emulated processor tracks them.
pub const PACE: f64 = 3.0;

/// The pictures of the sequence, and how they go through the driver.
pub fn sequence() -> Result<(Vec<GrayImage>, Mode)> {
    let pictures = player::pictures(&Path::new(SEQUENCE).join("images"))?;
    let (width, height) = pictures.first().context("no pictures")?.dimensions();
    Ok((pictures, Mode { width, height, ..Mode::USUAL }))
}

/// Arguments of a run on the driver's camera, with the sequence's calibration.
pub fn arguments<'a>(more: &[&'a str]) -> Vec<&'a str> {
    let always = [
        "run",
        "--camera",
        CAPTURE,
        "--calib",
        "/data/parking_a/camera.yaml",
        "--out",
        "OUT",
        "--log",
        "json",
    ];
    [&always[..], more].concat()
}

/// Plays the sequence once, and compares the trajectory with its truth.
pub fn played_sequence() -> Result<String> {
    let (pictures, mode) = sequence()?;
    let player = Player::start(&pictures, &mode, PACE)?;
    let run = program::start("slam", &arguments(&[]), 0)?;
    player.wait_for(pictures.len())?;
    thread::sleep(Duration::from_secs(1));
    run.signal("-INT")?;
    let ended = run.wait()?.succeeded()?;
    let played = player.stop()?;

    let numbers = ended.numbers()?;
    let count =
        |name: &str| numbers["frames"][name].as_u64().with_context(|| format!("run.json has no {name}"));
    let (processed, tracked) = (count("processed")?, count("tracked")?);
    ensure!(
        tracked * 10 >= processed * 9,
        "{tracked} of {processed} frames were tracked:\n{}",
        ended.messages
    );
    let truth = ended.out.with_file_name("truth.txt");
    let trajectory = ended.out.join("trajectory.txt");
    truth::write(&trajectory, &Path::new(SEQUENCE).join("groundtruth.txt"), &played, &truth)?;
    let (estimate, reference) = (trajectory.display().to_string(), truth.display().to_string());
    let compared =
        program::run("slam_eval", &["eval", &estimate, "--gt", &reference, "--json"])?.succeeded()?;
    Ok(format!("{tracked}/{processed} tracked {}", compared.output.replace('\n', " ")))
}

/// Stops the process for a while, as a suspended or starved machine does.
pub fn stopped_process() -> Result<String> {
    let mode = Mode::USUAL;
    let player = Player::start(&[pattern(mode.width, mode.height, 5)], &mode, 30.0)?;
    let mut run = program::start("stopped", &arguments(&[]), 0)?;
    run.wait_for_text("{")?;
    thread::sleep(Duration::from_secs(1));
    run.signal("-STOP")?;
    thread::sleep(Duration::from_millis(1500));
    run.signal("-CONT")?;
    thread::sleep(Duration::from_secs(1));
    run.signal("-INT")?;
    let ended = run.wait()?;
    player.stop()?;
    let missed = ended.numbers()?["frames"]["missed_by_driver"]
        .as_u64()
        .context("run.json has no frames.missed_by_driver")?;
    // Not all of 45: the driver goes on filling the buffers that it has.
    ensure!(missed >= 30, "{missed} frames missed in 1.5 s at 30 frames/s:\n{}", ended.messages);
    Ok(format!("{missed} missed"))
}
