//! A run of a few frames, told frame by frame.

use super::publisher::RunPublisher;
use super::*;
use crate::run::{MapListener, ProcessedFrame};
use geometry::{GrayImage, Pinhole, Se3, Sim3};
use map::{
    AgentId, AgentInfo, FramePose, Identity, Keyframe, KeyframeId, Map, MapDelta, Moved, SemiDense, Settled,
};
use merge::common_map::Fused;
use merge::merge_graph::{Component, Placement};
use nalgebra::{Matrix6, Vector6};
use slam_direct::{ScaleBreak, TrackingState};
use std::sync::Mutex;
use std::time::Instant;

const CAMERA: Pinhole = Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };
const AGENT: &str = "the yard";

/// A topic and a message's bytes.
type Published = (String, Vec<u8>);

/// Keeps what is published.
#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Vec<Published>>>);

impl Kept {
    /// The messages of a topic.
    fn of(&self, topic: &str) -> Vec<Vec<u8>> {
        let kept = self.0.lock().unwrap();
        kept.iter().filter(|(own, _)| own == topic).map(|(_, bytes)| bytes.clone()).collect()
    }
}

impl Outlet for Kept {
    fn publish(&mut self, topic: &str, message: Vec<u8>) {
        self.0.lock().unwrap().push((topic.to_owned(), message));
    }
}

fn has(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}

fn depth(value: f32) -> SemiDense {
    SemiDense {
        pixel: vec![0, 5].into(),
        inverse_depth: vec![value, value].into(),
        variance: vec![1e-6, 1e-6].into(),
    }
}

fn keyframe(id: u32) -> Keyframe {
    let image = Arc::new(GrayImage::filled(4, 3, 90));
    Keyframe::of_image(KeyframeId(id), f64::from(id), u64::from(id), Sim3::identity(), image)
}

/// A run, and who follows it.
struct Case {
    map: Map,
    agent: Identity,
    follower: Follower,
    slot: Arc<Slot<Pending>>,
    publisher: RunPublisher,
    kept: Kept,
    sequence: u64,
    /// Told with the next frame.
    scale_break: Option<ScaleBreak>,
}

impl Case {
    fn new() -> Self {
        let slot = Arc::new(Slot::default());
        let mut follower = Follower::new(Arc::clone(&slot));
        follower.begins(&AgentInfo::new(AGENT, CAMERA));
        let (map, agent) = (Map::new(CAMERA), Identity::random([7; 16]));
        Self {
            map,
            agent,
            follower,
            slot,
            publisher: RunPublisher::default(),
            kept: Kept::default(),
            sequence: 0,
            scale_break: None,
        }
    }

    /// A frame at `time`, that has this pose against keyframe 0, with what is said of the map.
    fn look(&mut self, time: f64, pose: Option<Se3>, delta: MapDelta) {
        let deltas =
            if delta.is_empty() { vec![] } else { vec![MapDelta { sequence: self.sequence, ..delta }] };
        self.sequence += deltas.len() as u64;
        deltas.iter().for_each(|delta| self.map.take_in(delta.clone()));
        self.map.frames.extend(pose.map(|keyframe_from_frame| FramePose {
            timestamp: time,
            frame_index: 0,
            reference: KeyframeId(0),
            keyframe_from_frame,
        }));
        let last = self.map.frames.last().filter(|_| pose.is_some());
        let world_from_camera =
            last.and_then(|frame| self.map.world_from_frame(frame)).map(|pose| pose.rigid());
        let (agent, map) = (self.agent, &self.map);
        self.follower.processed(&ProcessedFrame {
            agent,
            timestamp: time,
            world_from_camera,
            covariance: world_from_camera.map(|_| covariance()),
            state: if pose.is_some() { TrackingState::Tracking } else { TrackingState::Lost },
            reason: pose.is_none().then_some("the view matches no part of the map"),
            scale_break: self.scale_break.take(),
            deltas: &deltas,
            map,
        });
    }

    fn publish(&mut self) {
        let pending = self.slot.take_by(Duration::ZERO, Pending::taken);
        self.publisher.publish(pending, &mut self.kept);
    }
}

