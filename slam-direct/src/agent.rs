//! The agent: one camera's tracker and map.

use crate::Params;
use crate::align::{AlignmentReference, Brightness};
use crate::bootstrap::{Bootstrap, Progress, Started};
use crate::keyframes::Departure;
use crate::local_map::{KeyframeState, LocalMap};
use crate::mapping;
use crate::track::{self, Matched, View};
use geometry::{GrayImage, Pinhole, Pyramid, Se3, Sim3};
use map::{FramePose, KeyframeId, Map, PlaceIndex};
use std::sync::Arc;

/// One image to process.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Index in the recording, from 0.
    pub index: u64,
    /// Time stamp, seconds, strictly growing from frame to frame.
    pub timestamp: f64,
    /// Undistorted grey image, of the size of the agent's camera.
    pub image: GrayImage,
}

/// What the agent is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingState {
    /// Waiting for enough parallax to make a first map.
    Starting,
    /// The frame's pose is known.
    Tracking,
    /// The pose is unknown; each new frame is tried against the map.
    Lost,
}

/// What became of one frame.
#[derive(Clone, Debug)]
pub struct FrameReport {
    /// State after the frame.
    pub state: TrackingState,
    /// Pose as known now (later optimisation may move it).
    pub world_from_camera: Option<Se3>,
    /// Keyframe made from this frame.
    pub new_keyframe: Option<KeyframeId>,
    /// Loop closed after this frame: `(newer, older)` keyframe.
    pub closed_loop: Option<(KeyframeId, KeyframeId)>,
    /// Share of the predicted points that were matched, 0–1.
    pub inlier_share: f32,
    /// Root mean square photometric residual of the matched points, grey levels.
    pub rmse: f32,
    /// Points matched in the frame.
    pub matched_points: usize,
    /// Why the frame was not tracked, for people.
    pub reason: Option<&'static str>,
}

/// One camera's tracker and map: give it frames in order of time.
pub struct Agent {
    camera: Pinhole,
    params: Params,
    map: Map,
    local: LocalMap,
    state: State,
    places: Box<dyn PlaceIndex>,
}

enum State {
    Empty,
    Starting(Box<Bootstrap>),
    Running(Box<Running>),
}

/// The tracker's memory from frame to frame.
struct Running {
    reference: usize,
    alignment: AlignmentReference,
    /// Most points that were expected in a frame tracked against the reference.
    expected: usize,
    /// Most points that were found in such a frame.
    found: usize,
    last: Se3,
    /// Motion of the last frame: `last = velocity * the one before`.
    velocity: Se3,
    brightness: Brightness,
    lost: bool,
}

impl Agent {
    /// A new agent with an empty map.
    pub fn new(camera: Pinhole, places: Box<dyn PlaceIndex>, params: Params) -> Self {
        Self {
            camera,
            params,
            map: Map::new(camera),
            local: LocalMap::new(camera),
            state: State::Empty,
            places,
        }
    }

    /// Tracks a frame and maps what it adds.
    pub fn process(&mut self, frame: Frame) -> FrameReport {
        let pyramid = Pyramid::new(frame.image, self.params.align.pyramid_levels);
        match std::mem::replace(&mut self.state, State::Empty) {
            State::Empty => {
                self.begin(pyramid, frame.timestamp, frame.index, "the image has too little texture")
            }
            State::Starting(bootstrap) => self.start(bootstrap, pyramid, frame.timestamp, frame.index),
            State::Running(running) => self.track(running, pyramid, frame.timestamp, frame.index),
        }
    }

    fn begin(&mut self, pyramid: Pyramid, timestamp: f64, index: u64, reason: &'static str) -> FrameReport {
        if let Some(start) = Bootstrap::new(self.camera, pyramid, timestamp, index, &self.params.bootstrap) {
            self.state = State::Starting(Box::new(start));
        }
        FrameReport { reason: Some(reason), ..FrameReport::of(TrackingState::Starting) }
    }

    fn start(
        &mut self,
        mut start: Box<Bootstrap>,
        pyramid: Pyramid,
        timestamp: f64,
        index: u64,
    ) -> FrameReport {
        match start.add(&pyramid, timestamp, index, &self.params.bootstrap, &self.params.track) {
            Progress::Waiting(reason) => {
                self.state = State::Starting(start);
                FrameReport { reason: Some(reason), ..FrameReport::of(TrackingState::Starting) }
            }
            Progress::Restart(reason) => self.begin(pyramid, timestamp, index, reason),
            Progress::Done(started) => self.adopt(*started),
        }
    }

