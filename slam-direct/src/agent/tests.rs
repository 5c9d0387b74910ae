//! The agent on a short rendered drive.

mod images;

use super::*;
use crate::test_scene::{without_points, yard};
use geometry::Se3;
use geometry::{GrayImage, Image, umeyama};
use loopbox_tests::{Recording, trajectory};
use place_recog::ThumbnailIndex;
use std::sync::LazyLock;

/// A drive past the row of boxes.
pub(super) fn drive() -> &'static Recording {
    static DRIVE: LazyLock<Recording> = LazyLock::new(|| {
        Recording::render(yard(), Recording::SMALL_CAMERA, &trajectory::sideways(50, 2.5), 20.0)
    });
    &DRIVE
}

pub(super) fn agent() -> Agent {
    agent_with_lag(Params::default().mapping.lag)
}

/// An agent that tracks against what was mapped so many frames before.
fn agent_with_lag(lag: usize) -> Agent {
    let mut params = Params::default();
    params.mapping.lag = lag;
    Agent::new(Recording::SMALL_CAMERA, Box::new(ThumbnailIndex::default()), params).unwrap()
}

/// Gives the agent the frames of the drive, each as `picture` shows it.
pub(super) fn feed(agent: &mut Agent, picture: impl Fn(usize, &GrayImage) -> GrayImage) -> Vec<FrameReport> {
    feed_with(agent, drive(), picture)
}

/// The same of another recording.
fn feed_with(
    agent: &mut Agent,
    recording: &Recording,
    picture: impl Fn(usize, &GrayImage) -> GrayImage,
) -> Vec<FrameReport> {
    let shots = recording.shots.iter().enumerate();
    shots
        .map(|(i, shot)| {
            let (index, timestamp, image) = (i as u64, shot.timestamp, picture(i, &shot.image));
            agent.process(Frame { index, timestamp, image, color: None }).unwrap()
        })
        .collect()
}

pub(super) fn as_it_is(_: usize, image: &GrayImage) -> GrayImage {
    image.clone()
}

fn finished() -> (Map, Vec<FrameReport>) {
    finished_by(agent())
}

fn finished_by(mut agent: Agent) -> (Map, Vec<FrameReport>) {
    let reports = feed(&mut agent, as_it_is);
    agent.finish();
    (agent.into_map(), reports)
}

/// Root mean square distance of the trajectory from the truth once scale and place are fitted, metres.
fn trajectory_error(map: &Map) -> f64 {
    let found: Vec<_> = map.trajectory().iter().map(|p| p.world_from_camera.translation).collect();
    let truth = |f: &FramePose| drive().shots[f.frame_index as usize].world_from_camera.translation;
    let truth: Vec<_> = map.frames.iter().map(truth).collect();
    let fit = umeyama::sim3(&found, &truth).unwrap();
    let square: f64 = found.iter().zip(&truth).map(|(f, t)| (fit * *f - t).norm_squared()).sum();
    (square / found.len() as f64).sqrt()
}

#[test]
fn a_drive_is_tracked_and_mapped() {
    let (map, reports) = finished();
    let begun = reports.iter().position(|r| r.state == TrackingState::Tracking).expect("a first map");
    assert!(begun < 15, "the first map takes {begun} frames");
    assert!(
        reports[begun..].iter().all(|r| r.state == TrackingState::Tracking && r.world_from_camera.is_some())
    );
    assert_eq!(map.frames.len(), drive().shots.len(), "the frames of the start get poses too");
    assert!(map.frames.windows(2).all(|w| w[0].frame_index < w[1].frame_index));
    let error = trajectory_error(&map);
    assert!(error < 0.01 * drive().path_length(), "off by {error} m");
    assert!(map.keyframes.len() >= 4, "{} keyframes", map.keyframes.len());
    for keyframe in map.keyframes.values() {
        assert!(keyframe.semi_dense.len() > 2000, "{:?}: {}", keyframe.id, keyframe.semi_dense.len());
        assert!(keyframe.points.len() > 20, "{:?}: {}", keyframe.id, keyframe.points.len());
    }
    let mut settled: Vec<KeyframeId> = reports.iter().flat_map(|r| r.settled_keyframes.clone()).collect();
    assert!(!settled.is_empty());
    settled.dedup();
    assert!(settled.windows(2).all(|w| w[0] < w[1]), "each keyframe settles once, in order: {settled:?}");
}