fn added(ids: impl IntoIterator<Item = u32>) -> MapDelta {
    MapDelta { added: ids.into_iter().map(keyframe).collect(), ..MapDelta::default() }
}

fn settled(id: u32, value: f32) -> MapDelta {
    let settled =
        vec![Settled { keyframe: KeyframeId(id), semi_dense: depth(value).into(), points: Vec::new() }];
    MapDelta { settled, ..MapDelta::default() }
}

fn moved(id: u32, x: f64) -> MapDelta {
    let pose = Sim3::from(Se3::exp(&Vector6::new(x, 0.0, 0.0, 0.0, 0.0, 0.0)));
    let moved = vec![Moved { keyframe: KeyframeId(id), world_from_keyframe: pose }];
    MapDelta { moved, ..MapDelta::default() }
}

fn step(x: f64) -> Option<Se3> {
    Some(Se3::exp(&Vector6::new(x, 0.0, 0.0, 0.0, 0.0, 0.0)))
}

/// Covariance of a pose in the axes of its camera.
fn covariance() -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::new(4.0, 1.0, 2.0, 0.04, 0.01, 0.02))
}

/// The variances of the pose of an odometry.
fn variances(odometry: &[u8]) -> [f64; 6] {
    let start = odometry.len() - 8 * (36 + 6 + 36);
    std::array::from_fn(|axis| {
        let at = start + 8 * 7 * axis;
        f64::from_le_bytes(odometry[at..at + 8].try_into().unwrap())
    })
}

/// The last two numbers of three before the covariance of an odometry's pose: where it is, forward, left and up.
fn position(odometry: &[u8]) -> [f64; 3] {
    // Behind it: orientation, covariance, velocity, covariance.
    let end = odometry.len() - 8 * (4 + 36 + 6 + 36);
    [0, 1, 2].map(|axis| {
        let at = end - 24 + 8 * axis;
        f64::from_le_bytes(odometry[at..at + 8].try_into().unwrap())
    })
}

#[test]
fn every_pose_is_published_once_and_lost_frames_are_not() {
    let mut case = Case::new();
    case.look(0.0, step(0.0), added([0]));
    case.look(0.1, step(0.1), MapDelta::default());
    case.look(0.2, None, MapDelta::default());
    case.publish();
    case.look(0.3, step(0.3), MapDelta::default());
    case.publish();
    assert_eq!((case.kept.of("/the_yard/odometry").len(), case.kept.of("/tf").len()), (3, 3));
    assert_eq!(case.publisher.published().poses, 3);
    let transforms = case.kept.of("/tf");
    for frame in ["the_yard/map", "the_yard/odom", "the_yard/camera", "the_yard/camera_optical"] {
        assert!(has(&transforms[0], &format!("{frame}\0")), "{frame}");
    }
    // The camera's x is right, the body's y left.
    let last = case.kept.of("/the_yard/odometry").pop().unwrap();
    assert!((position(&last)[1] + 0.3).abs() < 1e-12, "{:?}", position(&last));
    let (found, expected) = (variances(&last), [2.0, 4.0, 1.0, 0.02, 0.04, 0.01]);
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
}

#[test]
fn losses_and_breaks_of_the_scale_are_diagnostics() {
    let mut case = Case::new();
    case.look(0.0, step(0.0), added([0]));
    case.publish();
    case.look(0.1, step(0.1), MapDelta::default());
    case.publish();
    assert_eq!(case.kept.of("/diagnostics").len(), 1, "nothing changed, and no second is over");
    case.look(0.2, None, MapDelta::default());
    case.publish();
    case.scale_break = Some(ScaleBreak { before: KeyframeId(9), points: 11, inliers: 3 });
    case.look(14.37, step(0.1), MapDelta::default());
    case.publish();
    case.look(14.47, None, MapDelta::default());
    case.publish();
    let [begun, lost, broken, last] = &case.kept.of("/diagnostics")[..] else { panic!() };
    assert!(has(begun, "loopbox: the_yard tracking\0") && has(begun, "carried on\0"));
    assert!(has(lost, "lost: the view matches no part of the map\0"));
    let why = "not carried on some keyframes before 14.37 s: 3 of 11 points that measure it agree";
    assert!(has(broken, why) && has(broken, "tracking\0"));
    assert!(has(last, why), "it stays");
}

