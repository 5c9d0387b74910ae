//! From the tracker to the watcher: the tracker leaves what is new in a slot and goes on; the watcher takes it
//! when it gets to it.

use super::status::Facts;
use geometry::{GrayImage, Se3, Sim3};
use map::{FramePose, Keyframe, KeyframeId, Map, SemiDense, Shared};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Keyframes that the optimisation of recent ones may still change; closed loops move all.
const RECENT_KEYFRAMES: usize = 60;
/// Frames that it may still change.
const RECENT_FRAMES: usize = 2000;

/// What the watcher has not taken yet.
#[derive(Default)]
pub struct Pending {
    /// The newest image that was wanted.
    pub picture: Option<LiveImage>,
    /// The newest frame's facts.
    pub facts: Option<Facts>,
    /// How often tracking was lost, and frames taken, since the watcher last looked.
    pub taken: u64,
    /// How often tracking was lost since then.
    pub lost: u64,
    /// Where all keyframes are.
    pub keyframes: Option<Vec<Pose>>,
    /// Depths that became known or were measured anew.
    pub depths: Vec<Depth>,
    /// The frames from this one on.
    pub frames: Option<(usize, Vec<FramePose>)>,
    /// Loops closed: newer and older keyframe.
    pub loops: Vec<[u32; 2]>,
    /// Edges of the whole map, `from, to, kind`.
    pub edges: Option<Vec<[u32; 3]>>,
    /// The map was given up since then, before all the rest of this.
    pub anew: bool,
    /// What to tell the user.
    pub note: Option<String>,
    /// Whether the run is paused, when that changed.
    pub paused: Option<bool>,
    /// Whether frames are being recorded, when that changed.
    pub recording: Option<bool>,
    /// The folder of results, when that changed.
    pub folder: Option<String>,
    /// The run has ended, and nothing comes after this.
    pub ended: bool,
    /// Nothing was left since the watcher last took it.
    pub(super) fresh: bool,
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
    /// Its pose, the scale as of its points when they were handed over.
    pub world_from_keyframe: Sim3,
}

/// A keyframe's depth.
pub struct Depth {
    /// The keyframe.
    pub id: KeyframeId,
    /// Its image.
    pub image: Arc<GrayImage>,
    /// Its depth.
    pub semi_dense: Shared<SemiDense>,
}

/// Where the tracker leaves what is new.
#[derive(Default)]
pub struct Slot {
    pending: Mutex<Pending>,
    left: Condvar,
}

impl Slot {
    /// The slot, to leave something in it.
    pub fn open(&self) -> MutexGuard<'_, Pending> {
        // Every section leaves it whole, so a panic elsewhere does not spoil it.
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Leaves something and wakes the watcher.
    pub fn leave(&self, change: impl FnOnce(&mut Pending)) {
        let mut pending = self.open();
        change(&mut pending);
        pending.fresh = true;
        drop(pending);
        self.left.notify_one();
    }

    /// Takes what was left; waits for it, at most so long.
    pub fn take(&self, patience: Duration) -> Pending {
        let guard = self.open();
        let waited = self.left.wait_timeout_while(guard, patience, |pending| !pending.fresh);
        std::mem::take(&mut *waited.unwrap_or_else(PoisonError::into_inner).0)
    }
}

/// Tells what of a map the watcher does not have yet. It lives with the tracker.
#[derive(Default)]
pub struct Gatherer {
    handed: BTreeMap<KeyframeId, Handed>,
    last: Option<KeyframeId>,
    frames: usize,
    last_frame: Option<u64>,
}

/// How a keyframe's depth was when it was handed over, so that a change of its unit is told from new depth.
struct Handed {
    frame_index: u64,
    mark: Mark,
    unit: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Mark {
    len: usize,
    samples: [(u32, f32); 3],
}

impl Mark {
    fn of(depth: &SemiDense) -> Option<Self> {
        let last = depth.len().checked_sub(1)?;
        let at = |i: usize| (depth.pixel[i], depth.inverse_depth[i]);
        Some(Self { len: depth.len(), samples: [at(0), at(last / 2), at(last)] })
    }

