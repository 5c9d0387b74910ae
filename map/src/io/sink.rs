//! The messages of a map in order, into any stream.

use super::about::About;
use super::channels::Channels;
use super::messages::{FeaturesMessage, GraphMessage};
use super::{PROFILE, color, convert, picture, scan, views};
use crate::{Edge, FramePose, Keyframe, KeyframeId, Map, MapDelta, Moved, SensorKind, SharedBytes};
use geometry::Sim3;
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Seek, Write};

/// Edges in one message, so that no message outgrows what readers take in one piece.
const EDGES_PER_MESSAGE: usize = 1 << 14;
/// Frames in one message.
const FRAMES_PER_MESSAGE: usize = 1 << 16;

/// How chunks are compressed. Of a camera's map nearly all is images, features and depth that are compressed already: LZ4 would save
/// 1.4 % and take a tenth of the time of a merge, most of it for a second checksum. Of a LiDAR's it saves 16 %.
fn compression(about: &About) -> Option<mcap::Compression> {
    about
        .agents
        .values()
        .any(|agent| agent.sensor.kind() == SensorKind::Lidar)
        .then_some(mcap::Compression::Lz4)
}

/// Writes a map message by message and knows what it has written.
pub(super) struct MapSink<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    channels: Channels,
    /// Keyframes whose image or scan is written.
    seen: BTreeSet<KeyframeId>,
    /// The features as they were written.
    features: BTreeMap<KeyframeId, SharedBytes>,
    poses: BTreeMap<KeyframeId, Sim3>,
    /// What [`graph`](Self::graph) wrote last, which it compares with.
    edges: Vec<Edge>,
    frames: Vec<FramePose>,
    /// How many edges and frames the file has.
    edge_count: usize,
    frame_count: usize,
}

impl<W: Write + Seek> MapSink<W> {
    /// Begins a file: what it is, the agents and the provenance are on the stream when this returns.
    pub(super) fn create(out: W, about: &About) -> io::Result<Self> {
        // Chunks are put together in memory and end where `flush` says: what is on the stream is
        // whole at any time, and a chunk holds a keyframe.
        let options = WriteOptions::new()
            .compression(compression(about))
            .chunk_size(None)
            .disable_seeking(true)
            .profile(PROFILE)
            .library(concat!("loopbox ", env!("CARGO_PKG_VERSION")));
        let mut mcap = options.create(out).map_err(io_error)?;
        for record in about.records() {
            mcap.write_metadata(&record).map_err(io_error)?;
        }
        let channels = Channels::register(&mut mcap, &about.agents).map_err(io_error)?;
        mcap.flush().map_err(io_error)?;
        let (seen, features, poses, edges, frames, edge_count, frame_count) = Default::default();
        Ok(Self { mcap, channels, seen, features, poses, edges, frames, edge_count, frame_count })
    }

    /// [`keyframe`](Self::keyframe) with its image as a PNG file that was made before.
    pub(super) fn keyframe_with_image(
        &mut self,
        keyframe: &Keyframe,
        png: Vec<u8>,
        own_pose: Option<&Sim3>,
    ) -> io::Result<()> {
        self.seen.insert(keyframe.id);
        self.image(keyframe, png)?;
        self.keyframe(keyframe, own_pose)
    }

    /// Writes a keyframe's image with its colours, if it has some.
    fn image(&mut self, keyframe: &Keyframe, png: Vec<u8>) -> io::Result<()> {
        self.message(self.channels.image, keyframe.timestamp, &views::image(keyframe, png))?;
        let Some(of_keyframe) = &keyframe.color else { return Ok(()) };
        let channel = self.channels.color(&mut self.mcap).map_err(io_error)?;
        self.message(channel, keyframe.timestamp, &color::to_message(keyframe.id, of_keyframe))
    }

    /// Writes a keyframe. Its image or scan is written once, and so are its features; depth, points and pose replace
    /// earlier ones. `own_pose` is its pose in its agent's own map, where that is another one.
    pub(super) fn keyframe(&mut self, keyframe: &Keyframe, own_pose: Option<&Sim3>) -> io::Result<()> {
        if self.seen.insert(keyframe.id) {
            self.seen_by(keyframe)?;
        }
        let message = convert::keyframe_to_message(keyframe, own_pose);
        self.message(self.channels.keyframe, keyframe.timestamp, &message)?;
        self.poses.insert(keyframe.id, keyframe.world_from_keyframe);
        match &keyframe.features {
            Some(features) => {
                let words = keyframe.words.as_ref().map(|words| &words[..]);
                self.features(keyframe.id, keyframe.timestamp, features, words)
            }
            None => Ok(()),
        }
    }

