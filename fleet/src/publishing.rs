//! An agent's own map as objects, and what is new among them.

use crate::hash::ObjectHash;
use crate::lossy_codec::digest::Digest;
use crate::lossy_codec::{depth, image};
use crate::manifest::{ENTRIES, Entry, Kind, MAX_OBJECT, Manifest, Page, PageRef, page_to_bytes};
use crate::wire::MapVersion;
use features::codec;
use geometry::Pinhole;
use map::parts::{
    GraphPart, agent_to_bytes, color_to_bytes, depth_to_bytes, graph_to_bytes, image_to_bytes, scan_to_bytes,
};
use map::{AgentId, Edge, FramePose, Identity, Keyframe, KeyframeId, Map, MapError, Scan, Sensor};
use place_recog::{Vocabulary, WordBag};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Poses in one object: 17 kB.
const POSES: usize = 256;
/// Edges in one object: 30 kB.
const EDGES: usize = 64;
/// Frames in one object: 36 kB.
const FRAMES: usize = 512;

/// A version of a map to be told.
#[derive(Clone, Debug)]
pub struct Publication {
    /// What is told of it.
    pub version: MapVersion,
    /// The objects that the version before did not have, the manifest and its pages among them.
    pub objects: Vec<(ObjectHash, Arc<[u8]>)>,
    /// The manifest of this version.
    pub manifest: Manifest,
    /// What its pages list, in their order.
    pub pages: Vec<Page>,
}

/// Takes the map of an agent apart, again and again as it grows.
pub struct Publisher {
    agent: Identity,
    begun: u64,
    revision: u64,
    /// The entries as they were told, by kind and number.
    published: BTreeMap<(Kind, u32), Entry>,
    /// The keyframes as they were told.
    keyframes: BTreeMap<KeyframeId, Keyframe>,
    /// Earlier keyframes that each shares edges with, as they were told.
    linked: BTreeMap<KeyframeId, Vec<KeyframeId>>,
    pages: BTreeMap<ObjectHash, Page>,
    finished: bool,
}

impl Publisher {
    /// Of the map of `agent`, which is told from `begun` on, milliseconds since 1970.
    pub fn new(agent: Identity, begun: u64) -> Self {
        let (published, keyframes, linked, pages) = Default::default();
        Self { agent, begun, revision: 0, published, keyframes, linked, pages, finished: false }
    }

    /// The map as it is by now; `None` when nothing of it is new. Keyframes without depth are not told before the map
    /// is `finished`: nothing can be recognised or aligned by them.
    ///
    /// # Errors
    /// When it is not the map of one agent, or a keyframe cannot be written.
    pub fn publish(&mut self, map: &Map, finished: bool) -> Result<Option<Publication>, MapError> {
        let refuse = |what: String| MapError::Union(what);
        let Some(info) = map.agents.get(&AgentId::default()).filter(|_| map.agents.len() == 1) else {
            return Err(refuse("only an agent's own map can be told".into()));
        };
        let vocabulary = Vocabulary::shipped();
        let (entries, objects) = Default::default();
        let mut step =
            Step { published: &self.published, linked: &self.linked, vocabulary, entries, objects };
        step.add(Kind::Agent, 0, agent_to_bytes(info)).map_err(refuse)?;
        let is_published =
            |keyframe: &&Keyframe| finished || keyframe.scan.is_some() || !keyframe.semi_dense.is_empty();
        let keyframes: Vec<&Keyframe> = map.keyframes.values().filter(is_published).collect();
        let mut linked: BTreeMap<KeyframeId, Vec<KeyframeId>> = BTreeMap::new();
        for edge in &map.edges {
            linked.entry(edge.from.max(edge.to)).or_default().push(edge.from.min(edge.to));
        }
        for keyframe in &keyframes {
            let before = self.keyframes.get(&keyframe.id);
            let linked = linked.get(&keyframe.id).map_or(&[][..], Vec::as_slice);
            match (&info.sensor, &keyframe.scan) {
                (Sensor::Camera(camera), None) => step.keyframe(keyframe, before, (linked, camera)),
                (Sensor::Lidar, Some(scan)) => step.scan(keyframe, scan, before),
                _ => Err(format!("keyframe {} is not of its agent's sensor", keyframe.id.0)),
            }
            .map_err(refuse)?;
        }
        let poses: Vec<_> = keyframes.iter().map(|k| (k.id, k.world_from_keyframe)).collect();
        for (number, poses) in (0..).zip(poses.chunks(POSES)) {
            let part = GraphPart { poses: poses.to_vec(), ..GraphPart::default() };
            step.add(Kind::Poses, number, graph_to_bytes(&part)).map_err(refuse)?;
        }
        for (number, edges) in (0..).zip(map.edges.chunks(EDGES)) {
            step.add(Kind::Edges, number, edges_part(edges)).map_err(refuse)?;
        }
        for (number, frames) in (0..).zip(map.frames.chunks(FRAMES)) {
            step.add(Kind::Frames, number, frames_part(frames)).map_err(refuse)?;
        }
        let Step { entries, objects, .. } = step;
        if entries == self.published && finished == self.finished {
            return Ok(None);
        }
        let newest = keyframes.last().map_or(0, |keyframe| keyframe.id.0);
        self.keyframes = keyframes.iter().map(|keyframe| (keyframe.id, (*keyframe).clone())).collect();
        (self.published, self.linked, self.finished) = (entries, linked, finished);
        self.revision += 1;
        Ok(Some(self.listed(newest, objects)))
    }

