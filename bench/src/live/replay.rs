//! Whether a recording gives the run again, bit for bit.

use super::latency;
use super::program::{Pace, Task};
use crate::measure::{Run, Runner, finish, read};
use anyhow::Result;
use map::{Map, load_map};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A run and another one over a recording of it, or over the same frames in another form.
pub struct Replayed {
    /// What was done.
    pub what: String,
    /// Frames that the first run processed.
    pub processed: Option<f64>,
    /// Frames that it dropped.
    pub dropped: Option<f64>,
    /// Whether trajectory.txt is the same byte for byte.
    pub trajectory: bool,
    /// Whether cloud.ply is.
    pub cloud: bool,
    /// Whether the maps are, but for where they say that they come from.
    pub map: bool,
}

impl Replayed {
    /// Whether all is the same.
    pub fn is_same(&self) -> bool {
        self.trajectory && self.cloud && self.map
    }
}

/// Replays a run in real time that dropped frames, a run with all frames, and the latter's frames after conversions.
///
/// # Errors
/// When a program fails.
pub fn measure(runner: &Runner, dropping: &Path, offline: &Path) -> Result<Vec<Replayed>> {
    let mut replayed = Vec::new();
    let folder = runner.work.join(name(dropping));
    let (first, recording) = (folder.join("dropping"), folder.join("dropping.mcap"));
    Task { record: Some(&recording), ..Task::new(dropping, &first, Pace::Camera) }.run(runner)?;
    replayed.push(again(runner, "in real time, recorded", &first, &recording, dropping)?);
    let (first, recording) = latency::offline(&runner.work, &name(dropping));
    replayed.push(again(runner, "all frames, recorded", &first, &recording, dropping)?);
    let (first, recording) = latency::offline(&runner.work, &name(offline));
    replayed.push(again(runner, "all frames, recorded", &first, &recording, offline)?);
    let place = runner.work.join(name(offline)).join("converted");
    let chains: [(&str, &[&str]); 2] =
        [("folder → MCAP → folder", &["a.mcap", "b"]), ("folder → ROS 1 bag", &["c.bag"])];
    for (what, chain) in chains {
        let converted = convert(runner, offline, &place, chain)?;
        replayed.push(again(runner, what, &first, &converted, offline)?);
    }
    Ok(replayed)
}

fn name(sequence: &Path) -> String {
    sequence.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Converts a sequence into one form after the other; returns the last.
fn convert(runner: &Runner, sequence: &Path, place: &Path, chain: &[&str]) -> Result<PathBuf> {
    std::fs::create_dir_all(place)?;
    let mut source = sequence.to_owned();
    for form in chain {
        let made = place.join(form);
        let mut command = Command::new(&runner.loopbox);
        finish(command.arg("convert").arg(&source).arg(&made).args(["--force", "--quiet"]))?;
        source = made;
    }
    Ok(source)
}

/// Runs over `recording` and compares with the results of the run in `first`.
fn again(runner: &Runner, how: &str, first: &Path, recording: &Path, sequence: &Path) -> Result<Replayed> {
    let what = format!("`{}`: {how}", name(sequence));
    let out = runner.work.join("replay");
    Task::new(recording, &out, Pace::Every).run(runner)?;
    let before = Run::read(first, Value::Null)?;
    let same = |name: &str| -> Result<bool> { Ok(read(&first.join(name))? == read(&out.join(name))?) };
    let replayed = Replayed {
        what,
        processed: before.record("/frames/processed"),
        dropped: before.record("/frames/dropped_late"),
        trajectory: same("trajectory.txt")?,
        cloud: same("cloud.ply")?,
        map: without_origin(&first.join("map.mcap"))? == without_origin(&out.join("map.mcap"))?,
    };
    let word = if replayed.is_same() { "the same" } else { "NOT the same" };
    eprintln!("  {}: {word}", replayed.what);
    Ok(replayed)
}

/// A map without what it says of where it comes from: folder and recording have other names.
fn without_origin(path: &Path) -> Result<Map> {
    let mut map = load_map(path)?.map;
    for agent in map.agents.values_mut() {
        agent.name.clear();
        agent.provenance.clear();
    }
    Ok(map)
}