    /// Writes the features of a keyframe that was written, and their words, at its time in seconds, if they are others than
    /// before.
    pub(super) fn features(
        &mut self,
        id: KeyframeId,
        time: f64,
        features: &SharedBytes,
        words: Option<&[u8]>,
    ) -> io::Result<()> {
        if self.features.get(&id) != Some(features) {
            let words = words.map(<[u8]>::to_vec).unwrap_or_default();
            let message = FeaturesMessage { keyframe: id.0, data: features.to_vec(), words };
            self.message(self.channels.features, time, &message)?;
            self.features.insert(id, features.clone());
        }
        Ok(())
    }

    /// Writes a keyframe's image or scan.
    fn seen_by(&mut self, keyframe: &Keyframe) -> io::Result<()> {
        if let (Some(of_keyframe), Some(channel)) = (&keyframe.scan, self.channels.scan) {
            return self.message(channel, keyframe.timestamp, &scan::to_message(keyframe.id, of_keyframe));
        }
        if !keyframe.image.data().is_empty() {
            self.image(keyframe, picture::encode_png(&keyframe.image)?)?;
        }
        Ok(())
    }

    /// Writes what has changed in the graph: poses that are new, and edges and frames from the first
    /// one on that is not as it was written.
    pub(super) fn graph(&mut self, map: &Map) -> io::Result<()> {
        let mut message = GraphMessage::default();
        for (id, keyframe) in &map.keyframes {
            if self.poses.get(id) != Some(&keyframe.world_from_keyframe) {
                message.keyframe_id.push(id.0);
                message.world_from_keyframe.extend(convert::sim3_to_numbers(&keyframe.world_from_keyframe));
                self.poses.insert(*id, keyframe.world_from_keyframe);
            }
        }
        let removed = self.poses.keys().filter(|id| !map.keyframes.contains_key(id));
        message.removed_keyframe = removed.map(|id| id.0).collect();
        self.poses.retain(|id, _| map.keyframes.contains_key(id));
        self.features.retain(|id, _| map.keyframes.contains_key(id));

        let time = map.frames.last().map(|frame| frame.timestamp);
        let time =
            time.or(map.keyframes.values().next_back().map(|keyframe| keyframe.timestamp)).unwrap_or(0.0);
        let (edges, frames) = (Tail::new(&self.edges, &map.edges), Tail::new(&self.frames, &map.frames));
        self.graph_messages(message, edges, frames, time)?;
        self.edges.clone_from(&map.edges);
        self.frames.clone_from(&map.frames);
        Ok(())
    }

    /// Writes what a delta says of the graph, and frames that are new, at a time in seconds: poses, edges if they were
    /// made anew, keyframes that are gone.
    pub(super) fn changes(&mut self, delta: &MapDelta, frames: &[FramePose], time: f64) -> io::Result<()> {
        let mut message = GraphMessage::default();
        for Moved { keyframe, world_from_keyframe } in &delta.moved {
            if self.poses.insert(*keyframe, *world_from_keyframe) != Some(*world_from_keyframe) {
                message.keyframe_id.push(keyframe.0);
                message.world_from_keyframe.extend(convert::sim3_to_numbers(world_from_keyframe));
            }
        }
        message.removed_keyframe = delta.removed.iter().map(|id| id.0).collect();
        for id in &delta.removed {
            self.poses.remove(id);
            self.features.remove(id);
        }
        let edges = match &delta.edges {
            Some(edges) => Tail::anew(edges, self.edge_count),
            None => Tail::behind(&[], self.edge_count),
        };
        self.graph_messages(message, edges, Tail::behind(frames, self.frame_count), time)
    }

    /// Writes a change of the graph with so many edges and frames, in as many messages as it takes.
    fn graph_messages(
        &mut self,
        mut message: GraphMessage,
        mut edges: Tail<Edge>,
        mut frames: Tail<FramePose>,
        time: f64,
    ) -> io::Result<()> {
        let mut changed = !message.keyframe_id.is_empty()
            || !message.removed_keyframe.is_empty()
            || edges.changed
            || frames.changed;
        while changed {
            message.edge_offset = edges.offset() as u64;
            edges.take(EDGES_PER_MESSAGE).iter().for_each(|edge| convert::push_edge(&mut message, edge));
            message.frame_offset = frames.offset() as u64;
            frames.take(FRAMES_PER_MESSAGE).iter().for_each(|frame| convert::push_frame(&mut message, frame));
            self.message(self.channels.graph, time, &message)?;
            message = GraphMessage::default();
            changed = !edges.is_done() || !frames.is_done();
        }
        (self.edge_count, self.frame_count) = (edges.offset(), frames.offset());
        Ok(())
    }

