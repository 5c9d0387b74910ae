//! Objects as the map that they are of.

use crate::bytes::Writer;
use crate::hash::ObjectHash;
use crate::lossy_codec::digest::Digest;
use crate::lossy_codec::{depth, image};
use crate::manifest::{Entry, Kind, Manifest, Page, PageRef, page_from_bytes};
use crate::store::Objects;
use geometry::{GrayImage, Pinhole, Sim3};
use map::parts::{
    agent_from_bytes, color_from_bytes, depth_from_bytes, graph_from_bytes, image_from_bytes,
    scan_from_bytes, time_from_bytes,
};
use map::{AgentInfo, Color, Edge, Identity, Keyframe, KeyframeId, Map, Sensor};
use place_recog::Vocabulary;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A map put together of its objects.
///
/// Of a map in part some keyframes have images and depths, exact ones or those that stand in for them. The others have
/// none, but their places and edges: by them the parts hang together, so that whether two closures agree is told from
/// the same ways along the map as in the whole one. Of a LiDAR's map in part the others are not there at all: what it is
/// merged by are the poses of its keyframes.
#[derive(Clone, Debug)]
pub struct Assembled {
    /// The map.
    pub map: Map,
    /// Keyframes that are told of and have no image and depth, or no scan, in the map.
    pub missing: usize,
    /// Whether all of the map is there: it is the agent's own, bit by bit.
    pub whole: bool,
    /// Stands for all of the map that merging looks at: equal when nothing of it changed.
    pub content: ObjectHash,
}

/// The pages of a manifest; `None` while one is not there.
pub(crate) fn pages_of(manifest: &Manifest, store: &dyn Objects) -> Result<Option<Vec<Page>>, String> {
    let page = |page: &PageRef| match store.get(&page.hash) {
        Some(bytes) => read_page(&bytes).map(Some),
        None => Ok(None),
    };
    manifest.pages.iter().map(page).collect()
}

/// A page.
pub(crate) fn read_page(bytes: &[u8]) -> Result<Page, String> {
    page_from_bytes(bytes).map_err(|what| format!("a list of objects cannot be read: {what}"))
}

/// The objects on pages, in order of their kinds and numbers.
pub(crate) fn in_order(pages: &[Page]) -> Result<Vec<Entry>, String> {
    let mut entries: Vec<Entry> = pages.iter().flat_map(|page| page.iter().copied()).collect();
    entries.sort_by_key(|entry| (entry.kind, entry.number));
    let twice = entries.windows(2).find(|two| (two[0].kind, two[0].number) == (two[1].kind, two[1].number));
    match twice {
        Some(two) => Err(format!("{:?} {} is listed twice", two[0].kind, two[0].number)),
        None => Ok(entries),
    }
}

/// Puts the map of one agent together, again and again as objects come.
#[derive(Default)]
pub struct Assembler {
    /// Keyframes at the world's origin, by what they were made of.
    made: BTreeMap<KeyframeId, (Parts, Keyframe)>,
    digests: BTreeMap<KeyframeId, (ObjectHash, Digest)>,
}

/// What a keyframe is made of.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Parts {
    /// Image or scan.
    view: Entry,
    depth: Entry,
    features: Option<ObjectHash>,
    /// Where it has some, and they are here: nothing waits for them but the whole map.
    color: Option<ObjectHash>,
}

/// How exactly the way from a keyframe to the next is taken to be known where its edge is not there: translation as a
/// share of the way, rotation in radians, scale. As merging assumes of a map's drift from keyframe to keyframe
/// (`ConsistencyParams`).
const DRIFT: [f64; 3] = [0.02, 0.0035, 0.015];

