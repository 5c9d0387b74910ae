//! Map files: at once at the end of a run, or bit by bit during it.

use super::about::About;
use super::picture;
use super::sink::MapSink;
use crate::{
    AgentId, AgentInfo, Described, FramePose, Keyframe, KeyframeId, Map, MapDelta, MapError, SemiDense,
    Settled, atomic::write_atomically, check,
};
use geometry::Sim3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

/// Keyframes whose images are encoded at once: enough for all cores, and a few megabytes.
const IMAGES_TOGETHER: usize = 16;

/// Writes a complete map file. The file appears when it is complete; on any error, such as a full disk, an earlier
/// file of that name stays as it is. The same map gives the same bytes.
///
/// # Errors
/// [`MapError::Write`] when the system refuses, [`MapError::Invalid`] when the map could not be loaded again, because
/// of a pose that is not finite, for example.
pub fn save_map(path: impl AsRef<Path>, map: &Map) -> Result<(), MapError> {
    let path = path.as_ref();
    check::map(map).map_err(|what| MapError::invalid(path, what))?;
    let written = write_atomically(path, |out| {
        let mut sink = MapSink::create(out, &About::of(map))?;
        // The graph first: a copy of the file that is cut keeps the frames of the keyframes it has.
        sink.graph(map)?;
        sink.flush()?;
        let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
        for together in keyframes.chunks(IMAGES_TOGETHER) {
            // A LiDAR's keyframes have none.
            let png = |keyframe: &&Keyframe| {
                keyframe.scan.is_none().then(|| picture::encode_png(&keyframe.image)).transpose()
            };
            let images: Vec<io::Result<Option<Vec<u8>>>> = together.par_iter().map(png).collect();
            for (keyframe, image) in together.iter().zip(images) {
                let own = map.agents.get(&keyframe.agent).and_then(|info| info.own.as_ref());
                let own_pose = own.and_then(|own| own.world_from_keyframe.get(&keyframe.id));
                match image? {
                    Some(image) => sink.keyframe_with_image(keyframe, image, own_pose)?,
                    None => sink.keyframe(keyframe, own_pose)?,
                }
                keyframe.rest();
                sink.flush()?;
            }
        }
        sink.views(map)?;
        sink.finish()
    });
    written.map_err(|source| MapError::write(path, source))
}

/// Writes the map file of one agent during its run, so that a run that is killed leaves what it had.
///
/// Everything up to the last [`flush`](Self::flush) loads with [`load_map`](crate::load_map); call it
/// after each keyframe. The file grows by what is new. Only [`save_map`] adds what viewers show
/// besides the images; let it replace the file at the end of the run, after this is dropped.
pub struct MapWriter {
    path: PathBuf,
    /// The same file as that of `sink`.
    file: File,
    agent: AgentInfo,
    sink: MapSink<BufWriter<File>>,
    /// The keyframes that [`append`](Self::append) wrote, without depth, points and features.
    known: BTreeMap<KeyframeId, Keyframe>,
}

impl MapWriter {
    /// Begins a file in place of an earlier one.
    ///
    /// # Errors
    /// [`MapError::Write`] when the system refuses, [`MapError::Invalid`] for an unusable camera or name.
    pub fn create(path: impl AsRef<Path>, agent: &AgentInfo) -> Result<Self, MapError> {
        let path = path.as_ref();
        check::agent(agent).map_err(|what| MapError::invalid(path, what))?;
        let about = About::of_agent(agent);
        let begin = |file: File| Ok((file.try_clone()?, MapSink::create(BufWriter::new(file), &about)?));
        let begun = File::create(path).and_then(begin);
        let (file, sink) = begun.map_err(|source| MapError::write(path, source))?;
        Ok(Self { path: path.to_owned(), file, agent: agent.clone(), sink, known: BTreeMap::new() })
    }

    /// Gives the file another name in the same folder, in place of a file of that name.
    ///
    /// # Errors
    /// [`MapError::Write`] when the system refuses.
    pub fn rename(&mut self, to: &Path) -> Result<(), MapError> {
        std::fs::rename(&self.path, to).map_err(|source| MapError::write(to, source))?;
        self.path = to.to_owned();
        Ok(())
    }

