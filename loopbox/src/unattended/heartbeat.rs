//! The heartbeat: how an agent is, in a small file that is written every second.

use super::sessions::write_whole;
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::ErrorKind;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How often it is written.
pub const INTERVAL: Duration = Duration::from_secs(1);
/// An agent whose heartbeat is older is not there, or hangs.
pub const STALE: Duration = Duration::from_secs(5);
/// How long tracking may say nothing.
const SILENCE: Duration = Duration::from_secs(10);
/// How long reading a map, or writing one, may say nothing.
const LONG_WORK: Duration = Duration::from_secs(120);

/// What an agent is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It reads the map that it goes on in, and opens the source.
    #[default]
    Starting,
    /// The camera is not there, and waited for.
    Waiting,
    /// Frames come; the map is not begun yet.
    Initialising,
    /// Frames come and have poses.
    Tracking,
    /// Frames come and have none.
    Lost,
    /// The map is brought to the disk.
    Saving,
    /// A session failed; the next is about to begin.
    Failing,
    /// It has ended.
    Ended,
}

impl State {
    /// As people read it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Waiting => "waiting for the camera",
            Self::Initialising => "looking for a start",
            Self::Tracking => "tracking",
            Self::Lost => "lost",
            Self::Saving => "saving",
            Self::Failing => "failing",
            Self::Ended => "ended",
        }
    }

    /// Whether an agent that has said nothing for so long in this state still works.
    pub fn is_alive_after(self, silent: Duration) -> bool {
        match self {
            // Waiting needs no word of anybody.
            Self::Waiting => true,
            Self::Initialising | Self::Tracking | Self::Lost => silent < SILENCE,
            Self::Starting | Self::Saving | Self::Failing => silent < LONG_WORK,
            Self::Ended => false,
        }
    }
}

/// How an agent is.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Heartbeat {
    /// Version of the program.
    pub version: String,
    /// What people call the agent.
    pub name: String,
    /// Its process.
    pub process: u32,
    /// When it was written, seconds since 1970.
    pub time: f64,
    /// The same since the system started, which nobody sets.
    pub since_boot_s: f64,
    /// Seconds since the program started.
    pub up_s: f64,
    /// What it is doing.
    pub state: State,
    /// Whether it does what it is there for.
    pub healthy: bool,
    /// What is wrong, for people.
    pub trouble: Vec<String>,
    /// The number of the session.
    pub session: u32,
    /// Its folder.
    pub folder: String,
    /// The map that it goes on in.
    pub continues: Option<String>,
    /// Sessions that were begun since the program started.
    pub sessions: u32,
    /// Frames that were processed since the program started.
    pub frames: u64,
    /// Of these, frames with a pose.
    pub tracked: u64,
    /// Frames dropped late, in this session.
    pub dropped: u64,
    /// Frames that the driver missed, in this session.
    pub missed: u64,
    /// How often tracking was lost since the program started.
    pub losses: u64,
    /// Frames processed a second, over the last seconds.
    pub frames_per_s: f64,
    /// Seconds since the last frame.
    pub last_frame_s: Option<f64>,
    /// Keyframes of the map.
    pub keyframes: u64,
    /// Bytes that are kept on the disk.
    pub disk_bytes: u64,
    /// How many may be.
    pub disk_limit_bytes: u64,
    /// Bytes that are free there.
    pub free_bytes: Option<u64>,
    /// Resident memory, bytes.
    pub memory_bytes: Option<u64>,
    /// Where a session is ended.
    pub memory_limit_bytes: u64,
    /// The last thing that went wrong, for people.
    pub last_error: Option<String>,
}

impl Heartbeat {
    /// The same, written now.
    pub fn now(self) -> Self {
        let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        Self { version: env!("CARGO_PKG_VERSION").to_owned(), time, since_boot_s: since_boot(), ..self }
    }

    /// The file's text.
    ///
    /// # Errors
    /// Never, of numbers that JSON has.
    pub fn text(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(self).map(|text| text + "\n")
    }

    /// Seconds since it was written, by the clock that nobody sets; negative where the system was started anew.
    pub fn age_s(&self) -> f64 {
        since_boot() - self.since_boot_s
    }

    /// Whether whoever wrote it has gone, or hangs.
    pub fn is_stale(&self) -> bool {
        !(0.0..STALE.as_secs_f64()).contains(&self.age_s())
    }
}

/// Writes a heartbeat: whole, or on a full disk over the one before.
///
/// # Errors
/// When the system refuses.
pub fn write(path: &Path, text: &str) -> std::io::Result<()> {
    match write_whole(path, text.as_bytes()) {
        Err(error) if error.kind() == ErrorKind::StorageFull => {
            // The room of the one before is its own; blanks behind the end change nothing.
            let before = fs::metadata(path)?.len() as usize;
            let file = fs::File::options().write(true).open(path)?;
            std::os::unix::fs::FileExt::write_all_at(&file, format!("{text:before$}").as_bytes(), 0)
        }
        written => written,
    }
}

/// Reads a heartbeat.
///
/// # Errors
/// When there is none.
pub fn read(path: &Path) -> Result<Heartbeat> {
    let text = fs::read(path).with_context(|| {
        let path = path.display();
        format!("{path}: there is no heartbeat\nhint: is `loopbox agent` running, and is this its folder or its file?")
    })?;
    serde_json::from_slice(&text).with_context(|| format!("{}: not a heartbeat", path.display()))
}

fn since_boot() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heartbeat_grows_old() {
        let room = tempfile::tempdir().expect("a folder");
        let path = room.path().join("heartbeat.json");
        assert!(read(&path).is_err());
        let fresh = Heartbeat { frames: 7, ..Heartbeat::default() }.now();
        write(&path, &fresh.text().expect("it is JSON")).expect("there is room");
        let found = read(&path).expect("it is there");
        assert_eq!((found.frames, found.is_stale()), (7, false));
        let old = Heartbeat { since_boot_s: fresh.since_boot_s - 6.0, ..fresh.clone() };
        // Of before the system was started anew.
        let later = Heartbeat { since_boot_s: fresh.since_boot_s + 500.0, ..fresh };
        assert!(old.is_stale() && later.is_stale());
    }

    #[test]
    fn who_hangs_is_not_fed_and_who_waits_is() {
        let s = Duration::from_secs;
        assert!(State::Waiting.is_alive_after(s(86400)));
        assert!(State::Tracking.is_alive_after(s(9)) && !State::Tracking.is_alive_after(s(10)));
        assert!(State::Lost.is_alive_after(s(9)) && !State::Lost.is_alive_after(s(11)));
        assert!(State::Starting.is_alive_after(s(60)) && !State::Saving.is_alive_after(s(121)));
    }
}
