//! The folder a run writes into.

use crate::record::RunRecord;
use crate::report::{self, ReportInput};
use anyhow::{Context, Result};
use clap::ValueEnum;
use map::{AgentId, AgentInfo, KeyframeId, Map, MapWriter};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Forms of a trajectory file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TrajectoryFormat {
    /// A line `t tx ty tz qx qy qz qw` for each frame
    Tum,
    /// The upper 3×4 of world_from_camera for each frame, row by row
    Kitti,
}

const MAP: &str = "map.mcap";
const TRAJECTORY: &str = "trajectory.txt";
const CLOUD: &str = "cloud.ply";
const REPORT: &str = "report.html";
const NUMBERS: &str = "run.json";

/// A killed run loses no more than what it added in this time.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);

/// The folder of a run's results.
pub struct Output {
    folder: PathBuf,
    /// Whose map it is.
    agent: AgentInfo,
    /// There is a map file as soon as there is a map.
    writer: Option<MapWriter>,
    last_keyframe: Option<KeyframeId>,
    flushed: Instant,
}

impl Output {
    /// Makes the folder, makes sure before the run that it can be written to, and removes the results
    /// of an earlier run: results of two runs must not lie side by side.
    ///
    /// # Errors
    /// When the folder cannot be made or written to.
    pub fn create(folder: &Path, agent: AgentInfo) -> Result<Self> {
        let hint = "hint: --out must name a folder that can be made and written to";
        std::fs::create_dir_all(folder)
            .with_context(|| format!("{}: the folder cannot be made\n{hint}", folder.display()))?;
        let probe = folder.join(format!("{NUMBERS}.tmp"));
        std::fs::write(&probe, b"probe")
            .and_then(|()| std::fs::remove_file(&probe))
            .with_context(|| format!("{}: the folder cannot be written to\n{hint}", folder.display()))?;
        for name in [MAP, TRAJECTORY, CLOUD, REPORT, NUMBERS] {
            let path = folder.join(name);
            if path.is_file() {
                std::fs::remove_file(&path)
                    .with_context(|| format!("{}: the earlier result cannot be replaced", path.display()))?;
            }
        }
        let (writer, last_keyframe) = (None, None);
        Ok(Self { folder: folder.to_owned(), agent, writer, last_keyframe, flushed: Instant::now() })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes what the map gained, so that a killed run leaves it: call it after each frame.
    ///
    /// # Errors
    /// When the map file cannot be written; what was written before still loads.
    pub fn grow(&mut self, map: &Map) -> Result<()> {
        let newest = map.keyframes.keys().next_back().copied();
        if newest.is_none() || (newest == self.last_keyframe && self.flushed.elapsed() < FLUSH_INTERVAL) {
            return Ok(());
        }
        self.save(map)
    }

    /// Writes what the map gained now, whenever that was done last.
    ///
    /// # Errors
    /// When the map file cannot be written; what was written before still loads.
    pub fn save(&mut self, map: &Map) -> Result<()> {
        let newest = map.keyframes.keys().next_back().copied();
        if newest.is_none() {
            return Ok(());
        }
        let hint = "hint: what was written before is whole: `loopbox export --mcap` mends the file";
        self.append(map)
            .with_context(|| format!("the run was ended, its map could not be written on\n{hint}"))?;
        self.last_keyframe = newest;
        self.flushed = Instant::now();
        Ok(())
    }

    fn append(&mut self, map: &Map) -> Result<()> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            none => none.insert(MapWriter::create(self.folder.join(MAP), &self.agent)?),
        };
        // The last one written was new then; its depth has ripened since.
        let since = self.last_keyframe.unwrap_or(KeyframeId(0));
        for keyframe in map.keyframes.range(since..).map(|(_, keyframe)| keyframe) {
            writer.append_keyframe(keyframe)?;
        }
        writer.append_poses(map)?;
        Ok(writer.flush()?)
    }

    /// Writes all results of a run that made a map.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn finish(
        &mut self,
        map: &mut Map,
        record: &RunRecord,
        format: TrajectoryFormat,
        max_variance: f32,
    ) -> Result<()> {
        map.agents.insert(AgentId::default(), self.agent.clone());
        self.writer = None;
        map::save_map(self.folder.join(MAP), map)?;
        let (trajectory, path) = (map.trajectory(), self.folder.join(TRAJECTORY));
        match format {
            TrajectoryFormat::Tum => map::save_tum(path, &trajectory)?,
            TrajectoryFormat::Kitti => map::save_kitti(path, &trajectory)?,
        }
        map::save_ply(self.folder.join(CLOUD), map, max_variance)?;
        let rows: Vec<report::FrameRow> = record.rows.iter().map(|row| row.for_report()).collect();
        let input =
            ReportInput { title: &record.source.path, map, rows: &rows, numbers: &record.headline_numbers() };
        report::write(&self.folder.join(REPORT), &input)?;
        self.numbers(record)
    }

    /// Writes the numbers alone, of a run without a map.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn numbers(&self, record: &RunRecord) -> Result<()> {
        let (path, partial) = (self.folder.join(NUMBERS), self.folder.join(format!("{NUMBERS}.tmp")));
        let write = || -> Result<()> {
            let mut out = BufWriter::new(File::create(&partial)?);
            serde_json::to_writer_pretty(&mut out, record)?;
            out.flush()?;
            Ok(std::fs::rename(&partial, &path)?)
        };
        write().with_context(|| format!("{}: cannot be written", path.display()))
    }
}
