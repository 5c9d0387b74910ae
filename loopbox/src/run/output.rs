//! The folder a run writes into.

use super::live_map::LiveMapWriter;
use super::record::{RunRecord, handed_out};
use crate::results::file_names::{LIVE_TRAJECTORY, MAP, TRAJECTORY, numbered};
use crate::results::{Owner, Results};
use anyhow::{Context, Result};
use map::{AgentInfo, CloudSelection, Identity, Map, MapDelta, StampedPose};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use view::report::{self, ReportInput};

/// Forms of a trajectory file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum TrajectoryFormat {
    /// A line `t tx ty tz qx qy qz qw` for each frame
    Tum,
    /// The upper 3×4 of world_from_camera for each frame, row by row
    Kitti,
}

const CLOUD: &str = "cloud.ply";
pub(super) const REPORT: &str = "report.html";
const NUMBERS: &str = "run.json";

/// The folder of a run's results.
pub struct Output {
    results: Results,
    /// Whose map it is.
    agent: AgentInfo,
    live_writer: LiveMapWriter,
    /// The growing maps of the fragments after the first.
    fragment_files: BTreeSet<PathBuf>,
    /// Other files of the results, by name, with their text.
    others: Vec<(String, String)>,
}

impl Output {
    /// Makes the folder and makes sure before the run that it can be written to. The results of an earlier run stay
    /// until those of this one are complete; `force` lets them replace those of something else.
    ///
    /// # Errors
    /// When the folder cannot be made or written to, another program writes there, or it holds results of something
    /// else.
    pub fn create(folder: &Path, agent: AgentInfo, source: &Path, force: bool) -> Result<Self> {
        let results = Results::create(folder, &Owner::Run(source.to_owned()), force)?;
        let (live_writer, fragment_files, others) = Default::default();
        Ok(Self { results, agent, live_writer, fragment_files, others })
    }

    /// Says whether a full disk is waited out: what the map has grown by waits in memory until there is room; else it ends
    /// the run.
    pub fn wait_for_room(&mut self, waits: bool) {
        self.live_writer.wait_for_room(waits);
    }

    /// Whether something waits in memory for room on the disk.
    pub fn waits_for_room(&self) -> bool {
        self.live_writer.waits_for_room()
    }

    /// A file of its own that is to be among the results.
    pub fn add(&mut self, name: &str, text: String) {
        self.others.push((name.to_owned(), text));
    }

    /// Says who makes the maps that are begun afterwards.
    pub fn identify(&mut self, identity: Option<Identity>) {
        self.agent.identity = identity;
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.results.folder()
    }

    /// Writes what was said of the map of a fragment and its new frames, so that a killed run leaves it: call it after
    /// each frame with all that was said since the last one.
    ///
    /// # Errors
    /// When a map file could not be written, now or before; what was written before still loads.
    pub fn grow(&mut self, fragment: usize, map: &Map, deltas: Vec<MapDelta>) -> Result<()> {
        let Self { results, agent, live_writer, fragment_files, .. } = self;
        let file = || {
            let mut path = results.live_map()?.to_owned();
            if fragment > 0 {
                path.set_file_name(numbered(MAP, fragment));
                fragment_files.insert(path.clone());
            }
            Ok((path, agent.clone()))
        };
        live_writer.grow(fragment, map, deltas, file)
    }

    /// Waits until all that was said is in the files.
    ///
    /// # Errors
    /// When a map file could not be written; what was written before still loads.
    pub fn flush(&mut self) -> Result<()> {
        self.live_writer.flush()
    }

    /// Leaves the growing maps as the results: soon, however large they are.
    ///
    /// # Errors
    /// When a map file could not be written; what was written before still loads.
    pub fn leave(&mut self) -> Result<()> {
        self.live_writer.end()?;
        self.results.keep_live_map();
        Ok(())
    }

