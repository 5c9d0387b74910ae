//! From the tracker to the watcher: the tracker leaves what is new in a slot and goes on; the watcher takes it
//! when it gets to it.

use super::Neighbourhood;
use super::status::{Facts, FoundBreak};
use crate::report::scene::kind_number;
use geometry::{GrayImage, Se3, Sim3};
use map::{Color, Edge, EdgeKind, FramePose, Keyframe, KeyframeId, Map, MapDelta, SemiDense, Shared};
use std::collections::BTreeMap;
use std::sync::Arc;

/// What the watcher has not taken yet.
#[derive(Default)]
pub struct Pending {
    /// The newest image that was wanted.
    pub picture: Option<LiveImage>,
    /// The newest frame's facts.
    pub facts: Option<Facts>,
    /// How often tracking was lost, and frames taken, since the watcher last looked.
    pub taken: u64,
    /// How many of these were tracked.
    pub tracked: u64,
    /// How often tracking was lost since then.
    pub lost: u64,
    /// Where the scale was not carried on, as was found since then.
    pub scale_breaks: Vec<FoundBreak>,
    /// Keyframes that are new or were moved.
    pub keyframes: BTreeMap<KeyframeId, Pose>,
    /// Depths that became known.
    pub depths: Vec<Depth>,
    /// Frames that are new.
    pub frames: Vec<FramePose>,
    /// Loops closed: newer and older keyframe.
    pub loops: Vec<[u32; 2]>,
    /// Edges of the whole map, `from, to, kind`.
    pub edges: Option<Vec<[u32; 3]>>,
    /// The map was given up since then, before all the rest of this.
    pub anew: bool,
    /// So was the whole run, with what was found of it.
    pub restarted: bool,
    /// What to tell the user.
    pub note: Option<String>,
    /// Whether the run is paused, when that changed.
    pub paused: Option<bool>,
    /// Whether frames are being recorded, when that changed.
    pub recording: Option<bool>,
    /// The folder of results, when that changed.
    pub folder: Option<String>,
    /// Who is near, when that changed.
    pub neighbourhood: Option<Neighbourhood>,
    /// The report is there.
    pub report: bool,
    /// The run has ended, and nothing comes after this.
    pub ended: bool,
}

/// An image as it was tracked.
pub struct LiveImage {
    /// Index of the frame in the recording.
    pub frame_index: u64,
    /// Its time stamp, seconds.
    pub timestamp: f64,
    /// The image.
    pub image: GrayImage,
    /// Where its camera is, where known.
    pub world_from_camera: Option<Se3>,
}

/// A keyframe's pose.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// The keyframe.
    pub id: KeyframeId,
    /// Index of its image in the recording.
    pub frame_index: u64,
    /// Its pose; the scale is its unit, in which its depth is.
    pub world_from_keyframe: Sim3,
}

/// A keyframe's depth.
pub struct Depth {
    /// The keyframe.
    pub id: KeyframeId,
    /// Its image.
    pub image: Arc<GrayImage>,
    /// The colours of the image.
    pub color: Option<Color>,
    /// Its depth.
    pub semi_dense: Shared<SemiDense>,
}

/// Hands on what is said of a map. It lives with the tracker.
#[derive(Default)]
pub struct Gatherer {
    /// The watcher has been told of the map.
    begun: bool,
    /// Frames handed on.
    frames: usize,
}

impl Gatherer {
    /// Adds to `pending` what was said of the map, which is as the last delta left it.
    pub fn gather(&mut self, deltas: &[MapDelta], map: &Map, pending: &mut Pending) {
        let is_other = map.frames.len() < self.frames || deltas.iter().any(|delta| delta.sequence == 0);
        if is_other || deltas.iter().any(|delta| !delta.removed.is_empty()) {
            pending.anew |= self.begun;
            *self = Self::default();
            // What waits is of the map that is no more.
            (pending.keyframes, pending.frames, pending.edges) = Default::default();
            pending.depths.clear();
            pending.loops.clear();
        }
        if self.begun {
            deltas.iter().for_each(|delta| hand_on(delta, map, pending));
        } else {
            self.begun = !map.keyframes.is_empty();
            map.keyframes.values().for_each(|keyframe| hand_on_keyframe(keyframe, pending));
            let edges = deltas.iter().rev().find_map(|delta| delta.edges.as_ref());
            pending.edges = edges.map(|edges| loops_of(edges)).or(pending.edges.take());
        }
        pending.frames.extend_from_slice(&map.frames[self.frames..]);
        self.frames = map.frames.len();
    }
}

/// Hands on what a delta says.
fn hand_on(delta: &MapDelta, map: &Map, pending: &mut Pending) {
    delta.added.iter().for_each(|keyframe| hand_on_keyframe(keyframe, pending));
    for moved in &delta.moved {
        if let Some(keyframe) = map.keyframes.get(&moved.keyframe) {
            pending.keyframes.insert(moved.keyframe, Pose::of(keyframe));
        }
    }
    for settled in &delta.settled {
        if let Some(keyframe) = map.keyframes.get(&settled.keyframe) {
            hand_on_depth(keyframe, pending);
        }
    }
    pending.edges = delta.edges.as_ref().map(|edges| loops_of(edges)).or(pending.edges.take());
}

fn hand_on_keyframe(keyframe: &Keyframe, pending: &mut Pending) {
    pending.keyframes.insert(keyframe.id, Pose::of(keyframe));
    if !keyframe.semi_dense.is_empty() {
        hand_on_depth(keyframe, pending);
    }
}

