//! The agent under trial, and what it leaves.

use crate::checks::CALIBRATION;
use crate::driver::CAPTURE;
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

const PROGRAM: &str = "/bin/loopbox";
/// A disk of its own.
pub const PLACE: &str = "/tmp/robot";
const FILE: &str = "/tmp/agent.toml";
const HEARTBEAT: &str = "/tmp/heartbeat.json";
const LOG: &str = "/tmp/agent.log";
/// Longer than anything takes, seconds.
const PATIENCE: f64 = 30.0;

/// Writes the agent's file: a budget of disk and memory, MiB.
pub fn write_file(disk: u64, memory: u64) -> Result<()> {
    let text = format!(
        "name = \"robot\"\nout = \"{PLACE}/kept\"\nheartbeat = \"{HEARTBEAT}\"\n\
         [camera]\ndevice = \"{CAPTURE}\"\ncalibration = \"{CALIBRATION}\"\nlock = [\"all\"]\n\
         [record]\nenabled = true\nfile_mib = 2\n\
         [limits]\ndisk_mib = {disk}\nfree_mib = 16\nmemory_mib = {memory}\n"
    );
    Ok(fs::write(FILE, text)?)
}

/// What the agent told people last.
pub fn log() -> String {
    let text = fs::read_to_string(LOG).unwrap_or_default();
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(20)..].join("\n")
}

/// The heartbeat.
pub fn beat() -> Option<Value> {
    serde_json::from_slice(&fs::read(HEARTBEAT).ok()?).ok()
}

/// Bytes that the agent keeps.
pub fn kept_bytes() -> u64 {
    bytes_in(&Path::new(PLACE).join("kept"))
}

fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let bytes = |entry: fs::DirEntry| match entry.metadata() {
        Ok(about) if about.is_dir() => bytes_in(&entry.path()),
        Ok(about) => about.len(),
        Err(_) => 0,
    };
    entries.map(bytes).sum()
}

/// Keyframes of the map that a session left.
pub fn keyframes_in(folder: &Path) -> Option<u64> {
    let output =
        Command::new(PROGRAM).arg("info").arg(folder.join("map.mcap")).arg("--json").output().ok()?;
    let about: Value = serde_json::from_slice(&output.stdout).ok()?;
    about["keyframes"].as_u64()
}

/// The agent at work.
pub struct Agent(Child);

impl Agent {
    /// Starts it.
    ///
    /// # Errors
    /// When that is not possible.
    pub fn start() -> Result<Self> {
        // That of the one before says nothing of this one.
        let _ = fs::remove_file(HEARTBEAT);
        let log = File::options().create(true).append(true).open(LOG)?;
        let mut command = Command::new(PROGRAM);
        command.args(["agent", FILE]).stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        Ok(Self(command.spawn().context(PROGRAM)?))
    }

    /// Whether it still runs.
    ///
    /// # Errors
    /// When the system cannot say.
    pub fn is_running(&mut self) -> Result<bool> {
        Ok(self.0.try_wait()?.is_none())
    }

    /// Waits until the heartbeat is as wished.
    ///
    /// # Errors
    /// When it ends, or is not so within so many seconds.
    pub fn wait(&mut self, what: &str, seconds: f64, condition: impl Fn(&Value) -> bool) -> Result<()> {
        let began = Instant::now();
        while !beat().is_some_and(|beat| condition(&beat)) {
            if !self.is_running()? || began.elapsed().as_secs_f64() > seconds {
                bail!("not {what} after {:.0} s: {:?}\n{}", began.elapsed().as_secs_f64(), beat(), log());
            }
            sleep(Duration::from_millis(20));
        }
        Ok(())
    }

    /// Waits until frames come, and until they have poses; seconds since a moment, as heartbeats tell (one a second).
    ///
    /// # Errors
    /// As [`wait`](Self::wait).
    pub fn back(&mut self, since: Instant) -> Result<(f64, f64)> {
        let maps = |beat: &Value| {
            ["initialising", "tracking", "lost"].iter().any(|state| beat["state"] == *state)
                && beat["last_frame_s"].as_f64().is_some_and(|seconds| seconds < 0.5)
        };
        self.wait("back", PATIENCE, maps)?;
        let back = since.elapsed().as_secs_f64();
        self.wait("tracking", PATIENCE, |beat| beat["state"] == "tracking")?;
        Ok((back, since.elapsed().as_secs_f64()))
    }

    /// As a power cut, but for the disk.
    ///
    /// # Errors
    /// When it has ended before.
    pub fn kill(&mut self) -> Result<()> {
        self.0.kill()?;
        self.0.wait()?;
        Ok(())
    }

    /// Stops it; its exit code, and the seconds that took.
    ///
    /// # Errors
    /// When it has ended before, or does not end.
    pub fn stop(&mut self) -> Result<(Option<i32>, f64)> {
        let began = Instant::now();
        Command::new("/bin/kill").args(["-TERM", &self.0.id().to_string()]).status()?;
        Ok((self.0.wait()?.code(), began.elapsed().as_secs_f64()))
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