#[test]
fn the_frames_of_a_map_that_is_given_up_are_kept_once() {
    let mut agent = agent();
    let mut given_up = false;
    for (i, shot) in drive().shots.iter().enumerate().take(40) {
        let mut data = shot.image.data().to_vec();
        if i >= 8 {
            // Upside down it shares nothing with the map.
            data.reverse();
        }
        let image = GrayImage::from_vec(shot.image.width(), shot.image.height(), data).unwrap();
        let frame = Frame { index: i as u64, timestamp: shot.timestamp, image, color: None };
        given_up |= agent.process(frame).unwrap().reason == Some("the first map was of no use");
        let kept: Vec<u64> = agent.early.iter().map(|frame| frame.frame_index).collect();
        assert!(kept.windows(2).all(|pair| pair[0] < pair[1]), "{kept:?}");
    }
    assert!(given_up);
}

/// What is handed out halfway hangs together and does not change what comes after.
#[test]
fn a_snapshot_is_a_whole_map_of_an_agent_that_continues() {
    let mut agent = agent();
    let mut snapshot = None;
    for (i, shot) in drive().shots.iter().enumerate() {
        if i == 40 {
            snapshot = Some(agent.snapshot());
        }
        let (index, timestamp, image) = (i as u64, shot.timestamp, shot.image.as_ref().clone());
        agent.process(Frame { index, timestamp, image, color: None }).unwrap();
    }
    agent.finish();
    let snapshot = snapshot.unwrap();
    assert_eq!(snapshot.frames.len(), 40);
    let last = snapshot.keyframes.keys().next_back().unwrap().0;
    let follows =
        |id: u32| snapshot.edges.iter().any(|e| (e.from.0.min(e.to.0), e.from.0.max(e.to.0)) == (id, id + 1));
    assert!(last >= 2 && (0..last).all(follows), "successive keyframes have an edge");
    assert!(snapshot.keyframes.values().all(|keyframe| !keyframe.points.is_empty()));
    assert!(agent.into_map() == finished().0, "the agent goes on as if nothing had been");
}

#[test]
fn a_keyframe_and_its_frame_have_one_pose() {
    let (map, _) = finished();
    for keyframe in map.keyframes.values() {
        let frame = map.frames.iter().find(|f| f.frame_index == keyframe.frame_index).expect("its frame");
        let world_from_frame = map.world_from_frame(frame).unwrap().rigid();
        let off = (world_from_frame.inverse() * keyframe.world_from_keyframe.rigid()).log().norm();
        assert!(off < 1e-9, "{:?}: off by {off}", keyframe.id);
    }
}

#[test]
fn two_runs_give_one_map_however_many_threads() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| finished().0)
    };
    let one = on(1);
    assert!(one == on(1), "two runs differ");
    assert!(one == on(2), "the number of threads matters");
}

#[test]
fn a_map_adopted_later_is_as_good_and_the_same_each_time() {
    for lag in [0, 1, 3] {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| finished_by(agent_with_lag(lag)))
        };
        let (map, reports) = run(1);
        assert!(map == run(2).0, "lag {lag}: the number of threads matters");
        assert_eq!(map.frames.len(), drive().shots.len());
        let error = trajectory_error(&map);
        assert!(error < 0.01 * drive().path_length(), "lag {lag}: off by {error} m");
        let made = |id| reports.iter().position(|r| r.new_keyframe == Some(id));
        let adopted = reports.iter().enumerate().filter_map(|(at, r)| Some((at, r.adopted?)));
        let waits: Vec<usize> = adopted.map(|(at, id)| at - made(id).unwrap()).collect();
        assert_eq!(waits.is_empty(), lag == 0);
        // The sensor is asked after at ten keyframes: the whole map is optimised.
        let (long, short): (Vec<usize>, Vec<usize>) = waits.iter().partition(|&&wait| wait > lag);
        assert!(short.iter().all(|&wait| wait == lag), "{waits:?}");
        assert!(long.len() <= 2 && long.iter().all(|&wait| wait == 5 * lag), "{waits:?}");
    }
}

