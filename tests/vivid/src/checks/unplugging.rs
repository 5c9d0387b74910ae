//! A camera that is taken away while it runs, by unbinding the driver, and given back.

use super::slam::{self, arguments, follow};
use crate::driver::CAPTURE;
use crate::player::{self, Pace, Player};
use crate::program::{self, SOME_USER};
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
///
/// # Errors
/// When the system refuses.
pub fn unplug() -> Result<()> {
    fs::write(Path::new(DRIVER).join("unbind"), INSTANCE).context("unbinding the driver")
}

/// Gives it back, to root alone, as it is until udev has had its say.
///
/// # Errors
/// When it does not come back.
pub fn plug_in() -> Result<()> {
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

/// Pictures that are enough to start a map and go on with it.
const BEFORE: usize = 16;
const AFTER: usize = 10;

/// Without `--reconnect`.
pub fn ends_the_run() -> Result<String> {
    let (pictures, mode) = slam::sequence()?;
    let player = Player::start(&pictures, &mode, Pace::OnDemand)?;
    let mut run = program::start("unplugged", &arguments(&[]), 0)?;
    run.wait_for_frame(0.0)?;
    follow(&player, &mut run, BEFORE)?;
    unplug()?;
    let ended = run.wait()?;
    // The player's device is gone too.
    let _ = player.stop();
    plug_in()?;
    let ended = ended.refused(&[CAPTURE, "--reconnect"])?;
    let map = ended.out.join("map.mcap").display().to_string();
    let info = program::run("unplugged_info", &["info", &map, "--json"])?.succeeded()?;
    let poses = fs::read_to_string(ended.out.join("trajectory.txt"))?.lines().count();
    ensure!(poses >= BEFORE / 2, "{poses} poses were saved:\n{}", info.output);
    Ok(format!("{poses} poses saved"))
}

/// With `--reconnect`, by a user who may use the device only a while after it is back.
pub fn the_run_continues() -> Result<String> {
    let (pictures, mode) = slam::sequence()?;
    let player = Player::start(&pictures, &mode, Pace::OnDemand)?;
    allow_everybody()?;
    let mut run = program::start("reconnect", &arguments(&["--reconnect"]), SOME_USER)?;
    run.wait_for_frame(0.0)?;
    follow(&player, &mut run, BEFORE)?;
    unplug()?;
    let _ = player.stop();
    run.wait_for_text("\"event\":\"gone\"")?;
    ensure!(run.is_running()?, "the run ended when the camera went away");
    let before = run.count(TRACKED);
    ensure!(before >= BEFORE / 2, "{before} frames were tracked before the camera went away");
    plug_in()?;
    // From a place that the map knows.
    let player = Player::start(&pictures[BEFORE - 3..], &mode, Pace::OnDemand)?;
    let back = player::now()?;
    allow_everybody()?;
    run.wait_for_frame(back)?;
    follow(&player, &mut run, AFTER)?;
    run.signal("-INT")?;
    let ended = run.wait()?.succeeded()?;
    player.stop()?;
    let tracked = ended.numbers()?["frames"]["tracked"].as_u64().context("run.json has no frames.tracked")?;
    ensure!(tracked as usize >= before + AFTER - 2, "{tracked} poses; {before} frames were tracked before");
    Ok(format!("{before} frames tracked before, {} after", tracked as usize - before))
}
