//! What there is to see, and what of it each sink has not seen yet.
//!
//! Everything carries the tick of its last change. A sink keeps a [`Cursor`] and takes what is newer: a slow one
//! misses intermediate states, and nothing is queued for it.

use super::chunk::Chunk;
use super::picture::Picture;
use super::status::Status;
use geometry::{Pinhole, Sim3};
use map::FramePose;
use std::collections::BTreeMap;
use std::sync::Arc;

/// One whose keyframes are shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Agent {
    /// What people call it.
    pub name: String,
    /// Its camera.
    pub camera: Pinhole,
    /// Whether a unit of its own world is a metre.
    pub metric: bool,
}

/// A keyframe in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Its name in the map.
    pub id: u32,
    /// Index of its agent.
    pub agent: u16,
    /// Index of its image in the recording.
    pub frame_index: u64,
    /// Its pose; the scale brings its chunk's unit to the world's.
    pub world_from_keyframe: Sim3,
}

/// A frame of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Index of the frame in the recording.
    pub frame_index: u64,
    /// Index of its agent.
    pub agent: u16,
    /// Seconds.
    pub timestamp: f64,
    /// Centre of the camera in the world.
    pub position: [f32; 3],
    /// World from camera, as a quaternion x, y, z, w.
    pub rotation: [f32; 4],
}

impl Step {
    /// The frame of an agent.
    pub fn new(frame: &FramePose, agent: u16, world_from_frame: &Sim3) -> Self {
        Self {
            frame_index: frame.frame_index,
            agent,
            timestamp: frame.timestamp,
            position: world_from_frame.translation.cast::<f32>().into(),
            rotation: world_from_frame.rotation.coords.cast::<f32>().into(),
        }
    }
}

struct Entry {
    placed: Placed,
    moved: u64,
    chunk: Option<(u64, Arc<Chunk>)>,
}

/// All that viewers show.
#[derive(Default)]
pub struct Scene {
    /// Whose keyframes these are.
    pub agents: Vec<Agent>,
    /// Where the run stands.
    status: (u64, Arc<Status>),
    picture: (u64, Option<Arc<Picture>>),
    /// Grows when everything begins anew.
    epoch: u64,
    tick: u64,
    keyframes: BTreeMap<u32, Entry>,
    trajectory: Vec<Step>,
    /// `(tick, first step changed)`: both ascending, so that a later change does not hide an earlier one that
    /// reached further back.
    trajectory_changes: Vec<(u64, usize)>,
    /// `from, to, kind`, as reports number the kinds.
    edges: (u64, Arc<Vec<[u32; 3]>>),
}

/// What a sink has seen.
#[derive(Clone, Debug, Default)]
pub struct Cursor {
    /// Nothing was seen at all.
    started: bool,
    epoch: u64,
    tick: u64,
    chunks: BTreeMap<u32, u64>,
}

/// What a sink has not seen.
#[derive(Default)]
pub struct SceneUpdate {
    /// Forget everything first; whose keyframes follow.
    pub reset: Option<Vec<Agent>>,
    /// The numbers.
    pub status: Option<Arc<Status>>,
    /// The newest image.
    pub picture: Option<Arc<Picture>>,
    /// Keyframes that are new or were moved.
    pub keyframes: Vec<Placed>,
    /// The trajectory from this step on.
    pub trajectory: Option<(usize, Vec<Step>)>,
    /// All edges.
    pub edges: Option<Arc<Vec<[u32; 3]>>>,
    /// Points, the newest first; more may be waiting.
    pub chunks: Vec<(Placed, Arc<Chunk>)>,
    /// Whether chunks are waiting.
    pub more: bool,
}

impl Scene {
    /// An empty scene.
    pub fn of(agents: Vec<Agent>) -> Self {
        Self { agents, ..Self::default() }
    }

    /// Sets whose keyframes these are: viewers are told all anew.
    pub fn set_agents(&mut self, agents: Vec<Agent>) {
        if self.agents != agents {
            self.agents = agents;
            self.epoch += 1;
        }
    }

    /// Begins anew: the map was given up.
    pub fn clear(&mut self) {
        self.epoch += 1;
        self.keyframes.clear();
        self.trajectory.clear();
        self.trajectory_changes.clear();
        self.edges = (self.next_tick(), Arc::default());
    }

    fn next_tick(&mut self) -> u64 {
        self.tick += 1;
        self.tick
    }

    /// Where the run stands.
    pub fn status(&self) -> &Status {
        &self.status.1
    }

    /// Sets the numbers.
    pub fn set_status(&mut self, status: Status) {
        if *self.status.1 != status {
            self.status = (self.next_tick(), Arc::new(status));
        }
    }

    /// Sets the newest image.
    pub fn set_picture(&mut self, picture: Picture) {
        self.picture = (self.next_tick(), Some(Arc::new(picture)));
    }

