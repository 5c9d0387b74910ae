//! A trial of the service as the Debian package installs it, under systemd, on the driver: it is begun, killed, stopped by
//! a signal until the watchdog sees it, unplugged, ended, upgraded and removed.

use crate::checks::{CALIBRATION, plug_in, sequence_of, unplug};
use crate::player::{Pace, Player};
use anyhow::{Context, Result, bail, ensure};
use image::GrayImage;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

const SERVICE: &str = "loopbox";
/// The package, as `script/service` puts it there.
const PACKAGE: &str = "/root/loopbox.deb";
/// What the package's own file names.
const CAMERA: &str = "/etc/loopbox/camera.yaml";
const STATE: &str = "/var/lib/loopbox";
const HEARTBEAT: &str = "/run/loopbox/heartbeat.json";
/// Users that systemd makes for a while.
const DYNAMIC_USERS: std::ops::RangeInclusive<u32> = 61184..=65519;
/// Always back within so many seconds.
const BACK: f64 = 5.0;
/// Of the unit, seconds.
const WATCHDOG: f64 = 30.0;
/// How long a process that the watchdog has ended may take to die, as its core is left, seconds.
const DYING: f64 = 6.0;
/// Longer than anything takes, seconds.
const PATIENCE: f64 = 60.0;
/// Pictures of the sequence, there and back again.
const PICTURES: usize = 90;

/// Runs it, with so many pictures a second.
///
/// # Errors
/// When the service does not do what its unit promises.
pub fn run(rate: f64) -> Result<()> {
    let (pictures, mode) = sequence_of(PICTURES)?;
    fs::copy(CALIBRATION, CAMERA).context(CAMERA)?;
    let there = pictures.iter().chain(pictures.iter().rev());
    let pictures: Vec<GrayImage> = there.cycle().take(40 * PICTURES).cloned().collect();
    let play = || Player::start(&pictures, &mode, Pace::PerSecond(rate));
    let player = play()?;

    let began = Instant::now();
    systemctl(&["enable", "--now", SERVICE])?;
    ensure!(property("ActiveState")? == "active", "started, it is {}", property("ActiveState")?);
    let active = began.elapsed().as_secs_f64();
    let process = tracking(&began, None)?;
    println!("begun: ready after {active:.1} s, tracking after {:.1} s", began.elapsed().as_secs_f64());
    as_promised(process)?;
    for user in ["root", "nobody"] {
        let status = as_user(user, &["loopbox", "status"])?;
        ensure!(status.starts_with("video0: tracking"), "status of {user}: {status}");
    }
    wait_for_keyframes();

    let process = again("killed", "-KILL", process, BACK)?;
    wait_for_keyframes();
    let process = again("stopped by a signal", "-STOP", process, WATCHDOG + DYING + BACK)?;
    ensure!(property("NRestarts")? == "2", "{} restarts", property("NRestarts")?);
    wait_for_keyframes();

    unplug()?;
    let _ = player.stop();
    wait("waiting", |beat| beat["state"] == "waiting")?;
    sleep(Duration::from_secs(2));
    plug_in()?;
    let plugged = Instant::now();
    let player = play()?;
    let same = tracking(&plugged, None)?;
    ensure!(same == process, "another process after unplugging");
    println!("unplugged: tracking after {:.1} s", plugged.elapsed().as_secs_f64());
    wait_for_keyframes();

    let keyframes = ended()?;
    let began = Instant::now();
    systemctl(&["start", SERVICE])?;
    let process = tracking(&began, None)?;
    let continued = beat().and_then(|beat| beat["continues"].as_str().map(str::to_owned));
    ensure!(continued.is_some(), "begun again after {keyframes} keyframes, it begins a new map");
    println!("begun again: tracking in its map after {:.1} s", began.elapsed().as_secs_f64());

    upgraded(process)?;
    removed()?;
    player.stop()?;
    Ok(())
}

/// Time in which keyframes are made.
fn wait_for_keyframes() {
    sleep(Duration::from_secs(10));
}

/// Waits until the service tracks, with another process than the one before; its process.
fn tracking(since: &Instant, before: Option<u32>) -> Result<u32> {
    wait("tracking", |beat| {
        beat["state"] == "tracking"
            && beat["up_s"].as_f64().is_some_and(|up| before.is_none() || up < since.elapsed().as_secs_f64())
            && beat["last_frame_s"].as_f64().is_some_and(|seconds| seconds < 1.0)
            && beat["process"].as_u64() != before.map(u64::from)
    })?;
    let process = property("MainPID")?.parse().context("MainPID")?;
    let described = beat().and_then(|beat| beat["process"].as_u64());
    ensure!(
        described == Some(u64::from(process)),
        "the heartbeat is of {described:?}, the service is {process}"
    );
    Ok(process)
}

