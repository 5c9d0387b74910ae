//! Objects as the map that they are of.

use crate::hash::ObjectHash;
use crate::manifest::{Entry, Kind, Manifest, page_from_bytes};
use crate::store::Store;
use map::parts::{agent_from_bytes, depth_from_bytes, graph_from_bytes, image_from_bytes};
use map::{Identity, Keyframe, KeyframeId, Map};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A map put together of its objects.
#[derive(Clone, Debug)]
pub struct Assembled {
    /// The map: of keyframes those of which image, depth and pose are there.
    pub map: Map,
    /// Keyframes that are told of and not in the map yet.
    pub missing: usize,
    /// Whether all of the map is there: it is the agent's own, bit by bit.
    pub whole: bool,
}

/// All objects that a manifest lists; `None` while a page is not there.
///
/// # Errors
/// When a page is none, or an object is listed twice.
pub fn entries_of(manifest: &Manifest, store: &dyn Store) -> Result<Option<Vec<Entry>>, String> {
    let mut entries = BTreeMap::new();
    for page in &manifest.pages {
        let Some(bytes) = store.get(&page.hash) else { return Ok(None) };
        let page =
            page_from_bytes(&bytes).map_err(|what| format!("a list of objects cannot be read: {what}"))?;
        for entry in page {
            if entries.insert((entry.kind, entry.number), entry).is_some() {
                return Err(format!("{:?} {} is listed twice", entry.kind, entry.number));
            }
        }
    }
    Ok(Some(entries.into_values().collect()))
}

/// Puts the map of one agent together, again and again as objects come.
#[derive(Default)]
pub struct Assembler {
    /// Keyframes at the world's origin, by what they were made of: image, depth and features.
    made: BTreeMap<KeyframeId, (Parts, Keyframe)>,
}

/// Image and depth of a keyframe, and its features if it has any.
type Parts = (ObjectHash, ObjectHash, Option<ObjectHash>);

impl Assembler {
    /// The map of `agent` of the objects listed that are in the store; `None` while nothing can be told of the agent.
    ///
    /// # Errors
    /// When an object is not what it should be, or they contradict each other: whoever tells it is not to be believed.
    pub fn assemble(
        &mut self,
        agent: Identity,
        entries: &[Entry],
        store: &dyn Store,
    ) -> Result<Option<Assembled>, String> {
        let of_kind = |kind: Kind| entries.iter().filter(move |entry| entry.kind == kind);
        let mut whole = true;
        let Some(bytes) = of_kind(Kind::Agent).next().and_then(|entry| store.get(&entry.hash)) else {
            return Ok(None);
        };
        let info = agent_from_bytes(&bytes)?;
        if info.identity != Some(agent) {
            return Err("it says that it is another agent's".into());
        }
        let camera = *info.camera().ok_or("it is not of a camera")?;
        let mut map = Map::of(info.clone());
        let mut poses = BTreeMap::new();
        for entry in entries.iter().filter(|e| matches!(e.kind, Kind::Poses | Kind::Edges | Kind::Frames)) {
            let Some(bytes) = store.get(&entry.hash) else {
                whole = false;
                continue;
            };
            let part = graph_from_bytes(&bytes)?;
            poses.extend(part.poses);
            map.edges.extend(part.edges);
            map.frames.extend(part.frames);
        }
        let by_number = |kind: Kind| -> BTreeMap<u32, ObjectHash> {
            of_kind(kind).map(|entry| (entry.number, entry.hash)).collect()
        };
        let (images, features) = (by_number(Kind::Image), by_number(Kind::Features));
        let mut missing = 0;
        let mut made = std::mem::take(&mut self.made);
        for (number, depth) in by_number(Kind::Depth) {
            let id = KeyframeId(number);
            let described = features.get(&number).copied();
            let image = images.get(&number).ok_or_else(|| format!("keyframe {number} has no image"))?;
            // Features come first, and where there are none yet there is nothing to recognise the keyframe by.
            let is_there =
                [Some(*image), Some(depth), described].iter().flatten().all(|hash| store.has(hash));
            let Some(pose) = poses.get(&id).filter(|_| is_there) else {
                missing += 1;
                continue;
            };
            let parts = (*image, depth, described);
            let keyframe = match made.remove(&id).filter(|(known, _)| *known == parts) {
                Some((_, keyframe)) => keyframe,
                None => {
                    let bytes = |hash: &ObjectHash| store.get(hash).ok_or("an object is damaged");
                    let image = Arc::new(image_from_bytes(&bytes(image)?, &camera)?);
                    let read = depth_from_bytes(&bytes(&depth)?, image, &info)?;
                    if read.id != id {
                        return Err(format!("keyframe {number} says that it is keyframe {}", read.id.0));
                    }
                    let features = described.as_ref().map(bytes).transpose()?;
                    Keyframe { features: features.map(Into::into), ..read }
                }
            };
            let placed = Keyframe { world_from_keyframe: *pose, ..keyframe.clone() };
            self.made.insert(id, (parts, keyframe));
            map.keyframes.insert(id, placed);
        }
        whole &= missing == 0;
        if !whole {
            map.drop_dangling();
        }
        map.check()?;
        Ok(Some(Assembled { map, missing, whole }))
    }
}
