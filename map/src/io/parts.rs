//! The parts of an agent's own map as bytes, to be stored and sent one by one. A part is the agent's description, the
//! image, the depth with the points, the scan or the pose of a keyframe, or edges and frames.
//!
//! Parts are the messages of the map's file (`book/src/reference/map-format.md`). The image is the PNG alone, and a
//! keyframe's message has no pose, so that a keyframe that only moved is the same part. Parts are checked like a file
//! when they are read, and a map that is assembled from its parts is the same map bit by bit.

use super::about::{About, AboutError};
use super::color::{self, ColorMessage};
use super::messages::{GraphMessage, KeyframeMessage};
use super::scan::{self, ScanMessage};
use super::{convert, picture};
use crate::{AgentInfo, Color, Edge, FramePose, Keyframe, KeyframeId, Map, Scan, check};
use geometry::limits::MAX_SCAN_POINTS;
use geometry::{GrayImage, Pinhole, Sim3};
use prost::Message;
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

/// Metadata records as one message.
#[derive(Clone, PartialEq, prost::Message)]
struct RecordsMessage {
    /// The record of each entry below.
    #[prost(string, repeated, tag = "1")]
    record: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    key: Vec<String>,
    #[prost(string, repeated, tag = "3")]
    value: Vec<String>,
}

/// Poses, edges and frames of a map, all of them or some.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraphPart {
    /// World poses of keyframes.
    pub poses: Vec<(KeyframeId, Sim3)>,
    /// Edges.
    pub edges: Vec<Edge>,
    /// Frames.
    pub frames: Vec<FramePose>,
}

/// The description of an agent.
pub fn agent_to_bytes(agent: &AgentInfo) -> Vec<u8> {
    let mut message = RecordsMessage::default();
    for record in About::of_agent(agent).records() {
        // A record without entries is one all the same: nobody asks whether it was there.
        for (key, value) in record.metadata {
            message.record.push(record.name.clone());
            message.key.push(key);
            message.value.push(value);
        }
    }
    message.encode_to_vec()
}

/// The inverse of [`agent_to_bytes`].
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn agent_from_bytes(bytes: &[u8]) -> Result<AgentInfo, String> {
    let message =
        RecordsMessage::decode(bytes).map_err(|error| format!("an agent cannot be read: {error}"))?;
    if message.key.len() != message.record.len() || message.value.len() != message.record.len() {
        return Err("an agent's entries differ in number".into());
    }
    let mut records: BTreeMap<String, BTreeMap<String, String>> = BTreeMap::new();
    let entries = message.key.into_iter().zip(message.value);
    for (record, (key, value)) in message.record.into_iter().zip(entries) {
        records.entry(record).or_default().insert(key, value);
    }
    let mut about = About::default();
    // In order of their names, which puts an agent before its provenance.
    for (name, entries) in records {
        about.take(&name, entries).map_err(|error| match error {
            AboutError::Version(found) => {
                format!("it is of map format {found}, which this program does not read")
            }
            AboutError::Invalid(what) => what,
        })?;
    }
    match <[_; 1]>::try_from(about.agents.into_values().collect::<Vec<_>>()) {
        Ok([agent]) if agent.own.is_none() => Ok(agent),
        _ => Err("it is not one agent of a map of its own".into()),
    }
}

/// A keyframe's image as a PNG file.
///
/// # Errors
/// When the image has no pixels.
pub fn image_to_bytes(image: &GrayImage) -> io::Result<Vec<u8>> {
    picture::encode_png(image)
}

/// The inverse of [`image_to_bytes`], for an image of `camera`.
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn image_from_bytes(bytes: &[u8], camera: &Pinhole) -> Result<GrayImage, String> {
    picture::decode_png(bytes, [(camera.width, camera.height)])
        .map_err(|what| format!("an image cannot be used: {what}"))
}

/// A keyframe's colours.
pub fn color_to_bytes(id: KeyframeId, color: &Color) -> Vec<u8> {
    color::to_message(id, color).encode_to_vec()
}

/// The inverse of [`color_to_bytes`]: the keyframe's id, and its colours unless they are of a kind that this program does
/// not know.
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn color_from_bytes(bytes: &[u8]) -> Result<(KeyframeId, Option<Color>), String> {
    let message = ColorMessage::decode(bytes).map_err(|error| format!("colours cannot be read: {error}"))?;
    Ok(color::from_message(message))
}

/// The points of a LiDAR's keyframe.
pub fn scan_to_bytes(id: KeyframeId, points: &Scan) -> Vec<u8> {
    scan::to_message(id, points).encode_to_vec()
}

