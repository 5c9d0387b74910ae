//! From the run to the thread that publishes: what is new is left in a slot, and taken when that thread gets to it.

use super::health::Health;
use crate::listeners::{MapListener, ProcessedFrame};
use geometry::sensor::Shift;
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use map::{AgentInfo, FramePose, Identity, Keyframe, KeyframeId, Map, MapDelta, SemiDense, Shared};
use nalgebra::Matrix6;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use view::slot::Slot;

/// Poses that wait at the most: those of half a minute.
const MAX_POSES: usize = 1000;

/// What was not published yet.
#[derive(Default)]
pub(super) struct Pending {
    /// Who maps, once that is known.
    pub about: Option<AgentInfo>,
    /// Poses of frames in order.
    pub poses: VecDeque<Tracked>,
    /// Poses that came when too many waited.
    pub dropped: u64,
    /// What follows is of another map than before, or of the same with fewer keyframes.
    pub anew: bool,
    /// Keyframes that are new or were moved, with their units.
    pub moved: BTreeMap<KeyframeId, Sim3>,
    /// Keyframes whose depth is new.
    pub depths: BTreeMap<KeyframeId, Depth>,
    /// How the tracking goes, if a frame came.
    pub health: Option<Health>,
    /// Which of the run's worlds keyframes are in, from 0.
    pub world: usize,
    /// Nothing comes after this.
    pub ended: bool,
}

/// A frame that has a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tracked {
    /// Seconds.
    pub timestamp: f64,
    /// Which of the run's worlds it is in, from 0.
    pub world: usize,
    /// Its pose.
    pub world_from_camera: Se3,
    /// Covariance of that, in the axes of the camera.
    pub covariance: Option<Matrix6<f64>>,
    /// The pose of the frame before it that had one, as it is known now; `None` where that was in another world.
    pub world_from_before: Option<Se3>,
}

/// The depth of a keyframe.
pub(super) struct Depth {
    /// Seconds.
    pub timestamp: f64,
    pub image: Arc<GrayImage>,
    pub semi_dense: Shared<SemiDense>,
    pub camera: Pinhole,
    pub shift: Shift,
}

/// Follows a run, and leaves in the slot what is new. It does no work but to copy what little is not shared.
pub struct Follower {
    slot: Arc<Slot<Pending>>,
    /// The worlds of the run so far, in the order they were first seen.
    worlds: Vec<Identity>,
    /// The world whose map was handed on.
    current: Option<usize>,
    /// The frame before that had a pose, and its world.
    before: Option<(usize, FramePose)>,
    /// How the tracking goes.
    health: Health,
}

impl Follower {
    pub(super) fn new(slot: Arc<Slot<Pending>>) -> Self {
        Self { slot, worlds: Vec::new(), current: None, before: None, health: Health::default() }
    }

    /// The number of a world.
    fn world(&mut self, agent: Identity) -> usize {
        self.worlds.iter().position(|known| *known == agent).unwrap_or_else(|| {
            self.worlds.push(agent);
            self.worlds.len() - 1
        })
    }

    /// Where the frame is, if it has a pose.
    fn tracked(&mut self, seen: &ProcessedFrame<'_>, world: usize) -> Option<Tracked> {
        let world_from_camera = seen.world_from_camera?;
        let before = self.before.filter(|(of, _)| *of == world);
        let world_from_before =
            before.and_then(|(_, frame)| seen.map.world_from_frame(&frame)).map(|pose| pose.rigid());
        // The map has the newest frame last.
        self.before = seen.map.frames.last().map(|frame| (world, *frame));
        let (timestamp, covariance) = (seen.timestamp, seen.covariance);
        Some(Tracked { timestamp, world, world_from_camera, covariance, world_from_before })
    }
}

impl MapListener for Follower {
    fn begins(&mut self, about: &AgentInfo) {
        self.slot.leave(|pending| pending.about = Some(about.clone()));
    }

    fn changed(&mut self, _: Identity, _: Vec<MapDelta>) {
        // `processed` has it, and in runs that only localise as well.
    }

    fn processed(&mut self, seen: &ProcessedFrame<'_>) {
        let world = self.world(seen.agent);
        let tracked = self.tracked(seen, world);
        let is_other = self.current != Some(world) || seen.deltas.iter().any(|delta| delta.sequence == 0);
        let anew = is_other || seen.deltas.iter().any(|delta| !delta.removed.is_empty());
        self.current = Some(world);
        self.health.add(seen);
        self.slot.leave(|pending| {
            pending.health = Some(self.health.clone());
            if anew {
                pending.begin(world);
                seen.map.keyframes.values().for_each(|keyframe| pending.hand_on(keyframe, seen.map));
            }
            for delta in seen.deltas {
                let moved = delta.moved.iter().map(|moved| moved.keyframe);
                for id in moved.chain(delta.added.iter().map(|keyframe| keyframe.id)) {
                    if let Some(keyframe) = seen.map.keyframes.get(&id) {
                        pending.moved.insert(id, keyframe.world_from_keyframe);
                    }
                }
                for settled in &delta.settled {
                    if let Some(keyframe) = seen.map.keyframes.get(&settled.keyframe) {
                        pending.hand_on(keyframe, seen.map);
                    }
                }
            }
            if pending.poses.len() >= MAX_POSES && tracked.is_some() {
                pending.poses.pop_front();
                pending.dropped += 1;
            }
            pending.poses.extend(tracked);
        });
    }

    fn ended(&mut self, maps: &[Map]) {
        // Maps that were joined at the end are in a world of their own, in which nobody was told to be.
        let own = |map: &&Map| map.agents.len() == 1 && map.agents.values().any(|a| a.identity.is_some());
        let Some(map) = maps.first().filter(own) else { return };
        let Some(identity) = map.agents.values().find_map(|agent| agent.identity) else { return };
        let world = self.world(identity);
        self.slot.leave(|pending| {
            if self.current != Some(world) {
                pending.begin(world);
            }
            map.keyframes.values().for_each(|keyframe| pending.hand_on(keyframe, map));
        });
        self.current = Some(world);
    }
}

impl Pending {
    /// Takes what was left; the number of the world stays.
    pub fn taken(&mut self) -> Self {
        let world = self.world;
        std::mem::replace(self, Self { world, ..Self::default() })
    }

    /// Forgets what waits of another map.
    fn begin(&mut self, world: usize) {
        (self.anew, self.world) = (true, world);
        self.moved.clear();
        self.depths.clear();
    }

    /// Hands on where a keyframe is and what depth it has.
    fn hand_on(&mut self, keyframe: &Keyframe, map: &Map) {
        self.moved.insert(keyframe.id, keyframe.world_from_keyframe);
        let (Some(camera), Some(shift)) = (map.camera_of(keyframe), map.image_shift(keyframe)) else {
            return;
        };
        if keyframe.semi_dense.is_empty() {
            return;
        }
        let depth = Depth {
            timestamp: keyframe.timestamp,
            image: Arc::clone(&keyframe.image),
            semi_dense: keyframe.semi_dense.clone(),
            camera: *camera,
            shift,
        };
        self.depths.insert(keyframe.id, depth);
    }
}