impl Assembler {
    /// The map of `agent` of the objects listed that are in the store, images and depths of the keyframes `only` alone;
    /// `None` while nothing can be told of the agent.
    ///
    /// # Errors
    /// When an object is what its hash says and yet not what it should be, or they contradict each other: whoever tells it is
    /// not to be believed. One that is gone or damaged here is none of that: it is not there.
    pub fn assemble(
        &mut self,
        agent: Identity,
        entries: &[Entry],
        store: &dyn Objects,
        only: Option<&BTreeSet<KeyframeId>>,
    ) -> Result<Option<Assembled>, String> {
        let objects = Listed::new(entries, store);
        let Some(info) = objects.agent(agent)? else { return Ok(None) };
        let mut map = Map::of(info.clone());
        let (poses, mut whole) = objects.graph(&mut map)?;
        let (width, height) = info.camera().map_or((0, 0), |camera| (camera.width, camera.height));
        let blank = Arc::new(GrayImage::filled(width, height, 0));
        let is_lidar = info.sensor == Sensor::Lidar;
        let (view, named) = if is_lidar { (Kind::Scan, "scan") } else { (Kind::Image, "image") };
        let (mut missing, mut content) = (0, Writer::default());
        let mut made = std::mem::take(&mut self.made);
        for number in objects.of_kind(Kind::Depth).map(|entry| entry.number) {
            let id = KeyframeId(number);
            if objects.entry(view, number).is_none() {
                return Err(format!("keyframe {number} has no {named}"));
            }
            let Some(pose) = poses.get(&id) else {
                (missing, whole) = (missing + 1, false);
                continue;
            };
            let wanted = only.is_none_or(|only| only.contains(&id));
            let parts = objects.parts(view, number).filter(|_| wanted);
            let known = made.remove(&id).filter(|(known, _)| Some(*known) == parts);
            let found = match (parts, known) {
                (Some(_), Some(known)) => Some(known),
                // An object that went missing or was damaged since it was seen comes again.
                (Some(parts), None) => self.keyframe(id, parts, &info, &objects)?.map(|made| (parts, made)),
                (None, _) => None,
            };
            whole &= found.as_ref().is_some_and(|(parts, _)| objects.is_exact(number, parts));
            missing += usize::from(found.is_none());
            let found = match found {
                Some((parts, keyframe)) => Some((Some(parts), keyframe)),
                None => self.placeholder(id, &objects, &blank)?.map(|keyframe| (None, keyframe)),
            };
            let Some((parts, keyframe)) = found else { continue };
            let placed = Keyframe { world_from_keyframe: *pose, ..keyframe.clone() };
            note(&mut content, &placed, parts);
            if let Some(parts) = parts {
                self.made.insert(id, (parts, keyframe));
            }
            map.keyframes.insert(id, placed);
        }
        if !whole {
            map.drop_dangling();
            if !is_lidar {
                self.join(&mut map);
            }
        }
        map.check()?;
        map.edges.iter().for_each(|edge| note_edge(&mut content, edge));
        Ok(Some(Assembled { map, missing, whole, content: ObjectHash::of(&content.0) }))
    }

    /// A keyframe of its parts, at the world's origin; `None` when one of them is not here any more.
    fn keyframe(
        &mut self,
        id: KeyframeId,
        parts: Parts,
        info: &AgentInfo,
        objects: &Listed,
    ) -> Result<Option<Keyframe>, String> {
        let bytes = |hash: &ObjectHash| objects.store.get(hash);
        let (Some(view), Some(coded)) = (bytes(&parts.view.hash), bytes(&parts.depth.hash)) else {
            return Ok(None);
        };
        let keyframe = match (info.camera(), parts.depth.kind) {
            (None, _) => {
                let (of, scan) = scan_from_bytes(&view)?;
                if of != id {
                    return Err(format!("the scan of keyframe {} is listed as that of {}", of.0, id.0));
                }
                time_from_bytes(&coded, Arc::new(scan), info)?
            }
            (Some(camera), Kind::LossyDepth) => {
                let picture = picture(&view, parts.view.kind, camera)?;
                let Some(digest) = self.digest(id, objects)? else { return Ok(None) };
                let (time, frame) = (digest.timestamp, digest.frame_index);
                let semi_dense = depth::decode(&coded, camera)?.into();
                Keyframe { semi_dense, ..Keyframe::of_image(id, time, frame, Sim3::identity(), picture) }
            }
            (Some(camera), _) => depth_from_bytes(&coded, picture(&view, parts.view.kind, camera)?, info)?,
        };
        if keyframe.id != id {
            return Err(format!("keyframe {} says that it is keyframe {}", id.0, keyframe.id.0));
        }
        // Of what is not listed nothing lacks.
        let optional = |hash: &Option<ObjectHash>| match hash {
            Some(hash) => bytes(hash).map(Some),
            None => Some(None),
        };
        let (Some(features), Some(color)) = (optional(&parts.features), optional(&parts.color)) else {
            return Ok(None);
        };
        let color = color.map(|bytes| color_of(id, &bytes)).transpose()?.flatten();
        let features = features.map(|bytes| bytes.to_vec().into());
        Ok(Some(Keyframe { features, color, ..keyframe }))
    }