    /// Writes what only viewers use: the keyframes' transforms, and of each agent the calibration, the
    /// trajectory and a cloud a keyframe.
    pub(super) fn views(&mut self, map: &Map) -> io::Result<()> {
        let starts =
            map.keyframes.values().map(|k| k.timestamp).chain(map.frames.iter().map(|f| f.timestamp));
        let start = starts.min_by(f64::total_cmp).unwrap_or(0.0);
        self.message(self.channels.transforms, start, &views::keyframe_transforms(map, start))?;
        let points = views::points_each(map.keyframes.len());
        for (agent, channels) in self.channels.agents.clone() {
            let Some(info) = map.agents.get(&agent) else { continue };
            if let (Some(channel), Some(camera)) = (channels.calibration, info.camera()) {
                self.message(channel, start, &views::calibration(camera, &channels.sensor_frame, start))?;
            }
            let trajectory = map.trajectory_of(agent);
            self.message(channels.trajectory, start, &views::trajectory(&trajectory, start))?;
            for pose in trajectory {
                let transform =
                    views::sensor_transform(&channels.sensor_frame, &pose.world_from_camera, pose.timestamp);
                self.message(self.channels.transforms, pose.timestamp, &transform)?;
            }
            self.flush()?;
            for keyframe in map.keyframes.values().filter(|keyframe| keyframe.agent == agent) {
                let cloud = match (&keyframe.scan, info.camera()) {
                    (Some(scan), _) => views::scan_cloud(keyframe, scan, points),
                    (None, Some(camera)) => views::cloud(keyframe, camera, points),
                    (None, None) => continue,
                };
                keyframe.rest();
                self.message(channels.cloud, keyframe.timestamp, &cloud)?;
                self.flush()?;
            }
        }
        Ok(())
    }

    /// Puts everything written so far on the stream, readable whatever comes next.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.mcap.flush().map_err(io_error)
    }

    /// Writes anew where the agents' maps came from.
    pub(super) fn provenance(&mut self, about: &About) -> io::Result<()> {
        about.provenance().try_for_each(|record| self.mcap.write_metadata(&record).map_err(io_error))
    }

    /// Ends the file with its index.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.mcap.finish().map(drop).map_err(io_error)
    }

    /// Writes one message at a time in seconds.
    fn message(&mut self, channel_id: u16, time: f64, message: &impl prost::Message) -> io::Result<()> {
        let log_time = views::nanoseconds(time);
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        self.mcap.write_to_known_channel(&header, &message.encode_to_vec()).map_err(io_error)
    }
}

/// The part of a list that is not as it was written.
struct Tail<'a, T> {
    list: &'a [T],
    start: usize,
    /// Items that come before the list.
    before: usize,
    changed: bool,
}

impl<'a, T: PartialEq> Tail<'a, T> {
    /// The tail of `list` after what it has in common with `written`.
    fn new(written: &[T], list: &'a [T]) -> Self {
        let start = written.iter().zip(list).take_while(|(old, new)| old == new).count();
        Self { list, start, before: 0, changed: start < list.len() || start < written.len() }
    }

    /// A list in place of the `count` items that are written.
    fn anew(list: &'a [T], count: usize) -> Self {
        Self { list, start: 0, before: 0, changed: !list.is_empty() || count > 0 }
    }

    /// Items behind the `count` that are written.
    fn behind(list: &'a [T], count: usize) -> Self {
        Self { list, start: 0, before: count, changed: !list.is_empty() }
    }

    /// Items that are written.
    fn offset(&self) -> usize {
        self.before + self.start
    }

    /// The next `count` items, or as many as are left.
    fn take(&mut self, count: usize) -> &'a [T] {
        let end = self.list.len().min(self.start + count);
        let items = &self.list[self.start..end];
        self.start = end;
        items
    }

    /// Whether no item is left.
    fn is_done(&self) -> bool {
        self.start == self.list.len()
    }
}

/// The system's error inside of an error of the MCAP writer.
fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
