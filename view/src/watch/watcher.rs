//! The watcher's thread: turns what the tracker left into the scene.

use super::Shared;
use super::chunk::Chunk;
use super::feed::{Depth, Pending, Pose};
use super::picture::{Picture, VisibleKeyframe};
use super::scene::{Placed, Scene, Step};
use super::status::{Status, state_name};
use crate::process;
use crate::report::scene::{kind_number, pose_numbers};
use geometry::{Pinhole, Se3, Sim3};
use map::{EdgeKind, FramePose, KeyframeId};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Rounds a second at most: what viewers can show.
const ROUND: Duration = Duration::from_millis(40);
/// Frames per second and CPU are means over this time.
const SPAN: Duration = Duration::from_secs(2);
/// How often memory and CPU are asked for.
const PROCESS_INTERVAL: Duration = Duration::from_millis(500);
/// Keyframes whose depth is drawn over the live image.
const OVERLAID: usize = 3;

/// Works until the run has ended.
pub fn watch(shared: &Shared, camera: Pinhole) {
    // The tracker comes first; where priorities cannot be changed, this thread is still light.
    let _ = rustix::process::nice(10);
    let first = shared.scene().status().clone();
    let mut watcher = Watcher::new(camera, first);
    loop {
        let began = Instant::now();
        let pending = shared.slot.take(Duration::from_millis(500));
        let ended = pending.ended;
        watcher.round(shared, pending);
        if ended {
            return;
        }
        if let Some(left) = ROUND.checked_sub(began.elapsed()) {
            std::thread::sleep(left);
        }
    }
}

struct Watcher {
    camera: Pinhole,
    status: Status,
    poses: BTreeMap<KeyframeId, Sim3>,
    frames: Vec<FramePose>,
    /// The first of the frames that refer to a keyframe.
    first_frames: BTreeMap<KeyframeId, usize>,
    loops: Vec<[u32; 3]>,
    /// Moments, frames taken and CPU seconds at them.
    pace: VecDeque<(Instant, u64, Option<f64>)>,
    asked: Option<Instant>,
}

impl Watcher {
    /// Goes on from what viewers were told before the first frame.
    fn new(camera: Pinhole, status: Status) -> Self {
        Self {
            camera,
            status,
            poses: BTreeMap::new(),
            frames: Vec::new(),
            first_frames: BTreeMap::new(),
            loops: Vec::new(),
            pace: VecDeque::new(),
            asked: None,
        }
    }

    /// Takes one load; the scene is locked only to put in what is ready.
    fn round(&mut self, shared: &Shared, mut pending: Pending) {
        let chunks: Vec<_> = pending
            .depths
            .drain(..)
            .map(|Depth { id, image, color, semi_dense }| {
                (id.0, Chunk::new(&self.camera, &image, color.as_ref(), &semi_dense))
            })
            .collect();
        if pending.anew {
            (self.poses, self.frames, self.first_frames, self.loops) = Default::default();
            self.status.loops = 0;
        }
        if pending.restarted {
            (self.status.losses, self.status.scale_break) = (0, None);
        }
        let steps = self.steps(&mut pending);
        self.loops
            .extend(pending.loops.iter().map(|[newer, older]| [*newer, *older, kind_number(EdgeKind::Loop)]));
        self.update_status(&mut pending);
        let picture = pending.picture.take().map(|live| {
            let mut picture = Picture::new(live.frame_index, live.timestamp, &live.image);
            if let Some(pose) = live.world_from_camera {
                self.overlay(&shared.scene(), &mut picture, &pose);
            }
            picture
        });
        let mut scene = shared.scene();
        if pending.anew {
            scene.clear();
        }
        scene.place(pending.keyframes.values().map(placed));
        chunks.into_iter().for_each(|(id, chunk)| scene.set_chunk(id, chunk));
        if let Some((from, steps)) = steps {
            scene.set_trajectory(from, steps);
        }
        let edges = pending.edges.take();
        if edges.is_some() || scene.edges().len() < self.loops.len() {
            scene.set_edges(edges.unwrap_or_else(|| self.loops.clone()));
        }
        if let Some(picture) = picture {
            scene.set_picture(picture);
        }
        (self.status.keyframes, self.status.points) = (scene.keyframes().count(), scene.points());
        scene.set_status(self.status.clone());
    }

    /// Keeps poses and frames; gives the part of the trajectory that they change.
    fn steps(&mut self, pending: &mut Pending) -> Option<(usize, Vec<Step>)> {
        let old = self.frames.len();
        for (place, frame) in (old..).zip(&pending.frames) {
            self.first_frames.entry(frame.reference).or_insert(place);
        }
        self.frames.append(&mut pending.frames);
        self.poses.extend(pending.keyframes.iter().map(|(id, pose)| (*id, pose.world_from_keyframe)));
        let moved = pending.keyframes.keys().filter_map(|id| self.first_frames.get(id).copied());
        let from = moved.min().map_or(old, |first| first.min(old));
        if from == self.frames.len() {
            return None;
        }
        let mut reference = None;
        let mut steps = Vec::with_capacity(self.frames.len() - from);
        for frame in &self.frames[from..] {
            // Runs of frames have one reference.
            let pose = match reference {
                Some((id, pose)) if id == frame.reference => pose,
                _ => *self.poses.get(&frame.reference)?,
            };
            reference = Some((frame.reference, pose));
            steps.push(Step::new(frame, 0, &(pose * Sim3::from(frame.keyframe_from_frame))));
        }
        Some((from, steps))
    }