    /// A keyframe at the world's origin that has a blank image and no depth; `None` while its digest is not here.
    fn placeholder(
        &mut self,
        id: KeyframeId,
        objects: &Listed,
        blank: &Arc<GrayImage>,
    ) -> Result<Option<Keyframe>, String> {
        let Some(digest) = self.digest(id, objects)? else { return Ok(None) };
        let (time, frame) = (digest.timestamp, digest.frame_index);
        Ok(Some(Keyframe::of_image(id, time, frame, Sim3::identity(), Arc::clone(blank))))
    }

    /// What is told of a keyframe first; `None` while it is not there.
    fn digest(&mut self, id: KeyframeId, objects: &Listed) -> Result<Option<&Digest>, String> {
        let Some(entry) = objects.entry(Kind::Digest, id.0) else { return Ok(None) };
        if self.digests.get(&id).is_none_or(|(hash, _)| *hash != entry.hash) {
            let Some(bytes) = objects.store.get(&entry.hash) else { return Ok(None) };
            let digest = Digest::from_bytes(&bytes, id, &Vocabulary::shipped())
                .map_err(|what| format!("a digest cannot be read: {what}"))?;
            self.digests.insert(id, (entry.hash, digest));
        }
        Ok(self.digests.get(&id).map(|(_, digest)| digest))
    }

    /// Adds edges between keyframes that share one and of which it is not there yet: as their poses have them.
    fn join(&self, map: &mut Map) {
        let known: BTreeSet<[KeyframeId; 2]> =
            map.edges.iter().map(|edge| [edge.from.min(edge.to), edge.from.max(edge.to)]).collect();
        let mut before = None;
        let mut edges = Vec::new();
        for (id, keyframe) in &map.keyframes {
            let linked_ids = self.digests.get(id).map_or(&[][..], |(_, digest)| &digest.linked);
            let linked = linked_ids.iter().copied().filter(|other| map.keyframes.contains_key(other));
            // Of one that has no earlier neighbour here its predecessor: nothing else would hold it.
            let mut linked: Vec<KeyframeId> = linked.collect();
            if linked.is_empty() {
                linked.extend(before);
            }
            for other in linked.into_iter().filter(|other| !known.contains(&[*other, *id])) {
                edges.extend(map.keyframes.get(&other).map(|other| edge(other, keyframe)));
            }
            before = Some(*id);
        }
        map.edges.extend(edges);
    }
}

/// An edge between two keyframes of a map as their poses have it.
fn edge(from: &Keyframe, to: &Keyframe) -> Edge {
    let [translation, rotation, scale] = DRIFT;
    let from_from_to = from.world_from_keyframe.inverse() * to.world_from_keyframe;
    // Where a camera only turned, as much as for a way of one of its units.
    let distance = from_from_to.translation.norm();
    let translation = translation * if distance > 0.0 { distance } else { 1.0 };
    Edge::odometry(from, to, [translation, rotation, scale])
}

/// The colours of a keyframe of their bytes.
fn color_of(id: KeyframeId, bytes: &[u8]) -> Result<Option<Color>, String> {
    match color_from_bytes(bytes)? {
        (of, color) if of == id => Ok(color),
        (of, _) => Err(format!("the colours of keyframe {} are listed as those of {}", of.0, id.0)),
    }
}

/// An image of its bytes.
fn picture(bytes: &[u8], kind: Kind, camera: &Pinhole) -> Result<Arc<GrayImage>, String> {
    let picture = match kind {
        Kind::LossyImage => image::decode(bytes, camera)?,
        _ => image_from_bytes(bytes, camera)?,
    };
    Ok(Arc::new(picture))
}

