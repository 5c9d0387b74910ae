//! What a map file holds, record by record, and the map that it makes.

use super::{LoadedMap, Refusal};
use crate::io::about::About;
use crate::io::color::COLOR_TOPIC;
use crate::io::messages::{FeaturesMessage, GraphMessage, KeyframeMessage};
use crate::io::parts::color_from_bytes;
use crate::io::records::{Stop, read_chunk};
use crate::io::scan::{self, SCAN_TOPIC, ScanMessage};
use crate::io::{FEATURES_TOPIC, GRAPH_TOPIC, IMAGE_TOPIC, KEYFRAME_TOPIC, PROFILE, convert, picture, views};
use crate::{
    AgentId, Color, Edge, FramePose, Identity, Keyframe, KeyframeId, Map, Scan, Sensor, SharedBytes, check,
};
use foxglove::messages::CompressedImage;
use geometry::{GrayImage, Sim3, Swap};
use mcap::parse_record;
use mcap::records::{Record, op};
use prost::Message;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;
/// Which message a channel carries; other channels are for viewers.
#[derive(Clone, Copy)]
enum Kind {
    Image,
    Color,
    Scan,
    Keyframe,
    Features,
    Graph,
}

/// What a message of features says.
struct Features {
    data: SharedBytes,
    words: Option<SharedBytes>,
}

/// Files of images that are decoded together, on all cores.
const IMAGES_TOGETHER: usize = 64;

/// What was read so far.
#[derive(Default)]
pub(super) struct Contents<'a> {
    pub(super) has_header: bool,
    pub(super) about: About,
    channels: BTreeMap<u16, Kind>,
    /// What keeps images, depths, features and words in memory's place.
    swap: Option<&'a dyn Swap>,
    /// The files of images that are not decoded yet.
    undecoded: BTreeMap<KeyframeId, Vec<u8>>,
    images: BTreeMap<KeyframeId, Arc<GrayImage>>,
    colors: BTreeMap<KeyframeId, Color>,
    scans: BTreeMap<KeyframeId, Arc<Scan>>,
    keyframes: BTreeMap<KeyframeId, Keyframe>,
    features: BTreeMap<KeyframeId, Features>,
    poses: BTreeMap<KeyframeId, Sim3>,
    /// What keyframes have before theirs is decoded.
    no_image: Arc<GrayImage>,
    /// Poses in the agents' own maps.
    own_poses: BTreeMap<KeyframeId, Sim3>,
    edges: Vec<Edge>,
    frames: Vec<FramePose>,
    warnings: Vec<String>,
}

impl<'a> Contents<'a> {
    /// Nothing yet; `swap` keeps images, depths, features and words in memory's place.
    pub(super) fn new(swap: Option<&'a dyn Swap>) -> Self {
        Self { swap, ..Self::default() }
    }

    /// Remembers that something is missing.
    pub(super) fn damage(&mut self, what: String) {
        self.warnings.push(what);
    }

    /// Whether something is missing.
    pub(super) fn is_damaged(&self) -> bool {
        !self.warnings.is_empty()
    }

    /// Takes a record of the file.
    pub(super) fn record(&mut self, opcode: u8, data: &[u8]) -> Result<(), Refusal> {
        match opcode {
            op::HEADER | op::METADATA => match parse_record(opcode, data) {
                Ok(Record::Header(header)) if header.profile != PROFILE => return Err(Refusal::NotAMap),
                Ok(Record::Header(_)) => self.has_header = true,
                Ok(Record::Metadata(about)) => self.about.take(&about.name, about.metadata)?,
                Ok(_) => {}
                Err(error) => self.damage(format!("the file is damaged near its beginning: {error}")),
            },
            op::CHUNK => match read_chunk(data, &mut |opcode, data| self.chunk_record(opcode, data)) {
                Ok(()) => {}
                Err(Stop::Refused(refusal)) => return Err(refusal),
                Err(Stop::Damaged(error)) => self.damage(format!("a damaged part was left out: {error}")),
                Err(Stop::Failed(error)) => self.damage(format!("a part was left out: {error}")),
            },
            // Indexes and the end: the data come in order, so nothing is looked up.
            _ => {}
        }
        Ok(())
    }

