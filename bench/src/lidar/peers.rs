//! Other odometries on the same scans, in the same measurement: the script `lidar-peers` runs those that are installed.

use super::truth::{Errors, Truth};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What a peer came to.
pub struct Peer {
    /// Its name.
    pub name: String,
    /// Its errors.
    pub errors: Errors,
    /// CPU time of a scan, median, milliseconds.
    pub cpu_ms: f64,
}

/// Runs the peers.
pub struct Peers {
    python: String,
    script: PathBuf,
}

impl Peers {
    /// Those that the Python of `LOOPBOX_PYTHON`, by default `python3`, has installed; otherwise why there are none.
    pub fn installed() -> std::result::Result<Self, String> {
        let python = std::env::var("LOOPBOX_PYTHON").unwrap_or_else(|_| "python3".into());
        let script = PathBuf::from("script/lidar-peers");
        let checked = Command::new(&python).arg(&script).arg("check").output();
        match checked {
            Ok(output) if output.status.success() => Ok(Self { python, script }),
            Ok(output) => Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()),
            Err(error) => Err(format!("{python}: {error}")),
        }
    }

    /// Runs all over a folder of scans; their trajectories go into `out`, and what they said. With `reuse` what lies there
    /// from an earlier measurement is taken.
    pub fn measure(&self, folder: &Path, truth: &Truth, out: &Path, reuse: bool) -> Result<Vec<Peer>> {
        let reply = out.join("peers.jsonl");
        if !(reuse && reply.is_file()) {
            let output = Command::new(&self.python).arg(&self.script).arg(folder).arg(out).output()?;
            if !output.status.success() {
                bail!("{}: {}", self.script.display(), String::from_utf8_lossy(&output.stderr));
            }
            std::fs::write(&reply, output.stdout)
                .with_context(|| format!("{}: cannot be written", reply.display()))?;
        }
        let text = std::fs::read_to_string(&reply).with_context(|| reply.display().to_string())?;
        text.lines().map(|line| peer(line, truth)).collect()
    }
}

fn peer(line: &str, truth: &Truth) -> Result<Peer> {
    let reply: Value = serde_json::from_str(line).with_context(|| format!("lidar-peers prints `{line}`"))?;
    let word = |key: &str| reply[key].as_str().with_context(|| format!("lidar-peers prints no {key}"));
    Ok(Peer {
        name: word("method")?.to_owned(),
        errors: truth.errors(Path::new(word("trajectory")?))?,
        cpu_ms: reply["cpu_ms"].as_f64().context("lidar-peers prints no time")?,
    })
}