/// A loop moves the keyframe that frames are measured in: the map moves, the odometry does not.
#[test]
fn corrections_do_not_move_the_odometry() {
    let mut case = Case::new();
    case.look(0.0, step(0.0), added([0]));
    case.look(0.1, step(0.1), MapDelta::default());
    case.look(0.2, step(0.2), moved(0, 5.0));
    case.publish();
    let places: Vec<_> = case.kept.of("/the_yard/odometry").iter().map(|bytes| position(bytes)[1]).collect();
    for (place, expected) in places.iter().zip([0.0, -0.1, -0.2]) {
        assert!((place - expected).abs() < 1e-9, "{places:?}");
    }
}

#[test]
fn points_are_published_when_their_depth_is_new_and_the_map_is_current() {
    let mut case = Case::new();
    case.look(0.0, step(0.0), added([0, 1]));
    case.publish();
    assert_eq!(
        (case.publisher.published().clouds, case.publisher.published().map_clouds),
        (0, 0),
        "there are no points"
    );
    case.look(0.1, step(0.1), settled(0, 0.5));
    case.look(0.2, step(0.1), settled(1, 0.5));
    case.publish();
    assert_eq!((case.publisher.published().clouds, case.publisher.published().map_clouds), (2, 1));
    // Keyframes that are moved say nothing new of their points.
    case.look(0.3, step(0.1), moved(1, 3.0));
    case.slot.leave(|pending| pending.ended = true);
    case.publish();
    assert_eq!((case.publisher.published().clouds, case.publisher.published().map_clouds), (2, 2));
    let clouds = case.kept.of("/the_yard/map_points");
    assert_eq!(clouds[0].len(), clouds[1].len());
    assert_ne!(clouds[0], clouds[1], "they are elsewhere in the map");
    assert!(has(&clouds[1], "the_yard/map\0"));
    // What settles again is said again, and a map that is handed on whole is not.
    case.look(0.4, step(0.1), settled(1, 0.25));
    let mut map = case.map.clone();
    map.agents.values_mut().for_each(|about| about.identity = Some(case.agent));
    case.follower.ended(&[map]);
    case.publish();
    assert_eq!(case.publisher.published().clouds, 3);
}

#[test]
fn a_map_begun_anew_has_a_frame_of_its_own() {
    let mut case = Case::new();
    case.look(0.0, step(0.0), added([0]));
    case.look(0.1, step(0.7), settled(0, 0.5));
    case.publish();
    (case.map, case.sequence, case.agent) = (Map::new(CAMERA), 0, case.agent.later(1));
    case.look(0.2, step(0.0), added([0]));
    case.look(0.3, step(0.1), settled(0, 0.5));
    case.publish();
    let (transforms, points) = (case.kept.of("/tf"), case.kept.of("/the_yard/points"));
    let anew: Vec<_> = transforms.iter().map(|bytes| has(bytes, "the_yard/map_2\0")).collect();
    assert_eq!(anew, [false, false, true, true]);
    assert_eq!(points.iter().map(|bytes| has(bytes, "the_yard/map_2\0")).collect::<Vec<_>>(), [false, true]);
    // Nobody knows how it moved between the two.
    let places: Vec<_> = case.kept.of("/the_yard/odometry").iter().map(|bytes| position(bytes)[1]).collect();
    for (place, expected) in places.iter().zip([0.0, -0.7, -0.7, -0.8]) {
        assert!((place - expected).abs() < 1e-9, "{places:?}");
    }
}

