//! A camera that is taken away while it runs, by unbinding the driver, and given back.

use super::slam::{self, PACE, arguments};
use crate::driver::{self, CAPTURE};
use crate::player::Player;
use crate::program::{self, Running, SOME_USER};
use anyhow::{Context, Result, ensure};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

const DRIVER: &str = "/sys/bus/platform/drivers/vivid";
const INSTANCE: &str = "vivid.0";
/// What stands in the log for each frame that was tracked.
const TRACKED: &str = "\"state\":\"tracking\"";

/// Takes the device away.
fn unplug() -> Result<()> {
    fs::write(Path::new(DRIVER).join("unbind"), INSTANCE).context("unbinding the driver")
}

/// Gives it back, to root alone, as it is until udev has had its say.
fn plug_in() -> Result<()> {
    fs::write(Path::new(DRIVER).join("bind"), INSTANCE).context("binding the driver")?;
    let start = Instant::now();
    while !Path::new(CAPTURE).exists() {
        ensure!(start.elapsed() < Duration::from_secs(5), "{CAPTURE} does not come back");
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

fn allow_everybody() -> Result<()> {
    Ok(fs::set_permissions(CAPTURE, fs::Permissions::from_mode(0o666))?)
}

fn wait_until_tracked(run: &mut Running, count: usize) -> Result<()> {
    while run.count(TRACKED) < count {
        ensure!(run.goes_on()?, "the run ended after {} tracked frames", run.count(TRACKED));
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Without `--reconnect`.
pub fn ends_the_run() -> Result<String> {
    let (pictures, mode) = slam::sequence()?;
    let player = Player::start(&pictures, &mode, PACE)?;
    let mut run = program::start("unplugged", &arguments(&[]), 0)?;
    wait_until_tracked(&mut run, 12)?;
    unplug()?;
    let ended = run.wait()?;
    // The player's device is gone too.
    let _ = player.stop();
    plug_in()?;
    let ended = ended.refused(&[CAPTURE, "--reconnect"])?;
    let map = ended.out.join("map.mcap").display().to_string();
    let info = program::run("unplugged_info", &["info", &map, "--json"])?.succeeded()?;
    let poses = fs::read_to_string(ended.out.join("trajectory.txt"))?.lines().count();
    ensure!(poses >= 10, "{poses} poses were saved:\n{}", info.output);
    Ok(format!("{poses} poses saved"))
}

/// With `--reconnect`, by a user who may use the device only a while after it is back.
pub fn goes_on() -> Result<String> {
    let (pictures, mode) = slam::sequence()?;
    let (first, second) = pictures.split_at(pictures.len() / 3);
    let player = Player::start(first, &mode, PACE)?;
    allow_everybody()?;
    let mut run = program::start("reconnect", &arguments(&["--reconnect"]), SOME_USER)?;
    player.wait_for(first.len())?;
    wait_until_tracked(&mut run, 12)?;
    unplug()?;
    let _ = player.stop();
    thread::sleep(Duration::from_secs(1));
    ensure!(run.goes_on()?, "the run ended when the camera went away");
    let before = run.count(TRACKED);
    plug_in()?;
    // From a place that the map knows.
    let again: Vec<_> = first.iter().rev().take(3).rev().chain(second).cloned().collect();
    let player = Player::start(&again[..again.len().min(30)], &mode, PACE)?;
    allow_everybody()?;
    wait_until_tracked(&mut run, before + 15)?;
    run.signal("-INT")?;
    let ended = run.wait()?.succeeded()?;
    player.stop()?;
    driver::connect(&mode)?;
    let tracked = ended.numbers()?["frames"]["tracked"].as_u64().context("run.json has no frames.tracked")?;
    ensure!(tracked as usize >= before + 15, "{tracked} poses; {before} frames were tracked before");
    Ok(format!("{before} frames tracked before, {} after", tracked as usize - before))
}
