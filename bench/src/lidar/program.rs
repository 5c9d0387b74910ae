//! The program under measurement, and where its results go.

use crate::measure::output;
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Exit code of a merge in which no two maps met.
const NOTHING_MET: i32 = 3;

/// The program.
pub struct Program<'a> {
    /// Its file.
    pub loopbox: &'a Path,
    /// Folder for results.
    pub work: &'a Path,
    /// Whether maps that lie there from an earlier measurement are taken in place of new ones.
    pub reuse: bool,
}

impl Program<'_> {
    /// What it prints, and whether it did what was asked: a merge that finds nothing does not.
    ///
    /// # Errors
    /// When it fails.
    pub fn call(&self, args: &[&str]) -> Result<(bool, String)> {
        let output = output(Command::new(self.loopbox).args(args))?;
        let code = output.status.code().unwrap_or(-1);
        if code != 0 && code != NOTHING_MET {
            bail!("loopbox {}: {}", args.join(" "), String::from_utf8_lossy(&output.stderr));
        }
        Ok((code == 0, String::from_utf8_lossy(&output.stdout).into_owned()))
    }

    /// As [`call`](Self::call), of what it prints as JSON.
    pub fn json(&self, args: &[&str]) -> Result<(bool, Value)> {
        let (done, saved) = self.call(args)?;
        let value = serde_json::from_str(&saved);
        Ok((done, value.with_context(|| format!("loopbox {} prints no JSON", args.join(" ")))?))
    }

    /// The folder of a result.
    pub fn at(&self, name: &str) -> PathBuf {
        self.work.join("lidar").join(name.replace('/', "-"))
    }

    /// Maps a recording with one thread, so that a scan's time is the thread's; returns the folder of the results.
    pub fn run(&self, source: &Path, name: &str, how: &[&str]) -> Result<PathBuf> {
        let out = self.at(name);
        if !(self.reuse && out.join("run.json").is_file()) {
            let (source, folder) = (source.display().to_string(), out.display().to_string());
            let mut args = vec!["run", &source, "--out", &folder, "--force", "--quiet", "--threads", "1"];
            args.extend(how);
            self.call(&args)?;
        }
        Ok(out)
    }
}

/// A file of results as JSON.
pub fn record(path: &Path) -> Result<Value> {
    let text = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    serde_json::from_slice(&text).with_context(|| format!("{}: is no JSON", path.display()))
}