fn hand_on_depth(keyframe: &Keyframe, pending: &mut Pending) {
    let (image, semi_dense) = (Arc::clone(&keyframe.image), keyframe.semi_dense.clone());
    pending.depths.retain(|depth| depth.id != keyframe.id);
    let color = keyframe.color.clone();
    pending.depths.push(Depth { id: keyframe.id, image, color, semi_dense });
}

/// The edges that viewers see, loops and merges, as `from, to, kind`.
pub fn loops_of(edges: &[Edge]) -> Vec<[u32; 3]> {
    let says = |edge: &&Edge| matches!(edge.kind, EdgeKind::Loop | EdgeKind::Merge);
    let numbers = |edge: &Edge| [edge.from.0, edge.to.0, kind_number(edge.kind)];
    edges.iter().filter(says).map(numbers).collect()
}

impl Pose {
    fn of(keyframe: &Keyframe) -> Self {
        let Keyframe { id, frame_index, world_from_keyframe, .. } = *keyframe;
        Self { id, frame_index, world_from_keyframe }
    }
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::{CAMERA, dense};
    use super::*;
    use map::{Moved, Settled};

    fn keyframe(id: u32) -> Keyframe {
        let image = Arc::new(dense().0);
        Keyframe::of_image(KeyframeId(id), f64::from(id), u64::from(id), Sim3::identity(), image)
    }

    /// A map and who hears of it.
    struct Case {
        map: Map,
        gatherer: Gatherer,
        sent: u64,
    }

    impl Case {
        fn new() -> Self {
            Self { map: Map::new(CAMERA), gatherer: Gatherer::default(), sent: 0 }
        }

        /// A frame, with what changes at it.
        fn apply(&mut self, delta: MapDelta) -> Pending {
            let frame_index = self.map.frames.len() as u64;
            self.map.frames.push(FramePose {
                timestamp: frame_index as f64,
                frame_index,
                reference: KeyframeId(0),
                keyframe_from_frame: Se3::identity(),
            });
            let deltas =
                if delta.is_empty() { vec![] } else { vec![MapDelta { sequence: self.sent, ..delta }] };
            self.sent += deltas.len() as u64;
            deltas.iter().for_each(|delta| self.map.take_in(delta.clone()));
            self.gather(&deltas)
        }

        fn gather(&mut self, deltas: &[MapDelta]) -> Pending {
            let mut pending = Pending::default();
            self.gatherer.gather(deltas, &self.map, &mut pending);
            pending
        }
    }

    fn added(ids: impl IntoIterator<Item = u32>) -> MapDelta {
        MapDelta { added: ids.into_iter().map(keyframe).collect(), ..MapDelta::default() }
    }

    fn settled(id: u32) -> Vec<Settled> {
        vec![Settled { keyframe: KeyframeId(id), semi_dense: dense().1.into(), points: Vec::new() }]
    }

    /// Who is told of: keyframes, depths, frames.
    fn announced(pending: &Pending) -> (Vec<u32>, Vec<u32>, usize) {
        let keyframes = pending.keyframes.keys().map(|id| id.0).collect();
        (keyframes, pending.depths.iter().map(|depth| depth.id.0).collect(), pending.frames.len())
    }

    #[test]
    fn deltas_are_forwarded_and_nothing_else() {
        let mut case = Case::new();
        assert_eq!(announced(&case.apply(added([0, 1]))), (vec![0, 1], vec![], 1));
        assert_eq!(announced(&case.apply(MapDelta::default())), (vec![], vec![], 1));
        let mut pose = Sim3::identity();
        pose.scale = 2.0;
        let moved = vec![Moved { keyframe: KeyframeId(0), world_from_keyframe: pose }];
        let pending = case.apply(MapDelta { moved, settled: settled(1), ..added([2]) });
        assert_eq!(announced(&pending), (vec![0, 2], vec![1], 1));
        assert_eq!(pending.keyframes[&KeyframeId(0)].world_from_keyframe.scale, 2.0);
        assert!(!pending.anew && pending.edges.is_none());
        let edges = Some(Vec::new());
        assert_eq!(case.apply(MapDelta { edges, ..MapDelta::default() }).edges, Some(Vec::new()));
    }

    #[test]
    fn a_late_viewer_or_one_that_loses_a_keyframe_gets_the_whole_map() {
        let mut case = Case::new();
        case.apply(added([0, 1, 2]));
        case.apply(MapDelta { settled: settled(1), ..MapDelta::default() });
        case.gatherer = Gatherer::default();
        assert_eq!(announced(&case.gather(&[])), (vec![0, 1, 2], vec![1], 2));
        let removed = vec![KeyframeId(2)];
        let pending = case.apply(MapDelta { removed, ..MapDelta::default() });
        assert!(pending.anew);
        assert_eq!(announced(&pending), (vec![0, 1], vec![1], 3));
    }

    #[test]
    fn a_map_given_up_is_begun_anew() {
        let mut case = Case::new();
        case.apply(added([0, 1, 2]));
        (case.map, case.sent) = (Map::new(CAMERA), 0);
        assert!(case.gather(&[]).anew);
        let pending = case.apply(added([0]));
        assert!(!pending.anew);
        assert_eq!(announced(&pending), (vec![0], vec![], 1));
    }
}