    /// Takes a record of a chunk.
    pub(super) fn chunk_record(&mut self, opcode: u8, data: &[u8]) -> Result<(), Refusal> {
        if !matches!(opcode, op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        let record = parse_record(opcode, data);
        match record.map_err(|error| format!("a message cannot be read: {error}"))? {
            Record::Channel(channel) => {
                let kind = match channel.topic.as_str() {
                    IMAGE_TOPIC => Kind::Image,
                    COLOR_TOPIC => Kind::Color,
                    SCAN_TOPIC => Kind::Scan,
                    KEYFRAME_TOPIC => Kind::Keyframe,
                    FEATURES_TOPIC => Kind::Features,
                    GRAPH_TOPIC => Kind::Graph,
                    _ => return Ok(()),
                };
                self.channels.insert(channel.id, kind);
            }
            Record::Message { header, data } => match self.channels.get(&header.channel_id) {
                Some(Kind::Image) => self.image(&data)?,
                Some(Kind::Color) => self.color(&data)?,
                Some(Kind::Scan) => self.scan(&data)?,
                Some(Kind::Keyframe) => self.keyframe(&data)?,
                Some(Kind::Features) => self.features(&data)?,
                Some(Kind::Graph) => self.graph(&data)?,
                None => {}
            },
            _ => {}
        }
        Ok(())
    }

    /// Takes a keyframe's image.
    fn image(&mut self, data: &[u8]) -> Result<(), String> {
        let message =
            CompressedImage::decode(data).map_err(|error| format!("an image cannot be read: {error}"))?;
        let id = views::keyframe_of_frame(&message.frame_id)
            .ok_or_else(|| format!("an image belongs to \"{}\", which is no keyframe", message.frame_id))?;
        self.images.remove(&id);
        self.undecoded.insert(id, message.data.into());
        if self.undecoded.len().is_multiple_of(IMAGES_TOGETHER) {
            self.decode_images();
        }
        Ok(())
    }

    /// Takes a keyframe's colours. Whether they can be decoded is not looked at: without them the image is grey.
    fn color(&mut self, data: &[u8]) -> Result<(), String> {
        let (id, color) = color_from_bytes(data)?;
        self.colors.extend(color.map(|color| (id, color)));
        Ok(())
    }

    /// Decodes the images whose files were read. Those that cannot be used stay, for when all is known: they may be of no keyframe.
    pub(super) fn decode_images(&mut self) {
        let sizes = self.about.image_sizes();
        let decode = |(id, file): (&KeyframeId, &Vec<u8>)| {
            let image = picture::decode_png(file, sizes.iter().copied()).ok()?;
            let image = self.swap.and_then(|swap| image.swapped_out(swap)).unwrap_or(image);
            image.rest();
            Some((*id, Arc::new(image)))
        };
        let decoded: Vec<_> = self.undecoded.par_iter().filter_map(decode).collect();
        decoded.iter().for_each(|(id, _)| {
            self.undecoded.remove(id);
        });
        self.images.extend(decoded);
    }

    /// Takes a LiDAR keyframe's scan.
    fn scan(&mut self, data: &[u8]) -> Result<(), String> {
        let message = ScanMessage::decode(data).map_err(|error| format!("a scan cannot be read: {error}"))?;
        let (id, scan) = scan::from_message(message)?;
        self.scans.insert(id, Arc::new(scan));
        Ok(())
    }

    /// Whether a keyframe's agent sees with a LiDAR.
    fn is_lidar(&self, message: &KeyframeMessage) -> bool {
        let agent = u16::try_from(message.agent).ok().and_then(|id| self.about.agents.get(&AgentId(id)));
        agent.is_some_and(|info| info.sensor == Sensor::Lidar)
    }

    /// Takes a keyframe, in place of an earlier one of that id.
    fn keyframe(&mut self, data: &[u8]) -> Result<(), String> {
        let message =
            KeyframeMessage::decode(data).map_err(|error| format!("a keyframe cannot be read: {error}"))?;
        let id = KeyframeId(message.id);
        let (missing, scan) = if self.is_lidar(&message) {
            let scan = self.scans.get(&id).cloned();
            (scan.is_none().then_some("scan"), scan)
        } else {
            let is_there = self.images.contains_key(&id) || self.undecoded.contains_key(&id);
            ((!is_there).then_some("image"), None)
        };
        if let Some(missing) = missing {
            let what = format!("keyframe {} has no {missing}", id.0);
            return if self.is_damaged() {
                self.damage(what + " and was left out");
                Ok(())
            } else {
                Err(what)
            };
        }
        let no_image = Arc::clone(&self.no_image);
        let (mut keyframe, own_pose) = convert::keyframe_from_message(message, no_image, scan)?;
        if let Some(swap) = self.swap {
            keyframe.swap_out(swap);
            keyframe.rest();
        }
        self.own_poses.extend(own_pose.map(|pose| (id, pose)));
        self.poses.insert(id, keyframe.world_from_keyframe);
        self.keyframes.insert(id, keyframe);
        Ok(())
    }

    /// Takes the features of a keyframe, in place of earlier ones. What they mean is not looked at.
    fn features(&mut self, data: &[u8]) -> Result<(), String> {
        let message =
            FeaturesMessage::decode(data).map_err(|error| format!("features cannot be read: {error}"))?;
        let kept = |bytes: Vec<u8>| SharedBytes::kept_by(self.swap, bytes);
        let (id, data) = (KeyframeId(message.keyframe), kept(message.data));
        let words = (!message.words.is_empty()).then(|| kept(message.words));
        self.features.insert(id, Features { data, words });
        Ok(())
    }

    /// Takes a change of the graph.
    fn graph(&mut self, data: &[u8]) -> Result<(), String> {
        let message =
            GraphMessage::decode(data).map_err(|error| format!("a graph cannot be read: {error}"))?;
        self.poses.extend(convert::poses_from_message(&message)?);
        for id in &message.removed_keyframe {
            self.keyframes.remove(&KeyframeId(*id));
            self.poses.remove(&KeyframeId(*id));
            self.features.remove(&KeyframeId(*id));
        }
        let edges = convert::edges_from_message(&message)?;
        let frames = convert::frames_from_message(&message)?;
        let edges = replace_tail(&mut self.edges, message.edge_offset, edges);
        let frames = replace_tail(&mut self.frames, message.frame_offset, frames);
        if edges && frames {
            return Ok(());
        }
        let what = "a list of edges or frames lacks its beginning";
        if !self.is_damaged() {
            return Err(what.into());
        }
        self.damage(format!("{what}, which was in a damaged part; the rest of it was left out"));
        Ok(())
    }

    /// The map, checked.
    pub(super) fn into_map(mut self) -> Result<LoadedMap, Refusal> {
        let is_damaged = self.is_damaged();
        self.decode_images();
        let (unknown, sizes) = (self.about.unknown(), self.about.image_sizes());
        let About { agents, merge_provenance, .. } = self.about;
        let (edges, frames, keyframes) = (self.edges, self.frames, self.keyframes);
        let mut map = Map { agents, keyframes, edges, frames, merge_provenance };
        let mut warnings = self.warnings;
        if is_damaged {
            warnings.extend(drop_strangers(&mut map));
        }
        for (id, keyframe) in &mut map.keyframes {
            if keyframe.scan.is_none() {
                let image = self
                    .images
                    .remove(id)
                    .map_or_else(|| decoded(*id, self.undecoded.get(id), &sizes).map(Arc::new), Ok);
                keyframe.image = image?;
                keyframe.color = self.colors.remove(id);
            }
            if let Some(pose) = self.poses.get(id) {
                keyframe.world_from_keyframe = *pose;
            }
            if let Some(Features { data, words }) = self.features.remove(id) {
                (keyframe.features, keyframe.words) = (Some(data), words);
            }
            let agent = map.agents.get_mut(&keyframe.agent);
            if let (Some(own), Some(pose)) = (agent.and_then(|a| a.own.as_mut()), self.own_poses.remove(id)) {
                own.world_from_keyframe.insert(*id, pose);
            }
        }
        identify(&mut map, &unknown);
        check::map(&map)?;
        if is_damaged {
            warnings.extend(drop_dangling(&mut map));
            warnings.push(format!("{} keyframes were loaded", map.keyframes.len()));
        }
        Ok(LoadedMap { map, complete: !is_damaged, warnings })
    }
}

/// The image of a keyframe, of one of the known sizes (width, height), from its file; says what is wrong with it.
fn decoded(id: KeyframeId, file: Option<&Vec<u8>>, sizes: &[(usize, usize)]) -> Result<GrayImage, String> {
    let file = file.map_or(&[][..], |file| file);
    picture::decode_png(file, sizes.iter().copied())
        .map_err(|what| format!("the image of keyframe {} cannot be used: {what}", id.0))
}

/// Gives agents of files from before there were identities those that follow from what they saw first, which is the same
/// in all copies of such a map and in all maps that it was merged into.
fn identify(map: &mut Map, unknown: &[AgentId]) {
    for agent in unknown {
        let first = map.keyframes.values().find(|keyframe| keyframe.agent == *agent);
        let Some(info) = map.agents.get_mut(agent) else { continue };
        // Files from before there were identities are of cameras.
        let Some(camera) = info.camera() else { continue };
        let of = |first: &Keyframe| Identity::of_recording(camera, first.timestamp, &first.image);
        let mut identity = first.map_or_else(|| Identity::of_name(&info.name, camera), of);
        while map.agents.values().any(|other| other.identity == Some(identity)) {
            identity = identity.later(1);
        }
        map.agents.entry(*agent).and_modify(|info| info.identity = Some(identity));
    }
}

/// Puts `tail` in place of what `list` has from `offset` on; false when the list is shorter than that.
fn replace_tail<T>(list: &mut Vec<T>, offset: u64, tail: Vec<T>) -> bool {
    let Some(offset) = usize::try_from(offset).ok().filter(|&offset| offset <= list.len()) else {
        return false;
    };
    list.truncate(offset);
    list.extend(tail);
    true
}

/// Takes keyframes out of a damaged map whose agents were lost; says how many.
fn drop_strangers(map: &mut Map) -> Option<String> {
    let before = map.keyframes.len();
    map.keyframes.retain(|_, keyframe| map.agents.contains_key(&keyframe.agent));
    let count = before - map.keyframes.len();
    (count > 0).then(|| format!("{count} keyframes belong to missing agents and were left out"))
}

/// Takes out of a damaged map what refers to keyframes that were lost; says how much.
fn drop_dangling(map: &mut Map) -> Option<String> {
    let (edges, frames) = map.drop_dangling();
    (edges + frames > 0)
        .then(|| format!("{edges} edges and {frames} frames belong to missing keyframes and were left out"))
}

#[cfg(test)]
mod tests;