    /// The colours' range of the newest image.
    pub fn picture_range(&self) -> Option<[f32; 2]> {
        self.picture.1.as_ref().filter(|picture| !picture.codes.is_empty()).map(|picture| picture.range)
    }

    /// Adds or moves keyframes; says whether one was moved or added.
    pub fn place(&mut self, keyframes: impl IntoIterator<Item = Placed>) -> bool {
        let (before, tick) = (self.tick, self.next_tick());
        let mut changed = false;
        for placed in keyframes.into_iter().filter(|placed| placed.world_from_keyframe.is_valid()) {
            let entry = self.keyframes.entry(placed.id).or_insert(Entry { placed, moved: tick, chunk: None });
            if entry.placed != placed {
                (entry.placed, entry.moved) = (placed, tick);
            }
            changed |= entry.moved == tick;
        }
        if !changed {
            self.tick = before;
        }
        changed
    }

    /// Gives a keyframe its points.
    pub fn set_chunk(&mut self, id: u32, chunk: Chunk) {
        let tick = self.next_tick();
        if let Some(entry) = self.keyframes.get_mut(&id) {
            entry.chunk = Some((tick, Arc::new(chunk)));
        }
    }

    /// Replaces the trajectory from a step on.
    pub fn set_trajectory(&mut self, from: usize, steps: impl IntoIterator<Item = Step>) {
        let from = from.min(self.trajectory.len());
        self.trajectory.truncate(from);
        self.trajectory.extend(steps);
        let tick = self.next_tick();
        while self.trajectory_changes.last().is_some_and(|&(_, first)| first >= from) {
            self.trajectory_changes.pop();
        }
        self.trajectory_changes.push((tick, from));
    }

    /// Sets the edges.
    pub fn set_edges(&mut self, edges: Vec<[u32; 3]>) {
        if *self.edges.1 != edges {
            self.edges = (self.next_tick(), Arc::new(edges));
        }
    }

    /// The edges.
    pub fn edges(&self) -> Arc<Vec<[u32; 3]>> {
        Arc::clone(&self.edges.1)
    }

    /// The keyframes in order of their ids.
    pub fn keyframes(&self) -> impl Iterator<Item = (&Placed, Option<&Arc<Chunk>>)> {
        self.keyframes.values().map(|entry| (&entry.placed, entry.chunk.as_ref().map(|(_, chunk)| chunk)))
    }

    /// Points of all keyframes.
    pub fn points(&self) -> usize {
        self.keyframes().filter_map(|(_, chunk)| chunk).map(|chunk| chunk.len()).sum()
    }

    /// Up and the mean direction of view, as the keyframes tell.
    pub fn level(&self) -> [[f64; 3]; 2] {
        let poses = self.keyframes.values().map(|entry| &entry.placed.world_from_keyframe);
        let (up, forward) = map::level(poses);
        [up.into(), forward.into()]
    }