    /// Takes over the first map.
    fn adopt(&mut self, started: Started) -> FrameReport {
        let Started { map, frames } = started;
        self.local = map;
        let first = &self.local.keyframes[0];
        self.map.frames.push(FramePose {
            timestamp: first.timestamp,
            frame_index: first.frame_index,
            reference: LocalMap::id(0),
            keyframe_from_frame: Se3::identity(),
        });
        let poses: Vec<Se3> = frames.iter().map(|f| f.2).collect();
        for (timestamp, frame_index, frame_from_first) in frames {
            self.map.frames.push(FramePose {
                timestamp,
                frame_index,
                reference: LocalMap::id(0),
                keyframe_from_frame: frame_from_first.inverse(),
            });
        }
        self.map_around(1);
        let last = self.local.keyframes[1].camera_from_world;
        let velocity = match poses.len() {
            0 | 1 => last,
            n => poses[n - 1] * poses[n - 2].inverse(),
        };
        let running = self.running(1, last, velocity, Brightness::default());
        let report = FrameReport {
            world_from_camera: Some(last.inverse()),
            new_keyframe: Some(LocalMap::id(1)),
            inlier_share: 1.0,
            matched_points: self.local.keyframes[1].seen.len(),
            ..FrameReport::of(TrackingState::Tracking)
        };
        self.state = State::Running(Box::new(running));
        self.publish();
        report
    }

    /// New points for a keyframe and its predecessor, then the joint optimisation around it.
    fn map_around(&mut self, keyframe: usize) {
        let p = &self.params;
        let mut others: Vec<usize> = self.local.covisible(keyframe).into_iter().map(|c| c.0).collect();
        others.truncate(p.mapping.search_views);
        if let Some(&nearest) = others.first() {
            mapping::add_points(&mut self.local, nearest, &[keyframe], &p.mapping, &p.triangulate, &p.track);
        }
        mapping::add_points(&mut self.local, keyframe, &others, &p.mapping, &p.triangulate, &p.track);
        mapping::optimise_around(&mut self.local, keyframe, &p.mapping);
        mapping::cull_unfound(&mut self.local, 0.25);
        self.places.add(LocalMap::id(keyframe), self.local.keyframes[keyframe].pyramid.base());
    }

    fn running(&self, reference: usize, last: Se3, velocity: Se3, brightness: Brightness) -> Running {
        let points = self.local.reference_points(reference);
        let alignment = AlignmentReference::new(
            &self.local.keyframes[reference].pyramid,
            &self.camera,
            &points,
            &self.params.align,
        );
        Running { reference, alignment, expected: 0, found: 0, last, velocity, brightness, lost: false }
    }

    fn track(
        &mut self,
        mut running: Box<Running>,
        pyramid: Pyramid,
        timestamp: f64,
        index: u64,
    ) -> FrameReport {
        let p = &self.params;
        let reference = &self.local.keyframes[running.reference];
        let world_from_reference = reference.camera_from_world.inverse();
        let guesses =
            [running.velocity * running.last * world_from_reference, running.last * world_from_reference];
        let aligned =
            track::align_from_guesses(&running.alignment, &pyramid, &guesses, running.brightness, 0.6);
        let mut view = View {
            pyramid: &pyramid,
            camera_from_world: aligned.frame_from_reference * reference.camera_from_world,
        };
        let hosts =
            track::choose_hosts(&self.local, &view.camera_from_world, running.reference, p.track.max_hosts);
        let (mut matched, sought) =
            track::match_points(&self.local, &hosts, &view, &p.track, p.track.per_cell);
        view.camera_from_world = track::refine_pose(&self.local, &view.camera_from_world, &mut matched);
        let inliers = matched.iter().filter(|m| m.inlier).count();
        let share = inliers as f32 / sought.len().max(1) as f32;
        if std::env::var("LB_DEBUG").is_ok() {
            eprintln!(
                "frame {index} ref {} align inl {:.2} vis {:.2} rmse {:.1} gain {:.3} | hosts {} sought {} matched {} inl {}",
                running.reference,
                aligned.inlier_share,
                aligned.visible_share,
                aligned.rmse,
                aligned.brightness.log_gain,
                hosts.len(),
                sought.len(),
                matched.len(),
                inliers
            );
        }
        if inliers < p.keyframes.min_matched || share < p.keyframes.min_share {
            running.lost = true;
            running.velocity = Se3::identity();
            self.state = State::Running(running);
            return FrameReport {
                reason: Some("too few points were found"),
                ..FrameReport::of(TrackingState::Lost)
            };
        }
        self.count(&sought, &matched);
        let camera_from_world = view.camera_from_world;
        running.velocity =
            if running.lost { Se3::identity() } else { camera_from_world * running.last.inverse() };
        running.lost = false;
        running.last = camera_from_world;
        running.brightness = aligned.brightness;
        self.map.frames.push(FramePose {
            timestamp,
            frame_index: index,
            reference: LocalMap::id(running.reference),
            keyframe_from_frame: (camera_from_world * world_from_reference).inverse(),
        });
        let rmse = (matched.iter().filter(|m| m.inlier).map(|m| m.rmse * m.rmse).sum::<f32>()
            / inliers as f32)
            .sqrt();
        let mut report = FrameReport {
            world_from_camera: Some(camera_from_world.inverse()),
            inlier_share: share,
            rmse,
            matched_points: inliers,
            ..FrameReport::of(TrackingState::Tracking)
        };
        running.expected = running.expected.max(sought.len());
        running.found = running.found.max(inliers);
        self.change_reference(&mut running, &hosts);
        if self.wants_keyframe(&running, sought.len(), inliers) {
            report.new_keyframe = Some(self.add_keyframe(&mut running, pyramid, timestamp, index, &matched));
        }
        self.state = State::Running(running);
        report
    }