/// The user, its groups and the places that the unit promises.
fn as_promised(process: u32) -> Result<()> {
    let status = fs::read_to_string(format!("/proc/{process}/status"))?;
    let numbers = |key: &str| -> Vec<u32> {
        let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
        line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
    };
    let users = numbers("Uid:");
    ensure!(users.iter().all(|user| DYNAMIC_USERS.contains(user)), "it runs as {users:?}");
    let groups = command("getent", &["group", "video"])?;
    let video: u32 =
        groups.split(':').nth(2).and_then(|number| number.parse().ok()).context("no group video")?;
    ensure!(numbers("Groups:").contains(&video), "it is not of the group video");
    ensure!(Path::new(STATE).join("000001").is_dir(), "no session in {STATE}");
    println!("user {}, group video, sessions in {STATE}", users[0]);
    Ok(())
}

/// Sends a signal and waits until another process tracks, in the map of the one before; seconds may be so many.
fn again(what: &str, signal: &str, process: u32, most: f64) -> Result<u32> {
    let folder =
        beat().and_then(|beat| beat["folder"].as_str().map(str::to_owned)).context("no heartbeat")?;
    let began = Instant::now();
    // The shell's own: a minimal Debian has no program of that name.
    command("sh", &["-c", &format!("kill {signal} {process}")])?;
    let next = tracking(&began, Some(process))?;
    let took = began.elapsed().as_secs_f64();
    let continued = beat().and_then(|beat| beat["continues"].as_str().map(str::to_owned)).unwrap_or_default();
    println!("{what}: tracking after {took:.1} s");
    ensure!(continued.starts_with(&folder), "{what}: {folder} is not gone on with, but '{continued}'");
    ensure!(took <= most, "{what}: {took:.1} s are more than {most}");
    Ok(next)
}

/// Ends it; keyframes of the map that it left.
fn ended() -> Result<u64> {
    let before = beat().context("no heartbeat")?;
    let began = Instant::now();
    systemctl(&["stop", SERVICE])?;
    let took = began.elapsed().as_secs_f64();
    let (result, code) = (property("Result")?, property("ExecMainStatus")?);
    ensure!(result == "success" && code == "0", "ended with {result}, {code}");
    ensure!(took <= BACK, "ending took {took:.1} s");
    let folder = before["folder"].as_str().context("no folder")?;
    let about: Value =
        serde_json::from_str(&command("loopbox", &["info", &format!("{folder}/map.mcap"), "--json"])?)?;
    let (described, there) = (before["keyframes"].as_u64(), about["keyframes"].as_u64());
    ensure!(there >= described && described > Some(0), "{there:?} keyframes were saved of {described:?}");
    println!("ended: within {took:.1} s, exit code {code}, {} keyframes saved", there.unwrap_or_default());
    Ok(there.unwrap_or_default())
}

/// Installing the package again has the service run the new program, in the same map.
fn upgraded(process: u32) -> Result<()> {
    let file = Path::new("/etc/loopbox/agent.toml");
    let mine = fs::read_to_string(file)?.replacen("# name = ", "name = ", 1);
    fs::write(file, &mine)?;
    let began = Instant::now();
    command("dpkg", &["--install", PACKAGE])?;
    let next = tracking(&began, Some(process))?;
    let named = beat().is_some_and(|beat| beat["name"] == "rover");
    ensure!(named && fs::read_to_string(file)? == mine, "the agent's file was not kept");
    println!("upgraded: process {process} gave way to {next}, the agent's file is kept");
    Ok(())
}

/// Removing the package ends the service, and leaves its maps and its file.
fn removed() -> Result<()> {
    command("dpkg", &["--remove", SERVICE])?;
    let state = command("systemctl", &["show", "--value", "--property", "ActiveState", SERVICE])?;
    ensure!(state.trim() == "inactive", "removed, it is {state}");
    ensure!(Path::new(STATE).join("000001").is_dir(), "its maps are gone");
    ensure!(Path::new("/etc/loopbox/agent.toml").is_file(), "its file is gone");
    println!("removed: it ended, maps and file are there");
    Ok(())
}

/// The heartbeat.
fn beat() -> Option<Value> {
    serde_json::from_slice(&fs::read(HEARTBEAT).ok()?).ok()
}

fn wait(what: &str, condition: impl Fn(&Value) -> bool) -> Result<()> {
    let began = Instant::now();
    while !beat().is_some_and(|beat| condition(&beat)) {
        if began.elapsed().as_secs_f64() > PATIENCE {
            let log = command("journalctl", &["--no-pager", "--unit", SERVICE, "--lines", "30"])?;
            bail!("not {what} after {PATIENCE} s: {:?}\n{log}", beat());
        }
        sleep(Duration::from_millis(100));
    }
    Ok(())
}

fn property(name: &str) -> Result<String> {
    let text = command("systemctl", &["show", "--value", "--property", name, SERVICE])?;
    Ok(text.trim().to_owned())
}

fn systemctl(arguments: &[&str]) -> Result<()> {
    command("systemctl", arguments).map(drop)
}

fn as_user(user: &str, arguments: &[&str]) -> Result<String> {
    command("runuser", &[&["-u", user, "--"], arguments].concat())
}

/// What a program prints; its failure with what it said.
fn command(program: &str, arguments: &[&str]) -> Result<String> {
    let output = Command::new(program).args(arguments).output().with_context(|| program.to_owned())?;
    let message = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{program} {}: {}\n{message}", arguments.join(" "), output.status);
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