/// The inverse of [`scan_to_bytes`]: the keyframe's id and its points.
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn scan_from_bytes(bytes: &[u8]) -> Result<(KeyframeId, Scan), String> {
    // A step takes ten bytes at the most, and what is read of it eight.
    if bytes.len() > 10 * MAX_SCAN_POINTS {
        return Err(format!("a scan takes {} bytes, more than any may", bytes.len()));
    }
    let message = ScanMessage::decode(bytes).map_err(|error| format!("a scan cannot be read: {error}"))?;
    scan::from_message(message)
}

/// A keyframe without image, scan, features and pose: its time, depth and points.
pub fn depth_to_bytes(keyframe: &Keyframe) -> Vec<u8> {
    let mut message = convert::keyframe_to_message(keyframe, None);
    message.world_from_keyframe = convert::sim3_to_numbers(&Sim3::identity()).to_vec();
    message.encode_to_vec()
}

/// The inverse of [`depth_to_bytes`]: a keyframe with `image`, at the world's origin and without features.
///
/// # Errors
/// Says what is wrong with the bytes, and what does not fit the agent.
pub fn depth_from_bytes(bytes: &[u8], image: Arc<GrayImage>, agent: &AgentInfo) -> Result<Keyframe, String> {
    keyframe_from_bytes(bytes, image, None, agent)
}

/// The same for a LiDAR's keyframe with `scan`; for it [`depth_to_bytes`] stores the time only.
///
/// # Errors
/// As [`depth_from_bytes`].
pub fn time_from_bytes(bytes: &[u8], scan: Arc<Scan>, agent: &AgentInfo) -> Result<Keyframe, String> {
    keyframe_from_bytes(bytes, Arc::new(GrayImage::filled(0, 0, 0)), Some(scan), agent)
}

fn keyframe_from_bytes(
    bytes: &[u8],
    image: Arc<GrayImage>,
    scan: Option<Arc<Scan>>,
    agent: &AgentInfo,
) -> Result<Keyframe, String> {
    let message =
        KeyframeMessage::decode(bytes).map_err(|error| format!("a keyframe cannot be read: {error}"))?;
    let (keyframe, own_pose) = convert::keyframe_from_message(message, image, scan)?;
    if own_pose.is_some() || keyframe.agent.0 != 0 {
        return Err(format!("keyframe {} is not of an agent's own map", keyframe.id.0));
    }
    check::keyframe(&keyframe, &agent.sensor)?;
    Ok(keyframe)
}

/// Poses, edges and frames.
pub fn graph_to_bytes(part: &GraphPart) -> Vec<u8> {
    let mut message = GraphMessage::default();
    for (id, pose) in &part.poses {
        message.keyframe_id.push(id.0);
        message.world_from_keyframe.extend(convert::sim3_to_numbers(pose));
    }
    part.edges.iter().for_each(|edge| convert::push_edge(&mut message, edge));
    part.frames.iter().for_each(|frame| convert::push_frame(&mut message, frame));
    message.encode_to_vec()
}

/// The inverse of [`graph_to_bytes`].
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn graph_from_bytes(bytes: &[u8]) -> Result<GraphPart, String> {
    let message = GraphMessage::decode(bytes).map_err(|error| format!("a graph cannot be read: {error}"))?;
    if message.edge_offset != 0 || message.frame_offset != 0 || !message.removed_keyframe.is_empty() {
        return Err("a graph is a change of another".into());
    }
    let poses = convert::poses_from_message(&message)?;
    let edges = convert::edges_from_message(&message)?;
    let frames = convert::frames_from_message(&message)?;
    for (id, pose) in &poses {
        check::sim3_problem(pose)
            .map_or(Ok(()), |what| Err(format!("keyframe {}: its pose {what}", id.0)))?;
    }
    edges.iter().try_for_each(check::edge)?;
    frames.iter().try_for_each(check::frame)?;
    Ok(GraphPart { poses, edges, frames })
}

impl Map {
    /// Whether all parts of the map make sense and fit each other; says what does not.
    ///
    /// # Errors
    /// What is wrong, and where.
    pub fn check(&self) -> Result<(), String> {
        check::map(self)
    }

