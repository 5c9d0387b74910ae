//! The folder a run writes into.

use super::record::{RunRecord, numbered};
use crate::results::{Owner, Results};
use anyhow::{Context, Result};
use map::{AgentInfo, Identity, Keyframe, KeyframeId, Map, MapWriter};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
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

pub const MAP: &str = "map.mcap";
pub const TRAJECTORY: &str = "trajectory.txt";
const CLOUD: &str = "cloud.ply";
const REPORT: &str = "report.html";
const NUMBERS: &str = "run.json";

/// A killed run loses no more than what it added in this time.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);

/// A keyframe whose unit has changed by this share since it was written is written again: less than the depths'
/// own deviation, which is 2 % and more.
const UNIT_CHANGE: f32 = 0.01;

/// What is known of a keyframe's features so far.
pub type KnownFeatures<'a> = &'a dyn Fn(&Keyframe) -> Option<Arc<[u8]>>;

/// The folder of a run's results.
pub struct Output {
    results: Results,
    /// Whose map it is.
    agent: AgentInfo,
    /// The fragment of the run that is written on.
    fragment: usize,
    /// There is a map file as soon as there is a map.
    writer: Option<MapWriter>,
    /// The growing maps of the fragments after the first.
    beside: BTreeSet<PathBuf>,
    last_keyframe: Option<KeyframeId>,
    /// Keyframes whose depth has come since they were written.
    settled: BTreeSet<KeyframeId>,
    /// A sample of each keyframe's inverse depths as written, which tells changes of its unit.
    written: BTreeMap<KeyframeId, f32>,
    /// Keyframes whose features were written.
    described: BTreeSet<KeyframeId>,
    flushed: Instant,
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
        let (fragment, writer, beside, last_keyframe) = Default::default();
        let (settled, written, described, others) = Default::default();
        let flushed = Instant::now();
        Ok(Self {
            results,
            agent,
            fragment,
            writer,
            beside,
            last_keyframe,
            settled,
            written,
            described,
            flushed,
            others,
        })
    }

    /// A file of its own that is to be among the results.
    pub fn add(&mut self, name: &str, text: String) {
        self.others.push((name.to_owned(), text));
    }

    /// Says who the agent is, in the epoch of its first fragment; maps that are begun afterwards are its.
    pub fn identify(&mut self, identity: Option<Identity>) {
        self.agent.identity = identity;
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.results.folder()
    }

    /// Writes what the map of a fragment gained, so that a killed run leaves it: call it after each frame, with the
    /// keyframes whose depth has come, and with what is known of a keyframe's features.
    ///
    /// # Errors
    /// When the map file cannot be written; what was written before still loads.
    pub fn grow(
        &mut self,
        fragment: usize,
        map: &Map,
        settled: &[KeyframeId],
        features: KnownFeatures,
    ) -> Result<()> {
        if fragment != self.fragment {
            self.forget_written();
            self.fragment = fragment;
        }
        self.settled.extend(settled);
        let newest = map.keyframes.keys().next_back().copied();
        if newest.is_none() || (newest == self.last_keyframe && self.flushed.elapsed() < FLUSH_INTERVAL) {
            return Ok(());
        }
        self.save(map, features)
    }

    /// Writes what the map gained now, whenever that was done last.
    ///
    /// # Errors
    /// When the map file cannot be written; what was written before still loads.
    pub fn save(&mut self, map: &Map, features: KnownFeatures) -> Result<()> {
        let newest = map.keyframes.keys().next_back().copied();
        if newest.is_none() {
            return Ok(());
        }
        let hint = "hint: what was written before is whole: `loopbox export --mcap` mends the file";
        self.append(map, features)
            .with_context(|| format!("the run was ended, its map could not be written on\n{hint}"))?;
        self.last_keyframe = newest;
        self.flushed = Instant::now();
        Ok(())
    }

    fn append(&mut self, map: &Map, features: KnownFeatures) -> Result<()> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            none => {
                let mut path = self.results.growing()?.to_owned();
                if self.fragment > 0 {
                    path.set_file_name(numbered(MAP, self.fragment));
                    self.beside.insert(path.clone());
                }
                let epoch = |first: Identity| first.later(self.fragment as u32);
                let identity = self.agent.identity.map(epoch);
                none.insert(MapWriter::create(path, &AgentInfo { identity, ..self.agent.clone() })?)
            }
        };
        self.written.retain(|id, _| map.keyframes.contains_key(id));
        self.described.retain(|id| map.keyframes.contains_key(id));
        for (id, keyframe) in &map.keyframes {
            let sample = keyframe.semi_dense.inverse_depth.first().copied().unwrap_or(0.0);
            let is_told = |written: &f32| (sample - written).abs() <= UNIT_CHANGE * written.abs();
            if self.settled.remove(id) || !self.written.get(id).is_some_and(is_told) {
                writer.append_keyframe(keyframe)?;
                self.written.insert(*id, sample);
            }
            if !self.described.contains(id)
                && let Some(features) = features(keyframe)
            {
                writer.append_features(keyframe, &features)?;
                self.described.insert(*id);
            }
        }
        writer.append_poses(map)?;
        Ok(writer.flush()?)
    }

    /// Writes all results of a run that made maps, in the place of earlier ones: a map, a trajectory and a cloud of each
    /// fragment, and a report of the first.
    ///
    /// # Errors
    /// Names the file that could not be written.
    pub fn finish(
        &mut self,
        fragments: &[Map],
        record: &mut RunRecord,
        format: TrajectoryFormat,
        max_variance: f32,
    ) -> Result<()> {
        self.writer = None;
        for (place, map) in fragments.iter().enumerate() {
            map::save_map(self.results.file(numbered(MAP, place))?, map)?;
            let (trajectory, path) = (map.trajectory(), self.results.file(numbered(TRAJECTORY, place))?);
            match format {
                TrajectoryFormat::Tum => map::save_tum(path, &trajectory)?,
                TrajectoryFormat::Kitti => map::save_kitti(path, &trajectory)?,
            }
            map::save_ply(self.results.file(numbered(CLOUD, place))?, map, max_variance)?;
        }
        let Some(map) = fragments.first() else { return Ok(()) };
        let rows: Vec<report::FrameRow> = record.rows.iter().map(|row| row.for_report()).collect();
        let input =
            ReportInput { title: &record.source.path, map, rows: &rows, numbers: &record.headline_numbers() };
        report::write(&self.results.file(REPORT)?, &input)?;
        for (name, text) in &self.others {
            let path = self.results.file(name)?;
            std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display()))?;
        }
        let path = self.results.file(NUMBERS)?;
        record.files = self.results.names();
        write_numbers(&path, record)?;
        let complete: Vec<PathBuf> = record.files.iter().map(|name| self.folder().join(name)).collect();
        self.results.commit()?;
        self.remove_beside(&complete);
        Ok(())
    }

    /// Forgets what was written of a map that is not written on.
    fn forget_written(&mut self) {
        self.writer = None;
        self.last_keyframe = None;
        self.settled.clear();
        self.written.clear();
        self.described.clear();
    }

    /// Removes the growing maps of fragments that have their place in the results now, but for those `complete`.
    fn remove_beside(&mut self, complete: &[PathBuf]) {
        for path in std::mem::take(&mut self.beside).into_iter().filter(|path| !complete.contains(path)) {
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
        self.forget_written();
        self.remove_beside(&[]);
        self.results.forget_growing();
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
    use geometry::{GrayImage, Pinhole, Sim3};
    use map::{AgentId, Keyframe, SemiDense};
    use std::sync::Arc;

    fn keyframe(id: u32) -> Keyframe {
        Keyframe {
            id: KeyframeId(id),
            agent: AgentId::default(),
            timestamp: f64::from(id),
            frame_index: u64::from(id),
            world_from_keyframe: Sim3::identity(),
            image: Arc::new(GrayImage::filled(8, 6, 90)),
            scan: None,
            semi_dense: SemiDense::default().into(),
            points: Vec::new(),
            features: None,
        }
    }

    fn written(output: &Output) -> u64 {
        std::fs::metadata(output.folder().join(MAP)).map_or(0, |about| about.len())
    }

    fn depth_in_file(output: &Output, id: u32) -> Vec<f32> {
        let map = map::load_map(output.folder().join(MAP)).expect("it loads").map;
        map.keyframes[&KeyframeId(id)].semi_dense.inverse_depth.clone()
    }

    #[test]
    fn the_growing_map_gets_what_is_new_and_nothing_else() {
        let room = tempfile::tempdir().expect("a folder");
        let camera = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
        let agent = AgentInfo::new("one", camera);
        let mut map = Map::of(agent.clone());
        let mut output =
            Output::create(room.path(), agent, Path::new("video.mp4"), false).expect("it is free");
        map.keyframes.extend([0, 1].map(|id| (KeyframeId(id), keyframe(id))));
        output.save(&map, &|_| None).expect("there is room");
        let size = written(&output);
        assert!(size > 0);
        for _ in 0..3 {
            output.save(&map, &|_| None).expect("there is room");
        }
        assert_eq!(written(&output), size, "a camera that stands still writes nothing");
        let depth = SemiDense { pixel: vec![7], inverse_depth: vec![0.5], variance: vec![0.01] };
        map.keyframes.entry(KeyframeId(0)).and_modify(|keyframe| keyframe.semi_dense = depth.into());
        map.keyframes.insert(KeyframeId(2), keyframe(2));
        output.grow(0, &map, &[KeyframeId(0)], &|_| None).expect("there is room");
        assert_eq!(depth_in_file(&output, 0), [0.5]);
        // Another unit: poses of the graph are in it at once, and so must depths be.
        map.keyframes.entry(KeyframeId(0)).and_modify(|keyframe| keyframe.semi_dense.inverse_depth[0] = 0.25);
        output.save(&map, &|_| None).expect("there is room");
        assert_eq!(depth_in_file(&output, 0), [0.25]);
    }
}
