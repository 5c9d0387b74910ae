//! The maps that are merged, and what is known of their recordings.

use crate::measure::finish;
use anyhow::{Context, Result};
use eval::{DEFAULT_MAX_DIFF, Trajectory, read_times, read_trajectory};
use map::{Map, load_map};
use measuring::map_of;
use measuring::views::{View, metres_per_unit, views};
use nalgebra::Vector3;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A sequence, or a part of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recording<'a> {
    /// Name of the sequence.
    pub sequence: &'a str,
    /// Seconds left out at the beginning.
    pub start: Option<f64>,
    /// Where it ends, seconds after the beginning of the sequence.
    pub end: Option<f64>,
}

impl<'a> Recording<'a> {
    /// A whole sequence.
    pub const fn whole(sequence: &'a str) -> Self {
        Self { sequence, start: None, end: None }
    }

    /// A sequence without its first seconds.
    pub const fn from(sequence: &'a str, start: f64) -> Self {
        Self { sequence, start: Some(start), end: None }
    }

    /// The first seconds of a sequence.
    pub const fn to(sequence: &'a str, end: f64) -> Self {
        Self { sequence, start: None, end: Some(end) }
    }

    /// Whether nothing is left out.
    pub fn is_whole(&self) -> bool {
        self.start.is_none() && self.end.is_none()
    }

    /// The file of its map in the folder of all runs.
    pub fn map(&self, work: &Path) -> PathBuf {
        if self.is_whole() {
            return map_of(work, self.sequence);
        }
        let part =
            |name: &str, seconds: Option<f64>| seconds.map_or(String::new(), |s| format!("-{name}-{s}"));
        let name = format!("{}{}{}", self.sequence, part("from", self.start), part("to", self.end));
        work.join("parts").join(name).join("map.mcap")
    }

    /// Makes its map by a run with default parameters.
    ///
    /// # Errors
    /// When the run fails.
    pub fn run(&self, loopbox: &Path, data: &Path, work: &Path) -> Result<()> {
        let (sequence, map) = (data.join(self.sequence), self.map(work));
        let mut command = Command::new(loopbox);
        command.arg("run").arg(&sequence).arg("--calib").arg(sequence.join("camera.yaml"));
        for (option, seconds) in [("--start", self.start), ("--end", self.end)] {
            if let Some(seconds) = seconds {
                command.arg(option).arg(seconds.to_string());
            }
        }
        command.arg("--out").arg(map.parent().unwrap_or(work)).arg("--quiet");
        finish(&mut command).with_context(|| self.to_string()).map(drop)
    }

    /// The true positions of its frames, metres.
    ///
    /// # Errors
    /// When the sequence's files cannot be read.
    pub fn true_path(&self, data: &Path) -> Result<Vec<Vector3<f64>>> {
        let folder = data.join(self.sequence);
        let truth = read_trajectory(&folder.join("groundtruth.txt"))?;
        let times = read_times(&folder.join("times.txt"))?;
        let first = times.first().copied().unwrap_or(0.0);
        let (start, end) = (self.start.unwrap_or(0.0), self.end.unwrap_or(f64::INFINITY));
        let within = times.iter().filter(|time| (start..=end).contains(&(*time - first)));
        let position = |time: &f64| truth.pose_at(*time, DEFAULT_MAX_DIFF).map(|pose| pose.translation);
        Ok(within.filter_map(position).collect())
    }
}

impl fmt::Display for Recording<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "`{}`", self.sequence)?;
        self.start.map_or(Ok(()), |start| write!(f, " from {start} s"))?;
        self.end.map_or(Ok(()), |end| write!(f, " to {end} s"))
    }
}

/// The map of a sequence with what the true poses say of it.
pub struct MapWithTruth {
    /// Name of the sequence.
    pub sequence: String,
    /// The map.
    pub map: Map,
    /// True poses, metres.
    pub truth: Trajectory,
    /// Metres per unit of the map's world.
    pub metres: f64,
    /// What its keyframes see.
    pub views: Vec<View>,
}

impl MapWithTruth {
    /// Reads the map in the file `path` of a sequence.
    ///
    /// # Errors
    /// When a file cannot be read, or the map has no scale.
    pub fn read(sequence: &str, path: &Path, data: &Path) -> Result<Self> {
        let map = load_map(path)?.map;
        let truth = read_trajectory(&data.join(sequence).join("groundtruth.txt"))?;
        let metres =
            metres_per_unit(&map, &truth).with_context(|| format!("{sequence}: the map has no scale"))?;
        let views = views(&map, &truth, metres);
        Ok(Self { sequence: sequence.to_owned(), map, truth, metres, views })
    }

    /// The true positions of a map's frames, metres.
    pub fn true_path(&self, part: &Map) -> Vec<Vector3<f64>> {
        let position = |frame: &map::FramePose| self.truth.pose_at(frame.timestamp, DEFAULT_MAX_DIFF);
        part.frames.iter().filter_map(position).map(|pose| pose.translation).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_has_a_folder_and_a_name_of_its_own() {
        let parts = [
            Recording::whole("a"),
            Recording::from("a", 5.6),
            Recording::to("a", 5.6),
            Recording { start: Some(1.0), ..Recording::to("a", 5.6) },
        ];
        let files = parts.map(|part| part.map(Path::new("w")).display().to_string());
        let expected = ["a/run-1", "parts/a-from-5.6", "parts/a-to-5.6", "parts/a-from-1-to-5.6"];
        assert_eq!(files, expected.map(|folder| format!("w/{folder}/map.mcap")));
        assert_eq!(parts[3].to_string(), "`a` from 1 s to 5.6 s");
    }

    #[test]
    fn the_true_path_is_that_of_the_part() {
        let data = tempfile::tempdir().unwrap();
        let folder = data.path().join("a");
        std::fs::create_dir(&folder).unwrap();
        let lines = |line: fn(u32) -> String| (0..10).map(line).collect::<String>();
        std::fs::write(folder.join("times.txt"), lines(|i| format!("{} {i}.jpg\n", 100 + i))).unwrap();
        std::fs::write(folder.join("groundtruth.txt"), lines(|i| format!("{} {i} 0 0 0 0 0 1\n", 100 + i)))
            .unwrap();
        let x = |part: Recording| -> Vec<f64> {
            part.true_path(data.path()).unwrap().iter().map(|position| position.x).collect()
        };
        assert_eq!(x(Recording::from("a", 6.5)), [7.0, 8.0, 9.0]);
        assert_eq!(x(Recording::to("a", 1.0)), [0.0, 1.0]);
        assert_eq!(x(Recording::whole("a")).len(), 10);
    }
}
