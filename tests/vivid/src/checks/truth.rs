//! How near a run's trajectory is to the truth of what was played.

use anyhow::{Context, Result, ensure};
use eval::read_trajectory;
use std::fs;
use std::path::Path;

/// Writes the truth of the pictures that were shown while the frames of a trajectory were taken, with the times of
/// these frames, in TUM form.
///
/// `played` is when each picture was played; `truth` holds a pose for each picture.
///
/// # Errors
/// When a file cannot be read or written.
pub fn write(trajectory: &Path, truth: &Path, played: &[f64], out: &Path) -> Result<()> {
    let rows: Vec<Vec<String>> = rows(truth)?;
    let mut text = String::new();
    for row in self::rows(trajectory)? {
        let time: f64 = row[0].parse().context("a time")?;
        // A picture is on the way for one frame of the output.
        let picture = played.partition_point(|&start| start + 1.0 / 60.0 < time).saturating_sub(1);
        let pose = rows.get(picture).with_context(|| format!("no true pose for picture {picture}"))?;
        text += &format!("{} {}\n", row[0], pose[1..].join(" "));
    }
    ensure!(!text.is_empty(), "{}: no poses", trajectory.display());
    fs::write(out, text)?;
    read_trajectory(out)?;
    Ok(())
}

fn rows(path: &Path) -> Result<Vec<Vec<String>>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty());
    Ok(lines.map(|line| line.split_whitespace().map(str::to_owned).collect()).collect())
}