    /// What is new since the last call with this cursor; of the points at most about `point_bytes` at a time.
    pub fn update_since(&self, cursor: &mut Cursor, point_bytes: usize) -> SceneUpdate {
        let reset = !cursor.started || cursor.epoch != self.epoch;
        if reset {
            *cursor = Cursor { started: true, epoch: self.epoch, ..Cursor::default() };
        }
        let since = cursor.tick;
        let keyframes: Vec<Placed> =
            self.keyframes.values().filter(|entry| entry.moved > since).map(|entry| entry.placed).collect();
        let first = self.trajectory_changes.iter().find(|(tick, _)| *tick > since);
        let mut update = SceneUpdate {
            reset: reset.then(|| self.agents.clone()),
            status: (self.status.0 > since || reset).then(|| Arc::clone(&self.status.1)),
            picture: self.picture.1.clone().filter(|_| self.picture.0 > since),
            keyframes,
            trajectory: first.map(|&(_, from)| (from, self.trajectory[from..].to_vec())),
            edges: (self.edges.0 > since).then(|| self.edges()),
            chunks: Vec::new(),
            more: false,
        };
        let mut bytes = 0;
        for (id, entry) in self.keyframes.iter().rev() {
            let Some((tick, chunk)) = &entry.chunk else { continue };
            if cursor.chunks.get(id) == Some(tick) {
                continue;
            }
            if bytes >= point_bytes {
                update.more = true;
                break;
            }
            bytes += chunk.points.len();
            cursor.chunks.insert(*id, *tick);
            update.chunks.push((entry.placed, Arc::clone(chunk)));
        }
        cursor.tick = self.tick;
        update
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::chunk::tests::{CAMERA, dense};
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    pub fn placed(id: u32, x: f64) -> Placed {
        let pose = Sim3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0), 1.0);
        Placed { id, agent: 0, frame_index: u64::from(id) * 3, world_from_keyframe: pose }
    }

    pub fn chunk() -> Chunk {
        let (image, depth) = dense();
        Chunk::new(&CAMERA, &image, None, &depth)
    }

    pub fn scene(count: u32) -> Scene {
        let mut scene = Scene::of(vec![Agent { name: "yard".into(), camera: CAMERA, metric: false }]);
        scene.place((0..count).map(|id| placed(id, f64::from(id))));
        (0..count).for_each(|id| scene.set_chunk(id, chunk()));
        scene
    }

    fn step(frame_index: u64) -> Step {
        Step {
            frame_index,
            agent: 0,
            timestamp: frame_index as f64 / 30.0,
            position: [frame_index as f32, 0.0, 0.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
        }
    }

    #[test]
    fn a_cursor_gets_everything_once_and_then_only_what_changed() {
        let mut scene = scene(4);
        let mut cursor = Cursor::default();
        let first = scene.update_since(&mut cursor, usize::MAX);
        assert_eq!(first.reset.as_ref().map(|agents| &*agents[0].name), Some("yard"));
        assert_eq!((first.keyframes.len(), first.chunks.len()), (4, 4));
        let none = scene.update_since(&mut cursor, usize::MAX);
        assert!(
            none.reset.is_none()
                && none.keyframes.is_empty()
                && none.chunks.is_empty()
                && none.status.is_none()
        );
        // A closed loop moves two keyframes: poses, no points.
        assert!(scene.place([placed(0, 0.0), placed(1, 1.0), placed(2, 2.5), placed(3, 3.5)]));
        let moved = scene.update_since(&mut cursor, usize::MAX);
        assert_eq!(moved.keyframes.iter().map(|k| k.id).collect::<Vec<_>>(), [2, 3]);
        assert!(moved.chunks.is_empty());
        assert!(!scene.place([placed(2, 2.5)]), "nothing has moved");
        scene.set_chunk(1, chunk());
        assert_eq!(scene.update_since(&mut cursor, usize::MAX).chunks[0].0.id, 1);
    }

    #[test]
    fn points_come_newest_first_within_the_limit_and_all_in_the_end() {
        let scene = scene(5);
        let mut cursor = Cursor::default();
        let mut order = Vec::new();
        loop {
            let update = scene.update_since(&mut cursor, 1);
            assert_eq!(update.chunks.len(), 1);
            order.extend(update.chunks.iter().map(|(placed, _)| placed.id));
            if !update.more {
                break;
            }
        }
        assert_eq!(order, [4, 3, 2, 1, 0]);
    }

    #[test]
    fn a_slow_cursor_gets_the_trajectory_from_the_earliest_change() {
        let mut scene = Scene::default();
        scene.set_trajectory(0, (0..10).map(step));
        let (mut quick, mut slow) = (Cursor::default(), Cursor::default());
        scene.update_since(&mut quick, 0);
        scene.update_since(&mut slow, 0);
        scene.set_trajectory(4, (4..12).map(step));
        assert_eq!(
            scene.update_since(&mut quick, 0).trajectory.map(|(from, steps)| (from, steps.len())),
            Some((4, 8))
        );
        scene.set_trajectory(11, (11..13).map(step));
        assert_eq!(
            scene.update_since(&mut quick, 0).trajectory.map(|(from, steps)| (from, steps.len())),
            Some((11, 2))
        );
        assert_eq!(
            scene.update_since(&mut slow, 0).trajectory.map(|(from, steps)| (from, steps.len())),
            Some((4, 9))
        );
        assert!(scene.update_since(&mut slow, 0).trajectory.is_none());
    }

    #[test]
    fn a_new_map_is_a_reset() {
        let mut scene = scene(3);
        let mut cursor = Cursor::default();
        scene.update_since(&mut cursor, usize::MAX);
        scene.clear();
        scene.place([placed(0, 7.0)]);
        let update = scene.update_since(&mut cursor, usize::MAX);
        assert!(update.reset.is_some() && update.chunks.is_empty());
        assert_eq!(update.keyframes, [placed(0, 7.0)]);
    }

    #[test]
    fn viewers_get_the_whole_scene_when_others_join() {
        let mut scene = scene(2);
        let mut cursor = Cursor::default();
        scene.update_since(&mut cursor, usize::MAX);
        scene.set_agents(scene.agents.clone());
        assert!(scene.update_since(&mut cursor, usize::MAX).reset.is_none(), "nobody joined");
        let other = Agent { name: "lane".into(), ..scene.agents[0].clone() };
        scene.set_agents(vec![scene.agents[0].clone(), other]);
        let update = scene.update_since(&mut cursor, usize::MAX);
        assert_eq!(update.reset.map(|agents| agents.len()), Some(2));
        assert_eq!((update.keyframes.len(), update.chunks.len()), (2, 2));
    }
}
