//! `loopbox doctor`: what this machine has of what loopbox can use.

use crate::{console, version};
use anyhow::Result;
use loopbox::run::free_bytes;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;
use std::thread::available_parallelism;
use view::process::available_memory_bytes;

/// Memory that recordings of some thousand images at 640×480 need, bytes.
const ENOUGH_MEMORY: u64 = 2 << 30;
/// Room that results of an hour want, bytes.
const ENOUGH_ROOM: u64 = 1 << 30;

/// Tell what this machine has of what loopbox can use, and how to get what lacks
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct DoctorArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What is known of one thing.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Finding {
    /// What was looked at.
    what: &'static str,
    state: State,
    /// What is there, or what lacks.
    text: String,
    /// What to do where something lacks.
    hint: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Ok,
    /// Some of what loopbox can do is not possible.
    Lacks,
}

impl State {
    fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Lacks => "lacks",
        }
    }
}

/// Runs it.
///
/// # Errors
/// When the list cannot be printed.
pub fn execute(args: DoctorArgs) -> Result<()> {
    let here = std::env::current_dir()?;
    let checks = [program(), machine(), room(&here), videos(), cameras()];
    let text = if args.json { serde_json::to_string_pretty(&checks)? + "\n" } else { as_text(&checks) };
    console::print(&text)
}

fn as_text(checks: &[Finding]) -> String {
    let mut text = String::new();
    for Finding { what, state, text: found, hint } in checks {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{:<6} {what:<8} {found}", state.name());
        if let Some(hint) = hint {
            let _ = writeln!(text, "{:<15} hint: {hint}", "");
        }
    }
    text
}

impl Finding {
    fn new(what: &'static str, text: String) -> Self {
        Self { what, state: State::Ok, text, hint: None }
    }

    fn lacks(self, hint: &str) -> Self {
        Self { state: State::Lacks, hint: Some(hint.to_owned()), ..self }
    }
}

fn program() -> Finding {
    Finding::new("program", version::long().replace('\n', "; "))
}

/// Cores and memory.
fn machine() -> Finding {
    let cores = available_parallelism().map_or(1, usize::from);
    let memory = available_memory_bytes();
    let text = match memory {
        Some(bytes) => format!("{cores} cores, {:.1} GB of memory available", bytes as f64 / 1e9),
        None => format!("{cores} cores"),
    };
    let finding = Finding::new("machine", text);
    if memory.is_some_and(|bytes| bytes < ENOUGH_MEMORY) {
        return finding.lacks("long recordings want 2 GB; --max-width 640 makes images smaller");
    }
    finding
}

/// Whether results can be written in a folder.
fn room(folder: &Path) -> Finding {
    let name = folder.display();
    let free = free_bytes(folder);
    let text =
        free.map_or_else(|| name.to_string(), |free| format!("{:.1} GB free in {name}", free as f64 / 1e9));
    let finding = Finding::new("results", text);
    if tempfile::tempfile_in(folder).is_err() {
        return Finding { text: format!("{name} cannot be written"), ..finding }
            .lacks("give a folder of yours with --out");
    }
    if free.is_some_and(|free| free < ENOUGH_ROOM) {
        return finding
            .lacks("an hour of a camera wants some hundred MB; give a folder on another disk with --out");
    }
    finding
}

/// Whether videos can be read.
fn videos() -> Finding {
    match sources::ffmpeg_versions() {
        Ok(versions) => Finding::new("videos", versions.join(", ")),
        Err(error) => {
            let error = format!("{error:#}");
            let (text, hint) = error.split_once("\nhint: ").unwrap_or((&error, "install ffmpeg"));
            Finding::new("videos", text.to_owned()).lacks(hint)
        }
    }
}

/// Whether live cameras can be used.
#[cfg(all(feature = "camera", target_os = "linux"))]
fn cameras() -> Finding {
    use sources::camera::list;
    let found = list::cameras(Path::new("/dev"));
    if found.is_empty() {
        return Finding::new("cameras", "none".to_owned()).lacks(list::NONE_HINT);
    }
    let text = |camera: &list::FoundCamera| match &camera.details {
        Ok(_) => format!("{} {}", camera.path.display(), camera.name),
        Err(reason) => format!("{}: {reason}", camera.path.display()),
    };
    let finding = Finding::new("cameras", found.iter().map(text).collect::<Vec<_>>().join("; "));
    if found.iter().any(|camera| camera.details.is_ok()) {
        return finding;
    }
    finding.lacks("`loopbox cameras` says more of each")
}

/// Whether live cameras can be used.
#[cfg(not(all(feature = "camera", target_os = "linux")))]
fn cameras() -> Finding {
    Finding::new("cameras", "this program was built without".to_owned())
        .lacks("build it with feature camera, on Linux")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_reported_with_what_to_do() {
        let checks = [Finding::new("videos", "no ffmpeg".to_owned()).lacks("install it")];
        assert_eq!(as_text(&checks), "lacks  videos   no ffmpeg\n                hint: install it\n");
        let folder = tempfile::tempdir().unwrap();
        assert!(room(folder.path()).text.contains("GB free in "));
        let nowhere = room(Path::new("/nowhere/at/all"));
        assert_eq!(
            (nowhere.state, nowhere.text.as_str()),
            (State::Lacks, "/nowhere/at/all cannot be written")
        );
    }
}