    /// How many times longer lengths are now, if that is all that changed.
    fn growth(&self, now: &Self) -> Option<f64> {
        let ratio = |i: usize| f64::from(self.samples[i].1) / f64::from(now.samples[i].1);
        let alike =
            |i: usize| self.samples[i].0 == now.samples[i].0 && ((ratio(i) / ratio(0)).ln().abs() < 1e-4);
        (self.len == now.len && (0..3).all(alike)).then(|| ratio(0))
    }
}

impl Gatherer {
    /// Adds to `pending` what is new in the map; all of it is looked through where `everything` may have moved.
    pub fn gather(&mut self, map: &Map, everything: bool, pending: &mut Pending) {
        let newest = map.keyframes.keys().next_back().copied();
        if newest < self.last || self.replaced(map) {
            *self = Self::default();
            // What waits is of the map that is no more.
            (pending.keyframes, pending.frames, pending.edges) = (None, None, None);
            pending.depths.clear();
            pending.loops.clear();
            pending.anew = true;
        }
        let keyframe_event = newest != self.last || everything;
        self.last = newest;
        if keyframe_event {
            let first = if everything { 0 } else { map.keyframes.len().saturating_sub(RECENT_KEYFRAMES) };
            for keyframe in map.keyframes.values().skip(first) {
                self.examine(keyframe, pending);
            }
            pending.keyframes = Some(map.keyframes.values().map(|keyframe| self.pose(keyframe)).collect());
        }
        self.gather_frames(map, keyframe_event, everything, pending);
    }

    /// Whether the first keyframe is another's than it was.
    fn replaced(&self, map: &Map) -> bool {
        let differs = |(id, handed): (&KeyframeId, &Handed)| {
            map.keyframes.get(id).is_none_or(|keyframe| keyframe.frame_index != handed.frame_index)
        };
        self.handed.iter().next().is_some_and(differs)
    }

    /// Hands a keyframe's depth over if it is new, and learns its unit.
    fn examine(&mut self, keyframe: &Keyframe, pending: &mut Pending) {
        let Some(mark) = Mark::of(&keyframe.semi_dense) else { return };
        if let Some(handed) = self.handed.get_mut(&keyframe.id)
            && let Some(growth) = handed.mark.growth(&mark)
        {
            handed.unit = growth;
            return;
        }
        let frame_index = keyframe.frame_index;
        self.handed.insert(keyframe.id, Handed { frame_index, mark, unit: 1.0 });
        let (image, semi_dense) = (Arc::clone(&keyframe.image), keyframe.semi_dense.clone());
        pending.depths.retain(|depth| depth.id != keyframe.id);
        pending.depths.push(Depth { id: keyframe.id, image, semi_dense });
    }

    fn pose(&self, keyframe: &Keyframe) -> Pose {
        let mut world_from_keyframe = keyframe.world_from_keyframe;
        world_from_keyframe.scale *= self.handed.get(&keyframe.id).map_or(1.0, |handed| handed.unit);
        Pose { id: keyframe.id, frame_index: keyframe.frame_index, world_from_keyframe }
    }