    /// Appends a change of the map, and the frames that were tracked since the last call. It writes the content of
    /// the delta and nothing else. Deltas come in order, from the first one on; entries for keyframes that no delta
    /// added are ignored.
    ///
    /// # Errors
    /// As [`append_keyframe`](Self::append_keyframe).
    pub fn append(&mut self, delta: &MapDelta, frames: &[FramePose]) -> Result<(), MapError> {
        let moved = delta.moved.iter().map(|moved| (moved.keyframe, &moved.world_from_keyframe));
        poses(moved)
            .and_then(|()| delta.edges.iter().flatten().try_for_each(check::edge))
            .and_then(|()| frames.iter().try_for_each(check::frame))
            .map_err(|what| MapError::invalid(&self.path, what))?;
        for keyframe in &delta.added {
            self.append_keyframe(keyframe)?;
            self.known.insert(keyframe.id, bare(keyframe));
        }
        for moved in &delta.moved {
            if let Some(known) = self.known.get_mut(&moved.keyframe) {
                known.world_from_keyframe = moved.world_from_keyframe;
            }
        }
        for Settled { keyframe, semi_dense, points } in &delta.settled {
            if let Some(known) = self.known.get(keyframe) {
                let (semi_dense, points) = (semi_dense.clone(), points.clone());
                self.append_keyframe(&Keyframe { semi_dense, points, ..known.clone() })?;
            }
        }
        for Described { keyframe, features } in &delta.described {
            if let Some(timestamp) = self.known.get(keyframe).map(|known| known.timestamp) {
                self.written(|sink| sink.features(*keyframe, timestamp, features, None))?;
            }
        }
        delta.removed.iter().for_each(|id| drop(self.known.remove(id)));
        if !delta.provenance.is_empty() {
            self.agent.provenance.extend(delta.provenance.clone());
            let about = About::of_agent(&self.agent);
            self.written(|sink| sink.provenance(&about))?;
        }
        let newest = self.known.values().next_back().map(|known| known.timestamp);
        let time = frames.last().map(|frame| frame.timestamp).or(newest).unwrap_or(0.0);
        self.written(|sink| sink.changes(delta, frames, time))
    }

    /// Appends a keyframe, or what has become of it since: depth, points, features and pose replace those
    /// written before, the image is written once, and features when they are others.
    ///
    /// # Errors
    /// [`MapError::Write`] when the system refuses, [`MapError::Invalid`] when the keyframe could not
    /// be loaded again; the file stays usable then.
    pub fn append_keyframe(&mut self, keyframe: &Keyframe) -> Result<(), MapError> {
        let other = (keyframe.agent != AgentId::default())
            .then(|| format!("keyframe {} is another agent's than the run's", keyframe.id.0));
        other
            .map_or(Ok(()), Err)
            .and_then(|()| check::keyframe(keyframe, &self.agent.sensor))
            .map_err(|what| MapError::invalid(&self.path, what))?;
        self.written(|sink| sink.keyframe(keyframe, None))
    }

    /// Appends the map's keyframe poses, edges and frames that have changed; keyframes that the map no longer has are
    /// removed.
    ///
    /// # Errors
    /// As [`append_keyframe`](Self::append_keyframe).
    pub fn append_poses(&mut self, map: &Map) -> Result<(), MapError> {
        poses(map.keyframes.values().map(|keyframe| (keyframe.id, &keyframe.world_from_keyframe)))
            .and_then(|()| map.edges.iter().try_for_each(check::edge))
            .and_then(|()| map.frames.iter().try_for_each(check::frame))
            .map_err(|what| MapError::invalid(&self.path, what))?;
        self.written(|sink| sink.graph(map))
    }

    /// Gives everything appended so far to the system: it survives the end of the process.
    ///
    /// # Errors
    /// [`MapError::Write`], on a full disk for example.
    pub fn flush(&mut self) -> Result<(), MapError> {
        self.written(MapSink::flush)
    }

    /// Brings everything that was flushed to the disk: it survives a power cut.
    ///
    /// # Errors
    /// [`MapError::Write`] when the system refuses.
    pub fn sync(&self) -> Result<(), MapError> {
        self.file.sync_data().map_err(|source| MapError::write(&self.path, source))
    }

    /// Ends the file with an index and syncs it to the disk, for a run that does not replace it with [`save_map`].
    ///
    /// # Errors
    /// [`MapError::Write`], on a full disk for example.
    pub fn finish(mut self) -> Result<(), MapError> {
        self.written(MapSink::finish)?;
        self.file.sync_all().map_err(|source| MapError::write(&self.path, source))
    }

    /// Names the file in errors of `write`.
    fn written(
        &mut self,
        write: impl FnOnce(&mut MapSink<BufWriter<File>>) -> io::Result<()>,
    ) -> Result<(), MapError> {
        write(&mut self.sink).map_err(|source| MapError::write(&self.path, source))
    }
}

/// Whether poses can be written.
fn poses<'a>(mut poses: impl Iterator<Item = (KeyframeId, &'a Sim3)>) -> Result<(), String> {
    poses.try_for_each(|(id, pose)| {
        let problem = check::sim3_problem(pose);
        problem.map_or(Ok(()), |what| Err(format!("keyframe {}: its pose {what}", id.0)))
    })
}

/// A keyframe without what may come later.
fn bare(keyframe: &Keyframe) -> Keyframe {
    let (semi_dense, points) = (SemiDense::default().into(), Vec::new());
    Keyframe { semi_dense, points, features: None, words: None, ..keyframe.clone() }
}