/// Whoever is slow keeps neither the run nor its memory.
#[test]
fn a_run_waits_for_nobody_and_counts_what_it_leaves_out() {
    struct Slow(Kept);
    impl Outlet for Slow {
        fn publish(&mut self, topic: &str, message: Vec<u8>) {
            std::thread::sleep(Duration::from_millis(1));
            self.0.publish(topic, message);
        }
    }
    let mut case = Case::new();
    let (follower, publishing) = Publishing::start(Slow(case.kept.clone())).unwrap();
    case.follower = follower;
    case.follower.begins(&AgentInfo::new(AGENT, CAMERA));
    let begun = Instant::now();
    case.look(0.0, step(0.0), added([0]));
    const FRAMES: u64 = 3000;
    (1..FRAMES).for_each(|i| case.look(i as f64 * 1e-3, step(i as f64 * 1e-3), MapDelta::default()));
    let took = begun.elapsed();
    let published = publishing.finish().unwrap();
    assert!(took < begun.elapsed() / 2, "{took:?} of {:?}", begun.elapsed());
    assert!(published.dropped > 0 && published.poses + published.dropped == FRAMES, "{published:?}");
    assert_eq!(case.kept.of("/the_yard/odometry").len() as u64, published.poses);
}

/// An agent whose only keyframe is at the origin of its world, and whose last frame is a unit to its right.
fn other(name: &str, time: f64) -> Map {
    let mut map = Map::of(AgentInfo::new(name, CAMERA));
    let mut keyframe = Keyframe { timestamp: time, ..keyframe(0) };
    keyframe.semi_dense = depth(0.5).into();
    map.keyframes.insert(KeyframeId(0), keyframe);
    map.frames.extend(step(1.0).map(|keyframe_from_frame| FramePose {
        timestamp: time,
        frame_index: 0,
        reference: KeyframeId(0),
        keyframe_from_frame,
    }));
    map
}

#[test]
fn a_common_map_publishes_the_others_poses_and_is_published_again() {
    let root_from_other = Sim3::new(Default::default(), nalgebra::Vector3::new(3.0, 0.0, 0.0), 2.0);
    let mut map = Map::unite(vec![other(AGENT, 1.0), other("the court", 2.0)]).unwrap();
    let ids: Vec<AgentId> = map.agents.keys().copied().collect();
    for keyframe in map.keyframes.values_mut().filter(|keyframe| keyframe.agent == ids[1]) {
        keyframe.world_from_keyframe = root_from_other * keyframe.world_from_keyframe;
    }
    let place = |root_from_agent| Placement {
        root_from_agent,
        covariance: nalgebra::SMatrix::zeros(),
        path: Vec::new(),
        confidence: f64::INFINITY,
    };
    let agents = [(ids[0], place(Sim3::identity())), (ids[1], place(root_from_other))].into();
    let component = Component { root: ids[0], agents, tree: Vec::new(), spare: Vec::new() };
    let fused = Fused { map, agents: ids, component, report: None, suppressed: Vec::new() };
    let alone = Fused { map: other("alone", 5.0), agents: vec![AgentId(7)], ..fused.clone() };
    let kept = Kept::default();
    let mut common = Common::new(kept.clone());
    common.publish_cameras(&[alone, fused]);
    let topics: Vec<String> = kept.0.lock().unwrap().iter().map(|(topic, _)| topic.clone()).collect();
    let expected =
        ["/the_yard/common_odometry", "/the_court/common_odometry", "/the_yard/common_points", "/tf_static"];
    assert_eq!(topics, expected);
    let places = kept.of("/tf_static").remove(0);
    assert!(has(&places, "the_yard/map\0") && has(&places, "the_court/map\0"));
    // The last seven numbers: 3 to the right, not turned.
    let numbers: Vec<f64> = places[places.len() - 56..]
        .chunks_exact(8)
        .map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()))
        .collect();
    let expected = [0.0, -3.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    assert!(numbers.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{numbers:?}");
    // In the common unit: a unit of the other is two.
    let pose = kept.of("/the_court/common_odometry").remove(0);
    assert!(has(&pose, "the_yard/map\0") && (position(&pose)[1] + 5.0).abs() < 1e-12);
    common.tick();
    assert_eq!(kept.of("/tf_static").len(), 1, "it is not time yet");
}