    /// Has all of the map told anew: what was told last could not be kept.
    pub fn begin_again(&mut self) {
        (self.published, self.keyframes, self.linked, self.pages) = Default::default();
    }

    /// What is told by now: `objects` and the lists that are new.
    fn listed(&mut self, newest: u32, mut objects: Vec<(ObjectHash, Arc<[u8]>)>) -> Publication {
        let (mut named, mut pages) = (Vec::new(), Vec::new());
        let mut known = BTreeMap::new();
        let mut page = |entries: &[Entry]| {
            let bytes = page_to_bytes(entries);
            let page = PageRef { size: bytes.len() as u32, hash: ObjectHash::of(&bytes) };
            let listed = self.pages.get(&page.hash).cloned().unwrap_or_else(|| {
                objects.push((page.hash, bytes.into()));
                entries.into()
            });
            known.insert(page.hash, Arc::clone(&listed));
            named.push(page);
            pages.push(listed);
        };
        // What is said of keyframes on pages of their own, so that old ones stay as they are.
        let of_keyframes = |entry: &&Entry| entry.kind.is_of_keyframe();
        let general: Vec<Entry> =
            self.published.values().filter(|entry| !of_keyframes(entry)).copied().collect();
        general.chunks(ENTRIES).for_each(&mut page);
        let mut keyframes: Vec<Entry> = self.published.values().filter(of_keyframes).copied().collect();
        keyframes.sort_by_key(|entry| (entry.number, entry.kind));
        keyframes.chunks(ENTRIES).for_each(&mut page);
        self.pages = known;
        let (agent, begun, revision, finished) = (self.agent, self.begun, self.revision, self.finished);
        let manifest = Manifest { agent, begun, revision, finished, pages: named };
        let bytes = manifest.to_bytes();
        let (size, hash) = (bytes.len() as u32, ObjectHash::of(&bytes));
        objects.push((hash, bytes.into()));
        let version = MapVersion { agent, begun, revision, newest, size, hash };
        Publication { version, objects, manifest, pages }
    }
}

fn edges_part(edges: &[Edge]) -> Vec<u8> {
    graph_to_bytes(&GraphPart { edges: edges.to_vec(), ..GraphPart::default() })
}

fn frames_part(frames: &[FramePose]) -> Vec<u8> {
    graph_to_bytes(&GraphPart { frames: frames.to_vec(), ..GraphPart::default() })
}

/// A version as it is put together.
struct Step<'a> {
    published: &'a BTreeMap<(Kind, u32), Entry>,
    /// Earlier keyframes that each shared edges with, as they were told.
    linked: &'a BTreeMap<KeyframeId, Vec<KeyframeId>>,
    vocabulary: Arc<Vocabulary>,
    entries: BTreeMap<(Kind, u32), Entry>,
    objects: Vec<(ObjectHash, Arc<[u8]>)>,
}

