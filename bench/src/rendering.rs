//! Recordings that are rendered and mapped by the program, and what came of them.

use crate::measure::{Runner, finish, make_empty};
use anyhow::{Context, Result};
use eval::{Trajectory, read_trajectory};
use loopbox_tests::{Encoding, Recording, Shot};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Writes a recording into a folder within `home`, maps it, and removes it again; the folder of the results, which is `home`'s `out`.
///
/// # Errors
/// When files cannot be written, or the program fails.
pub fn run(runner: &Runner, recording: &Recording, home: &Path) -> Result<PathBuf> {
    let (source, out) = (home.join("recording"), home.join("out"));
    make_empty(&out)?;
    let written = recording.write(&source, Encoding::Jpeg);
    written.with_context(|| format!("{}: cannot be written", source.display()))?;
    finish(Command::new(&runner.loopbox).arg("run").arg(&source).arg("--out").arg(&out).arg("--quiet"))?;
    std::fs::remove_dir_all(&source).with_context(|| format!("{}", source.display()))?;
    Ok(out)
}

/// The trajectories of a run's fragments.
///
/// # Errors
/// When one cannot be read.
pub fn trajectories(out: &Path) -> Result<Vec<Trajectory>> {
    let names =
        std::iter::once("trajectory.txt".to_owned()).chain((2..).map(|i| format!("trajectory-{i}.txt")));
    let files = names.map(|name| out.join(name)).take_while(|path| path.is_file());
    files.map(|path| Ok(read_trajectory(&path)?)).collect()
}

/// Index of the frame nearest in time.
pub fn nearest(shots: &[Shot], time: f64) -> Option<usize> {
    let off = |i: &usize| (shots[*i].timestamp - time).abs();
    (0..shots.len()).min_by(|a, b| off(a).total_cmp(&off(b)))
}
