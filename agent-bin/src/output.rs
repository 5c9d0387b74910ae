//! The folder a run writes into.

use crate::record::RunRecord;
use anyhow::{Context, Result};
use clap::ValueEnum;
use map::Map;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Forms of a trajectory file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TrajectoryFormat {
    /// `t tx ty tz qx qy qz qw` a line.
    Tum,
    /// The upper 3×4 of world_from_camera a line.
    Kitti,
}

/// The folder of a run's results.
pub struct Output {
    folder: PathBuf,
}

impl Output {
    /// Makes the folder, and makes sure before the run that it can be written to.
    ///
    /// # Errors
    /// When it cannot.
    pub fn create(folder: &Path) -> Result<Self> {
        let hint = "hint: --out names a folder that can be made and written to";
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: the folder cannot be made\n{hint}", folder.display()))?;
        let probe = folder.join(".loopbox-probe");
        std::fs::write(&probe, b"probe")
            .and_then(|()| std::fs::remove_file(&probe))
            .with_context(|| format!("{}: the folder cannot be written to\n{hint}", folder.display()))?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Writes all results.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn write(&self, map: &Map, record: &RunRecord, format: TrajectoryFormat) -> Result<()> {
        self.file("run.json", |out| Ok(serde_json::to_writer_pretty(out, record)?))?;
        self.file("trajectory.txt", |out| {
            for pose in map.trajectory() {
                match format {
                    TrajectoryFormat::Tum => {
                        write!(out, "{}", pose.timestamp)?;
                        for value in pose.world_from_camera.to_tum() {
                            write!(out, " {value}")?;
                        }
                        writeln!(out)?;
                    }
                    TrajectoryFormat::Kitti => {
                        let m = pose.world_from_camera.to_matrix();
                        let row: Vec<String> = (0..3)
                            .flat_map(|r| (0..4).map(move |c| (r, c)))
                            .map(|i| m[i].to_string())
                            .collect();
                        writeln!(out, "{}", row.join(" "))?;
                    }
                }
            }
            Ok(())
        })
    }

    /// Writes a file beside its place and moves it there when whole.
    fn file(
        &self,
        name: &str,
        write: impl FnOnce(&mut BufWriter<std::fs::File>) -> Result<()>,
    ) -> Result<()> {
        let (path, partial) = (self.folder.join(name), self.folder.join(format!("{name}.tmp")));
        let written = std::fs::File::create(&partial).map_err(anyhow::Error::from).and_then(|file| {
            let mut out = BufWriter::new(file);
            write(&mut out)?;
            out.flush()?;
            std::fs::rename(&partial, &path)?;
            Ok(())
        });
        written.with_context(|| format!("{}: cannot be written", path.display()))
    }
}