impl Step<'_> {
    /// The parts of a LiDAR's keyframe, which does not change but for its pose: its time and its points.
    fn scan(
        &mut self,
        keyframe: &Keyframe,
        scan: &Arc<Scan>,
        before: Option<&Keyframe>,
    ) -> Result<(), String> {
        let number = keyframe.id.0;
        let same = before.and_then(|before| before.scan.as_ref()).is_some_and(|same| Arc::ptr_eq(same, scan));
        if same && self.keep(Kind::Scan, number) && self.keep(Kind::Depth, number) {
            return Ok(());
        }
        self.add(Kind::Scan, number, scan_to_bytes(keyframe.id, scan))?;
        self.add(Kind::Depth, number, depth_to_bytes(keyframe))
    }

    /// The parts of a camera's keyframe; those that are as `before` are not made again. `linked` are earlier keyframes that
    /// it shares edges with.
    fn keyframe(
        &mut self,
        keyframe: &Keyframe,
        before: Option<&Keyframe>,
        (linked, camera): (&[KeyframeId], &Pinhole),
    ) -> Result<(), String> {
        let number = keyframe.id.0;
        let same_image = before.is_some_and(|before| Arc::ptr_eq(&before.image, &keyframe.image));
        if !same_image || !self.keep(Kind::Image, number) {
            let unwritable =
                |error: String| format!("the image of keyframe {number} cannot be written: {error}");
            let png = image_to_bytes(&keyframe.image).map_err(|error| unwritable(error.to_string()))?;
            self.add(Kind::Image, number, png)?;
            self.add(Kind::LossyImage, number, image::encode(&keyframe.image).map_err(unwritable)?)?;
        } else {
            self.keep(Kind::LossyImage, number);
        }
        if let Some(color) = &keyframe.color {
            let same = before.and_then(|before| before.color.as_ref());
            let same = same.is_some_and(|same| Arc::ptr_eq(&same.jpeg, &color.jpeg));
            if !same || !self.keep(Kind::Color, number) {
                self.add(Kind::Color, number, color_to_bytes(keyframe.id, color))?;
            }
        }
        let same_depth = |before: &Keyframe| {
            let shared = std::ptr::eq(&*before.semi_dense, &*keyframe.semi_dense);
            let time = before.timestamp.to_bits() == keyframe.timestamp.to_bits();
            shared && time && before.points == keyframe.points
        };
        let same_depth = before.is_some_and(same_depth) && self.keep(Kind::Depth, number);
        if !same_depth {
            self.add(Kind::Depth, number, depth_to_bytes(keyframe))?;
            self.add(Kind::LossyDepth, number, depth::encode(&keyframe.semi_dense, camera))?;
        } else {
            self.keep(Kind::LossyDepth, number);
        }
        let mut same_features = true;
        if let Some(features) = &keyframe.features {
            let same = before.and_then(|before| before.features.as_ref());
            same_features = same.is_some_and(|same| std::ptr::eq(&**same, &**features));
            if !same_features || !self.keep(Kind::Features, number) {
                self.add(Kind::Features, number, features.to_vec())?;
            }
        }
        let known = self.linked.get(&keyframe.id).map_or(&[][..], Vec::as_slice) == linked;
        if !(same_depth && same_features && known && self.keep(Kind::Digest, number)) {
            let found = keyframe.features.as_deref().and_then(|bytes| codec::decode(bytes).ok());
            let words = found.map_or_else(WordBag::default, |found| self.vocabulary.words(&found));
            let digest = Digest::of(keyframe, words, linked);
            self.add(Kind::Digest, number, digest.to_bytes(keyframe.id))?;
        }
        Ok(())
    }

    /// Tells an object as it was told before; false when it was not.
    fn keep(&mut self, kind: Kind, number: u32) -> bool {
        let published = self.published.get(&(kind, number));
        published.is_some_and(|entry| self.entries.insert((kind, number), *entry).is_none())
    }

    /// Adds an object, which may turn out to be what it was.
    fn add(&mut self, kind: Kind, number: u32, bytes: Vec<u8>) -> Result<(), String> {
        let size = u32::try_from(bytes.len()).ok().filter(|&size| size <= MAX_OBJECT);
        let size = size.ok_or_else(|| format!("{kind:?} {number} takes {} bytes: too many", bytes.len()))?;
        let hash = ObjectHash::of(&bytes);
        if self.published.get(&(kind, number)).is_none_or(|published| published.hash != hash) {
            let revision = self.published.get(&(kind, number)).map_or(0, |published| published.revision + 1);
            self.entries.insert((kind, number), Entry { kind, number, revision, size, hash });
            self.objects.push((hash, bytes.into()));
        } else {
            self.keep(kind, number);
        }
        Ok(())
    }
}