    /// Writes all results of a run that made maps, in the place of earlier ones: a map, its trajectory and a cloud of each
    /// fragment, and a report of the first.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn finish(
        &mut self,
        fragments: &[Map],
        trajectories: &[Vec<StampedPose>],
        record: &mut RunRecord,
        format: TrajectoryFormat,
        max_variance: f32,
    ) -> Result<()> {
        // What could not be written then is written whole now, or said.
        let _ = self.live_writer.end();
        for (place, (map, trajectory)) in fragments.iter().zip(trajectories).enumerate() {
            map::save_map(self.results.file(numbered(MAP, place))?, map)?;
            self.save_trajectory(numbered(TRAJECTORY, place), trajectory, format)?;
            let cloud = self.results.file(numbered(CLOUD, place))?;
            map::save_ply(cloud, map, CloudSelection::of_results(max_variance))?;
        }
        let Some(map) = fragments.first() else { return Ok(()) };
        self.save_trajectory(LIVE_TRAJECTORY.to_owned(), &handed_out(&record.rows), format)?;
        let rows: Vec<report::FrameRow> = record.rows.iter().map(|row| row.for_report()).collect();
        let input =
            ReportInput { title: &record.source.path, map, rows: &rows, numbers: &record.headline_numbers() };
        report::write(&self.results.file(REPORT)?, &input)?;
        self.complete(record)
    }

    /// Writes the results of a run that is to end soon: its only map as it has grown, the trajectory and the numbers.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn finish_grown(
        &mut self,
        map: &Map,
        record: &mut RunRecord,
        format: TrajectoryFormat,
    ) -> Result<()> {
        self.live_writer.end()?;
        let (grown, file) = (self.results.live_map()?.to_owned(), self.results.file(MAP)?);
        std::fs::rename(&grown, &file).with_context(|| format!("{}: cannot be moved", grown.display()))?;
        self.save_trajectory(TRAJECTORY.to_owned(), &map.trajectory(), format)?;
        self.save_trajectory(LIVE_TRAJECTORY.to_owned(), &handed_out(&record.rows), format)?;
        self.complete(record)
    }

    /// Writes the results of a run that told poses in a map of an earlier one: the frames of `map`, and the numbers.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn finish_localised(
        &mut self,
        map: &Map,
        record: &mut RunRecord,
        format: TrajectoryFormat,
    ) -> Result<()> {
        self.save_trajectory(TRAJECTORY.to_owned(), &map.trajectory(), format)?;
        self.complete(record)
    }

    fn save_trajectory(
        &mut self,
        name: String,
        trajectory: &[StampedPose],
        format: TrajectoryFormat,
    ) -> Result<()> {
        let path = self.results.file(name)?;
        match format {
            TrajectoryFormat::Tum => map::save_tum(path, trajectory)?,
            TrajectoryFormat::Kitti => map::save_kitti(path, trajectory)?,
        }
        Ok(())
    }

    /// Writes what goes with all results, and puts them in the place of earlier ones.
    fn complete(&mut self, record: &mut RunRecord) -> Result<()> {
        for (name, text) in &self.others {
            let path = self.results.file(name)?;
            std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        let path = self.results.file(NUMBERS)?;
        record.files = self.results.names();
        write_numbers(&path, record)?;
        let complete: Vec<PathBuf> = record.files.iter().map(|name| self.folder().join(name)).collect();
        self.results.commit()?;
        self.remove_fragment_files(&complete);
        Ok(())
    }

    /// Removes the growing maps of fragments that have their place in the results now, but for those `complete`.
    fn remove_fragment_files(&mut self, complete: &[PathBuf]) {
        for path in
            std::mem::take(&mut self.fragment_files).into_iter().filter(|path| !complete.contains(path))
        {
            // Nobody is hurt by what stays.
            let _ = std::fs::remove_file(path);
        }
    }

    /// Ends a run that made no map: its numbers are written, unless earlier results are there, which stay. The next
    /// map may grow here.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn fail(&mut self, record: &RunRecord) -> Result<()> {
        // There is no map that anybody would miss.
        let _ = self.live_writer.end();
        self.remove_fragment_files(&[]);
        self.results.discard_live_map();
        if self.results.holds_earlier(&[NUMBERS]) {
            return Ok(());
        }
        let (path, partial) = (self.folder().join(NUMBERS), self.folder().join(format!("{NUMBERS}.tmp")));
        write_numbers(&partial, record)?;
        std::fs::rename(&partial, &path).with_context(|| format!("{}: cannot be written", path.display()))
    }
}