#[test]
fn who_takes_in_all_deltas_has_the_map() {
    for lag in [0, 2] {
        let mut agent = agent_with_lag(lag);
        let mut replica = Map::new(Recording::SMALL_CAMERA);
        let mut next = 0;
        for (i, shot) in drive().shots.iter().enumerate() {
            let (index, timestamp, image) = (i as u64, shot.timestamp, shot.image.as_ref().clone());
            for delta in agent.process(Frame { index, timestamp, image, color: None }).unwrap().deltas {
                assert_eq!(delta.sequence, next);
                next += 1;
                replica.take_in(delta);
            }
            assert!(without_points(&replica) == without_points(agent.map()), "lag {lag}: frame {i}");
            let known = |f: &FramePose| replica.keyframes.contains_key(&f.reference);
            assert!(agent.map().frames.iter().all(known), "lag {lag}: each frame's keyframe is there");
        }
        assert!(next > 8);
        let keyframe = agent.map().keyframes[&KeyframeId(1)].clone();
        assert!(agent.describe(keyframe.id, &keyframe.image, vec![1, 2].into()));
        let other = std::sync::Arc::new(keyframe.image.as_ref().clone());
        assert!(!agent.describe(keyframe.id, &other, vec![3].into()), "that is another one's image");
        agent.finish();
        agent.take_deltas().into_iter().for_each(|delta| replica.take_in(delta));
        let map = agent.map();
        assert_eq!(map.keyframes[&KeyframeId(1)].features, Some(vec![1, 2].into()));
        assert!(replica.edges == map.edges && !replica.edges.is_empty());
        let same = |(replica, known): (&map::Keyframe, &map::Keyframe)| {
            // Points are brought to where they stand with the whole map at once.
            map::Keyframe { points: known.points.clone(), ..replica.clone() } == *known
        };
        assert!(replica.keyframes.values().zip(map.keyframes.values()).all(same));
    }
}

/// A camera that goes to and fro knows what it sees after some time; keyframes were made for ever.
#[test]
fn a_camera_that_stays_somewhere_makes_no_more_keyframes() {
    let mut agent = agent();
    let (count, mut made) = (drive().shots.len(), Vec::new());
    for pass in 0..8 {
        let mut of_pass = 0;
        for i in 0..count {
            let shot = &drive().shots[if pass % 2 == 0 { i } else { count - 1 - i }];
            let (index, timestamp) = ((pass * count + i) as u64, (pass * count + i) as f64 / 20.0);
            let image = shot.image.as_ref().clone();
            let report = agent.process(Frame { index, timestamp, image, color: None }).unwrap();
            of_pass += usize::from(report.new_keyframe.is_some());
        }
        made.push(of_pass);
    }
    assert!(made[0] >= 3 && made[6..] == [0, 0], "{made:?}");
}

#[test]
fn a_request_to_stop_leaves_a_whole_map() {
    let mut agent = agent();
    feed(&mut agent, as_it_is);
    agent.finish_until(&|| true);
    let map = agent.map();
    assert!(map.keyframes.values().all(|k| !k.semi_dense.is_empty() && !k.points.is_empty()));
    assert!(trajectory_error(map) < 0.01 * drive().path_length());
}

#[test]
fn dark_frames_lose_the_agent_and_light_finds_it_again() {
    let mut agent = agent();
    let dark = 30..34;
    let reports = feed(&mut agent, |i, image| match dark.contains(&i) {
        true => GrayImage::filled(image.width(), image.height(), 0),
        false => image.clone(),
    });
    for i in dark.clone() {
        assert_eq!(reports[i].state, TrackingState::Lost, "{i}");
        assert!(reports[i].reason.is_some() && reports[i].world_from_camera.is_none());
    }
    assert!(reports[36..].iter().all(|r| r.state == TrackingState::Tracking));
    agent.finish();
    assert!(trajectory_error(agent.map()) < 0.01 * drive().path_length());
}