    /// Brings the numbers up to date.
    fn update_status(&mut self, pending: &mut Pending) {
        let status = &mut self.status;
        status.processed += pending.taken;
        status.tracked += pending.tracked;
        status.losses += pending.lost;
        status.loops += pending.loops.len() as u64;
        status.add_breaks(&pending.scale_breaks);
        status.paused = pending.paused.unwrap_or(status.paused);
        status.recording = pending.recording.or(status.recording);
        if let Some(folder) = pending.folder.take() {
            status.folder = folder;
        }
        if let Some(facts) = pending.facts.take() {
            let report = facts.report;
            status.state = state_name(report.state);
            (status.frame, status.timestamp) = (facts.frame, facts.timestamp);
            (status.ms, status.latency_ms, status.dropped) = (facts.ms, facts.latency_ms, facts.dropped);
            (status.inlier_share, status.matched, status.rmse) =
                (report.inlier_share, report.matched_points, report.rmse);
            status.camera = report.world_from_camera.map(|pose| pose_numbers(&Sim3::from(pose)));
            status.reason = report.reason;
        }
        if let Some(note) = pending.note.take() {
            status.note = note;
        }
        if let Some(near) = pending.neighbourhood.take() {
            status.neighbourhood = Some(near);
        }
        status.report |= pending.report;
        if pending.ended {
            status.state = "done";
        }
        self.measure();
    }

    /// Frames per second, memory and CPU.
    fn measure(&mut self) {
        let now = Instant::now();
        if self.asked.is_some_and(|asked| now - asked < PROCESS_INTERVAL) {
            return;
        }
        self.asked = Some(now);
        self.pace.push_back((now, self.status.processed, process::cpu_seconds()));
        while self.pace.len() > 2 && now - self.pace[0].0 > SPAN {
            self.pace.pop_front();
        }
        let (then, frames, cpu) = self.pace[0];
        let seconds = (now - then).as_secs_f64();
        if seconds > 0.0 {
            self.status.frames_per_s = (self.status.processed - frames) as f64 / seconds;
            self.status.cpu = self.pace.back().and_then(|last| Some((last.2? - cpu?) / seconds));
        }
        self.status.memory_bytes = process::memory_bytes();
    }

    /// Draws the depth of the keyframes nearest to the camera over its image.
    fn overlay(&self, scene: &Scene, picture: &mut Picture, world_from_camera: &Se3) {
        let camera_from_world = Sim3::from(world_from_camera.inverse());
        let mut near: Vec<(f64, &Placed, &Arc<Chunk>)> = scene
            .keyframes()
            .filter_map(|(placed, chunk)| {
                let camera_from_keyframe = camera_from_world * placed.world_from_keyframe;
                let ahead = (camera_from_keyframe.rotation * nalgebra::Vector3::z()).z;
                // Unlike directions weigh as much as a distance in the unit of the map's start, a typical depth.
                let cost = camera_from_keyframe.translation.norm() + 2.0 * (1.0 - ahead);
                chunk.filter(|chunk| !chunk.is_empty()).map(|chunk| (cost, placed, chunk))
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(OVERLAID);
        let seen: Vec<VisibleKeyframe> = near
            .iter()
            .map(|(_, placed, chunk)| VisibleKeyframe {
                chunk,
                camera_from_keyframe: camera_from_world * placed.world_from_keyframe,
            })
            .collect();
        picture.overlay(&self.camera, &seen, scene.picture_range());
    }
}

fn placed(pose: &Pose) -> Placed {
    Placed {
        id: pose.id.0,
        agent: 0,
        frame_index: pose.frame_index,
        world_from_keyframe: pose.world_from_keyframe,
    }
}

#[cfg(test)]
mod tests {
    use super::super::status::FoundBreak;
    use super::*;
    use slam_direct::ScaleBreak;

    /// The map before is what the warning is of, and its results stay.
    #[test]
    fn a_scale_that_was_not_carried_on_is_displayed_until_the_run_begins_again() {
        let camera = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };
        let shared = Shared::new(Scene::default(), None);
        let mut watcher = Watcher::new(camera, Status::default());
        let of_scale = ScaleBreak { before: KeyframeId(9), points: 11, inliers: 3 };
        let found = |frame| FoundBreak { frame, timestamp: 0.1 * frame as f64, of_scale };
        watcher.round(&shared, Pending { scale_breaks: vec![found(40)], ..Pending::default() });
        watcher.round(&shared, Pending { scale_breaks: vec![found(70)], ..Pending::default() });
        watcher.round(&shared, Pending { lost: 1, anew: true, ..Pending::default() });
        assert_eq!(shared.scene().status().losses, 1, "those of the run, whatever map it is in");
        let shown = shared.scene().status().scale_break.clone().expect("it is shown");
        assert_eq!((shown.count, shown.frame, shown.timestamp), (2, 70, 7.0));
        assert!(shown.why.starts_with("3 of 11 points"), "{}", shown.why);
        watcher.round(&shared, Pending { anew: true, restarted: true, ..Pending::default() });
        let status = shared.scene().status().clone();
        assert_eq!((status.losses, status.scale_break), (0, None));
    }
}