fn write_numbers(path: &Path, record: &RunRecord) -> Result<()> {
    let write = || -> Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        serde_json::to_writer_pretty(&mut out, record)?;
        out.flush()?;
        Ok(out.get_ref().sync_all()?)
    };
    write().with_context(|| format!("{}: cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::record::{CalibrationRecord, Cost, FrameCounts, MapCounts, SourceRecord};
    use geometry::{GrayImage, Pinhole, Se3, Sim3};
    use map::{FramePose, Keyframe, KeyframeId};
    use slam_direct::Params;
    use std::sync::Arc;

    const CAMERA: Pinhole = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };

    fn record() -> RunRecord {
        let lens = geometry::Camera::new(CAMERA, geometry::Distortion::None);
        RunRecord {
            commit: None,
            version: "1",
            source: SourceRecord {
                path: "monday".into(),
                kind: "folder".into(),
                frames: None,
                duration_s: None,
            },
            camera: CAMERA,
            calibration: CalibrationRecord {
                origin: "a file".into(),
                lens: lens.unwrap(),
                halvings: 0,
                focal_deviation: None,
            },
            shutter: None,
            params: Params::default(),
            left_out: None,
            resumed: None,
            interrupted: true,
            frames: FrameCounts::default(),
            cost: Cost::default(),
            map: MapCounts::default(),
            fragments: Vec::new(),
            revisits: Vec::new(),
            files: Vec::new(),
            rows: Vec::new(),
        }
    }

    #[test]
    fn a_map_left_as_it_has_grown_takes_the_place_of_earlier_results() {
        let room = tempfile::tempdir().expect("a folder");
        let folder = room.path().join("out");
        let about = AgentInfo::new("one", CAMERA);
        for (run, keyframes) in [(0, 1), (1, 3)] {
            let mut output =
                Output::create(&folder, about.clone(), Path::new("monday"), false).expect("room");
            let mut map = Map::of(about.clone());
            for (sequence, id) in (0..keyframes).map(KeyframeId).enumerate() {
                let image = Arc::new(GrayImage::filled(8, 6, 90));
                let (time, index) = (f64::from(id.0), u64::from(id.0));
                let added = vec![Keyframe::of_image(id, time, index, Sim3::identity(), image)];
                let delta = MapDelta { sequence: sequence as u64, added, ..MapDelta::default() };
                map.take_in(delta.clone());
                let keyframe_from_frame = Se3::identity();
                map.frames.push(FramePose {
                    timestamp: time,
                    frame_index: index,
                    reference: id,
                    keyframe_from_frame,
                });
                output.grow(0, &map, vec![delta]).expect("room");
            }
            let mut record = record();
            if run == 0 {
                let maps = [map];
                let trajectories = [maps[0].trajectory()];
                output.finish(&maps, &trajectories, &mut record, TrajectoryFormat::Tum, 0.01).expect("room");
                assert!(folder.join(REPORT).exists());
                continue;
            }
            output.finish_grown(&map, &mut record, TrajectoryFormat::Tum).expect("room");
            assert!(map::load_map(folder.join(MAP)).expect("it loads").map == map);
            let trajectory = std::fs::read_to_string(folder.join(TRAJECTORY)).expect("it is there");
            assert_eq!(trajectory.lines().filter(|line| !line.starts_with('#')).count(), 3);
            let mut names: Vec<String> = std::fs::read_dir(&folder)
                .expect("a folder")
                .map(|entry| entry.expect("a file").file_name().to_string_lossy().into_owned())
                .collect();
            names.sort();
            assert_eq!(
                names,
                [MAP, NUMBERS, LIVE_TRAJECTORY, TRAJECTORY],
                "of the earlier run nothing is left"
            );
        }
    }
}