/// Notes what merging looks at of a keyframe.
fn note(content: &mut Writer, keyframe: &Keyframe, parts: Option<Parts>) {
    content.u32(keyframe.id.0);
    let pose = &keyframe.world_from_keyframe;
    let rotation = pose.rotation.coords;
    let numbers = pose.translation.iter().chain(rotation.iter()).chain([&pose.scale]);
    numbers.for_each(|number| content.u64(number.to_bits()));
    if let Some(parts) = parts {
        [Some(parts.view.hash), Some(parts.depth.hash), parts.features]
            .into_iter()
            .flatten()
            .for_each(|hash| content.bytes(&hash.0));
    }
}

/// Notes what merging looks at of an edge.
fn note_edge(content: &mut Writer, edge: &Edge) {
    content.u32(edge.from.0);
    content.u32(edge.to.0);
    let numbers = edge.from_from_to.log();
    numbers.iter().chain(edge.information.iter()).for_each(|number| content.u64(number.to_bits()));
}

/// What is listed, and where it is if it is here.
struct Listed<'a> {
    listed: BTreeMap<(Kind, u32), Entry>,
    store: &'a dyn Objects,
}

impl<'a> Listed<'a> {
    fn new(entries: &[Entry], store: &'a dyn Objects) -> Self {
        let listed = entries.iter().map(|entry| ((entry.kind, entry.number), *entry)).collect();
        Self { listed, store }
    }

    fn of_kind(&self, kind: Kind) -> impl Iterator<Item = &Entry> {
        self.listed.range((kind, 0)..=(kind, u32::MAX)).map(|(_, entry)| entry)
    }

    fn entry(&self, kind: Kind, number: u32) -> Option<Entry> {
        self.listed.get(&(kind, number)).copied()
    }

    /// What is told of the agent whose map this is; `None` while that is not here.
    fn agent(&self, identity: Identity) -> Result<Option<AgentInfo>, String> {
        let entry = self.of_kind(Kind::Agent).next();
        let Some(bytes) = entry.and_then(|entry| self.store.get(&entry.hash)) else { return Ok(None) };
        let info = agent_from_bytes(&bytes)?;
        if info.identity != Some(identity) {
            return Err("it says that it is another agent's".into());
        }
        Ok(Some(info))
    }

    /// Takes edges and frames into a map; the poses, and whether all of it is here.
    fn graph(&self, map: &mut Map) -> Result<(BTreeMap<KeyframeId, Sim3>, bool), String> {
        let (mut poses, mut whole) = (BTreeMap::new(), true);
        for entry in [Kind::Poses, Kind::Edges, Kind::Frames].into_iter().flat_map(|kind| self.of_kind(kind))
        {
            let Some(bytes) = self.store.get(&entry.hash) else {
                whole = false;
                continue;
            };
            let part = graph_from_bytes(&bytes)?;
            poses.extend(part.poses);
            map.edges.extend(part.edges);
            map.frames.extend(part.frames);
        }
        Ok((poses, whole))
    }

    /// Whether these parts of a keyframe are all of it, bit by bit.
    fn is_exact(&self, number: u32, parts: &Parts) -> bool {
        let has_colors = parts.color.is_some() || self.entry(Kind::Color, number).is_none();
        has_colors && !parts.view.kind.is_preview() && !parts.depth.kind.is_preview()
    }

    /// What a keyframe can be made of by now: of image and depth the exact one, else what stands in for it. Features
    /// come first, and where there are none yet there is nothing to recognise the keyframe by. `view` is what it is to have,
    /// an image or a scan.
    fn parts(&self, view: Kind, number: u32) -> Option<Parts> {
        let here = |kind: Kind| self.entry(kind, number).filter(|entry| self.store.has(&entry.hash));
        let features = match self.entry(Kind::Features, number) {
            Some(_) => Some(here(Kind::Features)?.hash),
            None => None,
        };
        let lossy_image = || here(Kind::LossyImage).filter(|_| view == Kind::Image);
        let view = here(view).or_else(lossy_image)?;
        // What stands in for a depth has no time of its own.
        let lossy = || here(Kind::Digest).and_then(|_| here(Kind::LossyDepth));
        let depth = here(Kind::Depth).or_else(lossy)?;
        let color = here(Kind::Color).map(|entry| entry.hash);
        Some(Parts { view, depth, features, color })
    }
}
