//! Three processes on this machine: a station, and two agents that replay recordings.

use crate::console::{self, tell};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::{Context, Result, bail};
use loopbox::fleet::read_status;
use sources::Stop;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// How long the station may take to listen.
const START: Duration = Duration::from_secs(20);
const LOOK: Duration = Duration::from_millis(50);

/// A process that is ended when nobody wants it any more.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs the demonstration.
///
/// # Errors
/// When there are not two recordings, or a process fails.
pub fn run(recordings: &Path, out: &Path) -> Result<()> {
    let found = recordings_in(recordings)?;
    let [first, second] = &found[..] else {
        bail!(
            "{}: holds {} recordings, the demonstration takes two\nhint: run it where loopbox's demo/ is",
            recordings.display(),
            found.len()
        );
    };
    let stop = stop_on_ctrl_c("stopping (Ctrl-C again to abort)")?;
    let station_out = out.join("station");
    // What an earlier station said is not what this one says.
    let _ = std::fs::remove_file(station_out.join(loopbox::fleet::STATUS));
    let station = ["station", "--listen", "tcp/127.0.0.1:0", "--agents", "2", "--quiet", "--out"];
    let mut station = start(Command::new(program()?).args(station).arg(&station_out))?;
    let at = wait_for_address(&station_out, &mut station, &stop)?;
    tell!("a station listens at {at}; two agents replay {} and {}", first.display(), second.display());
    let agent = |recording: &PathBuf| -> Result<Process> {
        let name = recording.file_name().map_or_else(|| "agent".into(), |name| name.to_os_string());
        let mut command = Command::new(program()?);
        command.arg("run").arg(recording).args(["--quiet", "--connect", &at, "--out"]);
        let mut fleet = std::ffi::OsString::from("--fleet=");
        fleet.push(&name);
        start(command.arg(out.join(&name)).arg(fleet))
    };
    let mut agents = [agent(first)?, agent(second)?];
    for (name, process) in
        ["an agent", "an agent"].into_iter().zip(&mut agents).chain([("the station", &mut station)])
    {
        finish(name, process, &stop)?;
    }
    let status = read_status(&station_out)?;
    // The station has said how it ended.
    if status.found.accepted() == 0 {
        bail!("the agents did not meet");
    }
    console::print(&format!(
        "the common map is {}; `loopbox view {}` shows it\n",
        station_out.join("map.mcap").display(),
        station_out.display()
    ))
}

/// The recordings of a folder, in order of their names.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries =
        std::fs::read_dir(folder).with_context(|| {
            format!(
                "{}: no folder of recordings\nhint: run it where loopbox's demo/ is, or name a folder with two recordings",
                folder.display()
            )
        })?;
    let mut found: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    found.retain(|path| path.is_dir());
    found.sort();
    Ok(found)
}

fn program() -> Result<PathBuf> {
    std::env::current_exe().context("the program does not find itself")
}

fn start(command: &mut Command) -> Result<Process> {
    Ok(Process(command.spawn().context("a process cannot be started")?))
}

/// Where the station listens, once it does.
fn wait_for_address(out: &Path, station: &mut Process, stop: &Stop) -> Result<String> {
    let begun = Instant::now();
    while begun.elapsed() < START && !stop.requested() {
        if let Some(at) = read_status(out).ok().and_then(|status| status.listening) {
            return Ok(at);
        }
        if let Some(ended) = station.0.try_wait()? {
            bail!("the station ended before it listened ({ended})");
        }
        std::thread::sleep(LOOK);
    }
    bail!("the station does not listen")
}

/// Waits for a process to end.
fn finish(name: &str, process: &mut Process, stop: &Stop) -> Result<()> {
    loop {
        match process.0.try_wait()? {
            Some(ended) if ended.success() => return Ok(()),
            Some(ended) => bail!("{name} failed ({ended})"),
            None if stop.requested() => bail!("interrupted"),
            None => std::thread::sleep(LOOK),
        }
    }
}