    fn count(&mut self, sought: &[crate::local_map::PointRef], matched: &[Matched]) {
        for &at in sought {
            self.local.point_mut(at).sought += 1;
        }
        for m in matched.iter().filter(|m| m.inlier) {
            self.local.point_mut(m.at).found += 1;
        }
    }

    fn wants_keyframe(&self, running: &Running, expected: usize, found: usize) -> bool {
        let overlap = expected as f32 / running.expected.max(1) as f32;
        if (found as f32) < self.params.keyframes.fading * running.found as f32 {
            return true;
        }
        match self.departure(running.reference, &running.last, overlap) {
            Some(departure) => departure.score(&self.params.keyframes) > 1.0,
            None => true,
        }
    }

    /// How far a pose is from a keyframe's, as its points move in the image.
    fn departure(&self, keyframe: usize, camera_from_world: &Se3, overlap: f32) -> Option<Departure> {
        let relative = *camera_from_world * self.local.keyframes[keyframe].camera_from_world.inverse();
        let (flow, parallax) = mapping::median_flow(&self.local, keyframe, &relative)?;
        let width = self.camera.width as f32;
        Some(Departure { flow: flow / width, parallax: parallax / width, overlap })
    }

    fn add_keyframe(
        &mut self,
        running: &mut Running,
        pyramid: Pyramid,
        timestamp: f64,
        frame_index: u64,
        matched: &[Matched],
    ) -> KeyframeId {
        let keyframe = self.local.keyframes.len();
        self.local.keyframes.push(KeyframeState {
            timestamp,
            frame_index,
            pyramid,
            camera_from_world: running.last,
            points: Vec::new(),
            seen: Vec::new(),
        });
        mapping::add_observations(&mut self.local, keyframe, matched);
        self.map_around(keyframe);
        if let Some(frame) = self.map.frames.last_mut() {
            frame.reference = LocalMap::id(keyframe);
            frame.keyframe_from_frame = Se3::identity();
        }
        let last = self.local.keyframes[keyframe].camera_from_world;
        *running = self.running(keyframe, last, running.velocity, Brightness::default());
        self.publish();
        LocalMap::id(keyframe)
    }

    /// Tracks against the keyframe that lies nearest, as its points move in the image.
    fn change_reference(&self, running: &mut Running, hosts: &[usize]) {
        let p = &self.params.keyframes;
        let score = |keyframe: usize| self.departure(keyframe, &running.last, 1.0).map(|d| d.score(p));
        let Some(now) = score(running.reference) else { return };
        if now < 0.5 {
            return;
        }
        let nearest = hosts
            .iter()
            .filter(|&&host| host != running.reference)
            .filter_map(|&host| Some((score(host)?, host)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, best)) = nearest.filter(|n| n.0 < 0.6 * now) {
            *running = self.running(best, running.last, running.velocity, Brightness::default());
        }
    }

    /// Ends the run: last optimisation of the whole map.
    pub fn finish(&mut self) {
        if self.local.keyframes.len() > 1 {
            let report = mapping::optimise_all(&mut self.local, 20);
            if std::env::var("LB_DEBUG").is_ok() {
                eprintln!("final {report:?}");
            }
        }
        self.publish();
    }

    /// Brings the public map up to date with the working one.
    fn publish(&mut self) {
        for (index, state) in self.local.keyframes.iter().enumerate() {
            let id = LocalMap::id(index);
            let keyframe = self.map.keyframes.entry(id).or_insert_with(|| map::Keyframe {
                id,
                timestamp: state.timestamp,
                frame_index: state.frame_index,
                world_from_keyframe: Sim3::identity(),
                image: Arc::new(state.pyramid.base().clone()),
                semi_dense: map::SemiDense::default(),
                points: Vec::new(),
            });
            keyframe.world_from_keyframe = Sim3::from(state.camera_from_world.inverse());
        }
    }

    /// Gives the map away.
    pub fn into_map(self) -> Map {
        self.map
    }

    /// The map as it stands.
    pub fn map(&self) -> &Map {
        &self.map
    }
}

impl FrameReport {
    fn of(state: TrackingState) -> Self {
        Self {
            state,
            world_from_camera: None,
            new_keyframe: None,
            closed_loop: None,
            inlier_share: 0.0,
            rmse: 0.0,
            matched_points: 0,
            reason: None,
        }
    }
}