    fn gather_frames(&mut self, map: &Map, event: bool, everything: bool, pending: &mut Pending) {
        let count = map.frames.len();
        let appended = self.frames == 0
            || map.frames.get(self.frames - 1).map(|frame| frame.frame_index) == self.last_frame;
        let from = match (appended && !everything, event) {
            (false, _) => 0,
            (true, true) => self.frames.min(count.saturating_sub(RECENT_FRAMES)),
            (true, false) => self.frames,
        };
        self.frames = count;
        self.last_frame = map.frames.last().map(|frame| frame.frame_index);
        if from >= count {
            return;
        }
        match &mut pending.frames {
            Some((first, waiting)) if *first <= from && from - *first <= waiting.len() => {
                waiting.truncate(from - *first);
                waiting.extend_from_slice(&map.frames[from..]);
            }
            waiting => *waiting = Some((from, map.frames[from..].to_vec())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::chunk::tests::{CAMERA, dense};
    use super::*;
    use map::AgentId;

    fn map(keyframes: u32) -> Map {
        let mut map = Map::new(CAMERA);
        (0..keyframes).for_each(|id| extend(&mut map, id));
        map
    }

    fn extend(map: &mut Map, id: u32) {
        let (image, semi_dense) = dense();
        let keyframe = Keyframe {
            id: KeyframeId(id),
            agent: AgentId::default(),
            timestamp: f64::from(id),
            frame_index: u64::from(id),
            world_from_keyframe: Sim3::identity(),
            image: Arc::new(image),
            scan: None,
            semi_dense: semi_dense.into(),
            points: Vec::new(),
            features: None,
        };
        map.keyframes.insert(KeyframeId(id), keyframe);
        map.frames.push(FramePose {
            timestamp: f64::from(id),
            frame_index: u64::from(id),
            reference: KeyframeId(id),
            keyframe_from_frame: Se3::identity(),
        });
    }

    fn gathered(gatherer: &mut Gatherer, map: &Map, everything: bool) -> Pending {
        let mut pending = Pending::default();
        gatherer.gather(map, everything, &mut pending);
        pending
    }

    #[test]
    fn depth_is_handed_over_once_and_a_change_of_unit_is_only_a_scale() {
        let mut map = map(3);
        let mut gatherer = Gatherer::default();
        let first = gathered(&mut gatherer, &map, false);
        assert_eq!(first.depths.len(), 3);
        assert_eq!(first.frames.map(|(from, frames)| (from, frames.len())), Some((0, 3)));
        let depth = &mut map.keyframes.get_mut(&KeyframeId(1)).expect("there are three").semi_dense;
        depth.inverse_depth.iter_mut().for_each(|d| *d /= 2.0);
        depth.variance.iter_mut().for_each(|v| *v /= 4.0);
        let moved = gathered(&mut gatherer, &map, true);
        assert!(moved.depths.is_empty());
        let scales: Vec<f64> = moved
            .keyframes
            .expect("all were looked through")
            .iter()
            .map(|k| k.world_from_keyframe.scale)
            .collect();
        assert!((scales[1] - 2.0).abs() < 1e-6 && scales[0] == 1.0, "{scales:?}");
        map.keyframes.get_mut(&KeyframeId(2)).expect("there are three").semi_dense.inverse_depth[0] *= 1.3;
        assert_eq!(gathered(&mut gatherer, &map, true).depths.len(), 1);
    }

    #[test]
    fn between_keyframes_only_new_frames_are_handed_over() {
        let mut map = map(2);
        let mut gatherer = Gatherer::default();
        gathered(&mut gatherer, &map, false);
        let mut frame = map.frames[1];
        frame.frame_index = 2;
        map.frames.push(frame);
        let pending = gathered(&mut gatherer, &map, false);
        assert!(pending.keyframes.is_none());
        assert_eq!(pending.frames.map(|(from, frames)| (from, frames.len())), Some((2, 1)));
    }

    #[test]
    fn a_map_given_up_is_begun_anew() {
        let mut gatherer = Gatherer::default();
        gathered(&mut gatherer, &map(3), false);
        let mut second = Map::new(CAMERA);
        assert!(gathered(&mut gatherer, &second, false).anew);
        extend(&mut second, 0);
        let pending = gathered(&mut gatherer, &second, false);
        assert!(!pending.anew && pending.depths.len() == 1);
    }

    #[test]
    fn what_is_left_is_taken_once() {
        let slot = Slot::default();
        slot.leave(|pending| pending.taken += 1);
        slot.leave(|pending| pending.taken += 1);
        assert_eq!(slot.take(Duration::ZERO).taken, 2);
        assert_eq!(slot.take(Duration::ZERO).taken, 0);
    }
}
