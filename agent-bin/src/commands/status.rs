//! `loopbox status`: the state of an agent.

use crate::console::{self, Ended, Ending};
use anyhow::{Context, Result};
use clap::Args;
use loopbox::counted;
use loopbox::unattended::config::HEARTBEAT;
use loopbox::unattended::{AgentConfig, Heartbeat, heartbeat};
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Where the service of the Debian package has its file.
const OF_SERVICE: &str = "/etc/loopbox/agent.toml";

/// Show the state of an agent by its heartbeat; exit code 5 when it is not well or not there
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The agent's file, or the folder of its sessions; default: agent.toml here, else that of the service
    #[arg(value_name = "FILE|DIR")]
    place: Option<PathBuf>,
    /// Print it as JSON
    #[arg(long)]
    json: bool,
}

/// A heartbeat as it is printed.
#[derive(Serialize)]
struct Printed<'a> {
    /// Seconds since it was written.
    age_s: f64,
    /// Whether that is so long ago that nobody is there to write it.
    stale: bool,
    #[serde(flatten)]
    beat: &'a Heartbeat,
}

/// Prints it.
///
/// # Errors
/// When the agent is not well or not there.
pub fn execute(args: &StatusArgs) -> Result<()> {
    let place = args.place.clone().unwrap_or_else(|| {
        let here = PathBuf::from("agent.toml");
        if here.is_file() { here } else { OF_SERVICE.into() }
    });
    let not_well = |text: String| Ended { ending: Ending::NotWell, text };
    let beat = heartbeat::read(&file_of(&place)?).map_err(|error| not_well(loopbox::explained(&error)))?;
    let (age_s, stale) = (beat.age_s(), beat.is_stale());
    if args.json {
        let text = serde_json::to_string_pretty(&Printed { age_s, stale, beat: &beat })?;
        console::print(&(text + "\n"))?;
    } else {
        console::print(&described(&beat))?;
    }
    if stale {
        // Of a time before the system was started anew, nobody knows how long ago it was.
        let age = if age_s > 0.0 { format!("{age_s:.0} s") } else { "the system was started".into() };
        return Err(not_well(format!("{}: no heartbeat for {age}", beat.name)).into());
    }
    if !beat.healthy {
        return Err(not_well(format!("{}: {}", beat.name, beat.trouble.join("; "))).into());
    }
    Ok(())
}

/// The file of the heartbeat.
fn file_of(place: &Path) -> Result<PathBuf> {
    if place.is_dir() {
        return Ok(place.join(HEARTBEAT));
    }
    if place.extension().is_some_and(|extension| extension == "json") {
        return Ok(place.to_owned());
    }
    Ok(AgentConfig::read(place).context("no agent is known")?.heartbeat())
}

/// How it is, for people.
// Writing to a String cannot fail.
fn described(beat: &Heartbeat) -> String {
    let mut text = format!(
        "{}: {}, {:.1} frames/s, {} keyframes, up {:.0} s\n",
        beat.name,
        beat.state.name(),
        beat.frames_per_s,
        beat.keyframes,
        beat.up_s
    );
    let continued = beat.continues.as_ref().map_or("a new map".into(), |map| format!("goes on in {map}"));
    let _ = match beat.session {
        0 => writeln!(text, "no session yet"),
        session => writeln!(text, "session {session} in {}, {continued}", beat.folder),
    };
    let _ = writeln!(
        text,
        "{} of {} frames tracked, {} dropped, {} missed, lost {}",
        beat.tracked,
        beat.frames,
        beat.dropped,
        beat.missed,
        counted(beat.losses, "time", "times")
    );
    let mib = |bytes: u64| bytes >> 20;
    let free = beat.free_bytes.map_or(String::new(), |free| format!(" ({} free)", mib(free)));
    let memory = beat.memory_bytes.map_or("unknown".into(), |bytes| mib(bytes).to_string());
    let (disk, disk_limit) = (mib(beat.disk_bytes), mib(beat.disk_limit_bytes));
    let memory_limit = mib(beat.memory_limit_bytes);
    let _ = writeln!(text, "disk {disk} of {disk_limit} MiB{free}, memory {memory} of {memory_limit} MiB");
    if let Some(error) = &beat.last_error {
        let _ = writeln!(text, "last trouble: {error}");
    }
    text
}