    /// Takes out edges, observations and frames that refer to keyframes which are not in the map; says how many edges
    /// and frames they were.
    pub fn drop_dangling(&mut self) -> (usize, usize) {
        let known: Vec<KeyframeId> = self.keyframes.keys().copied().collect();
        let is_known = |id: &KeyframeId| known.binary_search(id).is_ok();
        let before = (self.edges.len(), self.frames.len());
        self.edges.retain(|edge| is_known(&edge.from) && is_known(&edge.to));
        self.frames.retain(|frame| is_known(&frame.reference));
        for point in self.keyframes.values_mut().flat_map(|keyframe| &mut keyframe.points) {
            point.observations.retain(|observation| is_known(&observation.keyframe));
        }
        (before.0 - self.edges.len(), before.1 - self.frames.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{Numbers, lidar_map, sample_map};
    use crate::{AgentId, Map};

    /// A map taken apart and put together again.
    fn through_parts(map: &Map) -> Map {
        let agent = agent_from_bytes(&agent_to_bytes(&map.agents[&AgentId(0)])).unwrap();
        let graph = GraphPart {
            poses: map.keyframes.values().map(|k| (k.id, k.world_from_keyframe)).collect(),
            edges: map.edges.clone(),
            frames: map.frames.clone(),
        };
        let graph = graph_from_bytes(&graph_to_bytes(&graph)).unwrap();
        let camera = *agent.camera().unwrap();
        let mut again = Map { edges: graph.edges, frames: graph.frames, ..Map::of(agent.clone()) };
        for keyframe in map.keyframes.values() {
            let image = image_from_bytes(&image_to_bytes(&keyframe.image).unwrap(), &camera).unwrap();
            let read = depth_from_bytes(&depth_to_bytes(keyframe), Arc::new(image), &agent).unwrap();
            again.keyframes.insert(read.id, Keyframe { features: keyframe.features.clone(), ..read });
        }
        for (id, pose) in graph.poses {
            again.keyframes.get_mut(&id).unwrap().world_from_keyframe = pose;
        }
        again
    }

    #[test]
    fn the_parts_of_a_map_make_the_map() {
        let map = sample_map(5);
        let again = through_parts(&map);
        assert!(again == map);
        assert_eq!(again.check(), Ok(()));
    }

    #[test]
    fn the_parts_of_a_lidars_keyframe_make_the_keyframe() {
        let map = lidar_map(2);
        let agent = &map.agents[&AgentId(0)];
        for keyframe in map.keyframes.values() {
            let points = scan_to_bytes(keyframe.id, keyframe.scan.as_ref().unwrap());
            let (id, scan) = scan_from_bytes(&points).unwrap();
            let read = time_from_bytes(&depth_to_bytes(keyframe), Arc::new(scan), agent).unwrap();
            assert_eq!(id, keyframe.id);
            let (pose, features) = (keyframe.world_from_keyframe, keyframe.features.clone());
            assert!(Keyframe { world_from_keyframe: pose, features, ..read } == *keyframe);
            // A camera's keyframe has no scan, and a LiDAR's no image.
            let image = Arc::new(GrayImage::filled(4, 3, 0));
            assert!(depth_from_bytes(&depth_to_bytes(keyframe), image, agent).is_err());
            for end in 0..points.len() {
                let _ = scan_from_bytes(&points[..end]);
            }
        }
        assert!(scan_from_bytes(&[0xff; 9]).is_err());
        assert!(
            scan_from_bytes(&vec![0; 10 * MAX_SCAN_POINTS + 1]).unwrap_err().contains("more than any may")
        );
    }

    #[test]
    fn a_keyframe_that_was_moved_is_the_same_part() {
        let map = sample_map(2);
        let keyframe = map.keyframes.values().next().unwrap();
        let moved = Keyframe { world_from_keyframe: Sim3::identity(), ..keyframe.clone() };
        assert_eq!(depth_to_bytes(keyframe), depth_to_bytes(&moved));
    }

    #[test]
    fn changed_parts_never_panic_and_numbers_that_are_none_are_refused() {
        let map = sample_map(2);
        let agent = &map.agents[&AgentId(0)];
        let camera = *agent.camera().unwrap();
        let keyframe = map.keyframes.values().next().unwrap();
        let graph = GraphPart { poses: Vec::new(), edges: map.edges.clone(), frames: map.frames.clone() };
        let parts = [
            agent_to_bytes(agent),
            image_to_bytes(&keyframe.image).unwrap(),
            depth_to_bytes(keyframe),
            graph_to_bytes(&graph),
        ];
        let mut numbers = Numbers::new(3);
        let mut below = |limit: usize| (numbers.next() * limit as f64) as usize;
        let mut outcomes = [0, 0];
        for round in 0..4000 {
            let mut changed = parts[round % 4].clone();
            for _ in 0..=below(3) {
                let at = below(changed.len());
                changed[at] = below(256) as u8;
            }
            let read = match round % 4 {
                0 => agent_from_bytes(&changed).map(drop),
                1 => image_from_bytes(&changed, &camera).map(drop),
                2 => depth_from_bytes(&changed, Arc::clone(&keyframe.image), agent).map(drop),
                _ => graph_from_bytes(&changed).map(drop),
            };
            outcomes[usize::from(read.is_ok())] += 1;
        }
        assert!(outcomes[0] > 300 && outcomes[1] > 300, "{outcomes:?}");
        let mut bad = keyframe.clone();
        bad.semi_dense.inverse_depth[0] = f32::NAN;
        let refused = depth_from_bytes(&depth_to_bytes(&bad), Arc::clone(&keyframe.image), agent);
        assert!(refused.unwrap_err().contains("inverse depth NaN"));
    }
}
