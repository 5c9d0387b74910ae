//! Tracking and mapping what a camera sees.

use super::{pattern, truth};
use crate::driver::{CAPTURE, Mode};
use crate::player::{self, Pace, Player};
use crate::program::{self, Running};
use anyhow::{Context, Result, ensure};
use calib::read_camera;
use image::{GrayImage, Luma};
use serde_json::Value;
use std::path::Path;
use std::thread;
use std::time::Duration;

const SEQUENCE: &str = "/data/parking_a";
/// A frame later than this many seconds after a picture was played shows the picture: two ticks of the output, with
/// room for rounding.
const DISPLAYED_AFTER: f64 = 0.1;

/// Pictures of it that are played.
const PICTURES: usize = 45;
/// Calibration of the pictures at half their size.
pub const CALIBRATION: &str = "/tmp/half.yaml";

/// The first pictures of the sequence, as many as are played.
///
/// # Errors
/// When the sequence is not there.
pub fn sequence() -> Result<(Vec<GrayImage>, Mode)> {
    sequence_of(PICTURES)
}

/// The first pictures of the sequence at half their size, of which an emulated processor tracks four times as many,
/// and how they go through the driver. Writes the calibration of that size, too.
///
/// # Errors
/// When the sequence is not there.
pub fn sequence_of(count: usize) -> Result<(Vec<GrayImage>, Mode)> {
    let mut pictures = player::pictures(&Path::new(SEQUENCE).join("images"))?;
    pictures.truncate(count);
    let halves: Vec<GrayImage> = pictures.iter().map(half).collect();
    let (width, height) = halves.first().context("no pictures")?.dimensions();
    let file = read_camera(&Path::new(SEQUENCE).join("camera.yaml"))?;
    let p = *file.camera.intrinsics();
    // Pixel centres lie at integers: the corner of the image is at -0.5.
    let centre = |c: f64| (c + 0.5) / 2.0 - 0.5;
    let text = format!(
        "model: pinhole\nwidth: {width}\nheight: {height}\nfx: {}\nfy: {}\ncx: {}\ncy: {}\ndistortion: []\n",
        p.fx / 2.0,
        p.fy / 2.0,
        centre(p.cx),
        centre(p.cy)
    );
    std::fs::write(CALIBRATION, text)?;
    Ok((halves, Mode { width, height, ..Mode::USUAL }))
}

/// The means of two by two pixels.
fn half(picture: &GrayImage) -> GrayImage {
    let (width, height) = picture.dimensions();
    GrayImage::from_fn(width / 2, height / 2, |x, y| {
        let at = |dx, dy| u32::from(picture.get_pixel(2 * x + dx, 2 * y + dy).0[0]);
        Luma([((at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1) + 2) / 4) as u8])
    })
}

/// Arguments of a run on the driver's camera, with the sequence's calibration.
pub fn arguments<'a>(more: &[&'a str]) -> Vec<&'a str> {
    let always = ["run", "--camera", CAPTURE, "--calib", CALIBRATION, "--out", "OUT", "--log", "json"];
    [&always[..], more].concat()
}

/// Plays so many further pictures, each until a frame that shows it was processed.
pub fn follow(player: &Player, run: &mut Running, count: usize) -> Result<()> {
    for _ in 0..count {
        let time = player.advance()?;
        run.wait_for_frame(time + DISPLAYED_AFTER)?;
    }
    Ok(())
}

/// Plays the sequence once, and compares the trajectory with its truth.
pub fn played_sequence() -> Result<String> {
    let (pictures, mode) = sequence()?;
    let player = Player::start(&pictures, &mode, Pace::OnDemand)?;
    let mut run = program::start("slam", &arguments(&[]), 0)?;
    run.wait_for_frame(0.0)?;
    follow(&player, &mut run, pictures.len() - 1)?;
    run.signal("-INT")?;
    let ended = run.wait()?.succeeded()?;
    let played = player.stop()?;

    let numbers = ended.numbers()?;
    let count =
        |name: &str| numbers["frames"][name].as_u64().with_context(|| format!("run.json has no {name}"));
    let (processed, tracked) = (count("processed")?, count("tracked")?);
    ensure!(
        tracked * 10 >= processed * 9,
        "{tracked} of {processed} frames were tracked:\n{}\n{}",
        states(&numbers),
        ended.messages
    );
    let truth = ended.out.with_file_name("truth.txt");
    let trajectory = ended.out.join("trajectory.txt");
    truth::write(&trajectory, &Path::new(SEQUENCE).join("groundtruth.txt"), &played, &truth)?;
    let (estimate, reference) = (trajectory.display().to_string(), truth.display().to_string());
    let compared =
        program::run("slam_eval", &["eval", &estimate, "--gt", &reference, "--json"])?.succeeded()?;
    let compared: Value = serde_json::from_str(&compared.output)?;
    let latency = &numbers["cost"]["latency_ms"];
    let number = |name: &str| {
        latency[name].as_f64().with_context(|| format!("run.json has no {name} latency: {latency}"))
    };
    let (median, p99) = (number("median")?, number("p99")?);
    // The median: a frame that is taken in the moment of change may be held against the picture before, 12 cm away.
    let error = compared["ate"]["median"].as_f64().context("eval gives no ate.median")?;
    ensure!(error < 0.05, "the trajectory is {error} m from the truth in the median:\n{compared}");
    Ok(format!(
        "{tracked}/{processed} tracked, median error {:.1} cm; capture to pose {median:.0} ms, 99 % {p99:.0} ms, emulated",
        error * 100.0
    ))
}

/// Time, state and milliseconds of each frame of a run, a line each, from its run.json.
fn states(numbers: &Value) -> String {
    let rows = numbers["rows"].as_array().map_or(&[][..], Vec::as_slice);
    let line = |row: &Value| format!("{} {} {}", row["timestamp"], row["state"], row["ms"]);
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// Stops the process for a while, as a suspended or starved machine does.
pub fn stopped_process() -> Result<String> {
    let (_, mode) = sequence()?;
    let player = Player::start(&[pattern(mode.width, mode.height, 5)], &mode, Pace::OnDemand)?;
    let mut run = program::start("stopped", &arguments(&[]), 0)?;
    run.wait_for_frame(0.0)?;
    run.signal("-STOP")?;
    thread::sleep(Duration::from_millis(1500));
    let stopped = player::now()?;
    run.signal("-CONT")?;
    run.wait_for_frame(stopped)?;
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