#[test]
fn the_reason_for_waiting_is_the_true_one() {
    let texture = "the image has too little texture";
    let mut agent = agent();
    let (width, height) = (Recording::SMALL_CAMERA.width, Recording::SMALL_CAMERA.height);
    let mut report = |index: u64, image: GrayImage| {
        agent.process(Frame { index, timestamp: index as f64, image, color: None }).unwrap()
    };
    let grey = report(0, GrayImage::filled(width, height, 128));
    assert_eq!((grey.state, grey.reason), (TrackingState::Starting, Some(texture)));
    let good = report(1, drive().shots[0].image.as_ref().clone());
    assert_eq!(good.state, TrackingState::Starting);
    assert_ne!(good.reason, Some(texture), "this image has texture");
    let black = report(2, GrayImage::filled(width, height, 0));
    assert_eq!((black.state, black.reason), (TrackingState::Starting, Some(texture)));
}

#[test]
fn an_agent_that_saw_nothing_ends_with_an_empty_map() {
    let mut agent = agent();
    agent.finish();
    assert!(agent.map().keyframes.is_empty() && agent.map().frames.is_empty());
}

#[test]
fn images_of_another_size_are_refused_and_do_no_harm() {
    let mut agent = agent();
    for (index, (width, height)) in [(640, 480), (319, 240), (320, 0)].into_iter().enumerate() {
        let image = GrayImage::filled(width, height, 128);
        let error =
            agent.process(Frame { index: index as u64, timestamp: 0.0, image, color: None }).unwrap_err();
        let AgentError::Size { image, camera, .. } = error else { panic!("{error}") };
        assert_eq!((image, camera), ((width, height), (320, 240)));
    }
    let error = agent.leave_out(Arc::new(Image::filled(640, 480, true))).unwrap_err();
    assert!(error.to_string().contains("the mask has 640 × 480 pixels, the camera 320 × 240"), "{error}");
    feed(&mut agent, as_it_is);
    agent.finish();
    assert!(agent.into_map() == finished().0);
}

#[test]
fn what_cannot_be_worked_with_makes_no_agent() {
    let make = |camera, params| {
        Agent::new(camera, Box::new(ThumbnailIndex::default()), params).map(|_| ()).unwrap_err()
    };
    let mut params = Params::default();
    params.track.cell = 0;
    assert!(matches!(make(Recording::SMALL_CAMERA, params), AgentError::Parameter(_)));
    for camera in [
        Pinhole { width: 0, ..Recording::SMALL_CAMERA },
        Pinhole { fx: 0.0, ..Recording::SMALL_CAMERA },
        Pinhole { cy: f64::NAN, ..Recording::SMALL_CAMERA },
    ] {
        assert!(matches!(make(camera, Params::default()), AgentError::Camera { .. }));
    }
}

/// A camera turns away and back for three seconds before it moves: no frame of it is followed before there is a map.
#[test]
fn a_camera_that_turns_first_gets_poses_from_the_map_that_comes() {
    let drive = trajectory::sideways(50, 2.5);
    let there = trajectory::turning(drive[0], 40, 0.5);
    let path: Vec<Se3> = there.iter().chain(there.iter().rev()).chain(&drive).copied().collect();
    let recording = Recording::render(yard(), Recording::SMALL_CAMERA, &path, 20.0).with_noise(1.0, 5);
    let mut agent = agent();
    feed_with(&mut agent, &recording, as_it_is);
    agent.finish();
    let map = agent.into_map();
    assert!(map.frames.len() as f64 >= 0.95 * path.len() as f64, "{} of {}", map.frames.len(), path.len());
    assert!(map.frames.is_sorted_by_key(|frame| frame.frame_index));
    let found: Vec<_> = map.trajectory().iter().map(|pose| pose.world_from_camera).collect();
    let truth: Vec<Se3> = map.frames.iter().map(|frame| path[frame.frame_index as usize]).collect();
    let centres = |poses: &[Se3]| poses.iter().map(|pose| pose.translation).collect::<Vec<_>>();
    let fit = umeyama::sim3(&centres(&found), &centres(&truth)).unwrap();
    let worst = found.iter().zip(&truth).map(|(f, t)| (fit * f.translation - t.translation).norm());
    let worst = worst.fold(0.0, f64::max);
    assert!(worst < 0.05, "a frame is {worst} m off");
}
