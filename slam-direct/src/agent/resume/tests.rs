//! Going on in a map, on a short rendered drive.

use super::*;
use crate::agent::{FrameReport, TrackingState, optimise_jointly};
use crate::frame::Frame;
use crate::test_scene::yard;
use geometry::{GrayImage, Sim3};
use loopbox_tests::{Recording, trajectory};
use map::{AgentId, AgentInfo, KeyframeId};
use nalgebra::{UnitQuaternion, Vector3};
use place_recog::ThumbnailIndex;
use std::ops::Range;
use std::sync::LazyLock;

/// A drive past the row of boxes.
fn drive() -> &'static Recording {
    static DRIVE: LazyLock<Recording> = LazyLock::new(|| {
        Recording::render(yard(), Recording::SMALL_CAMERA, &trajectory::sideways(60, 3.0), 20.0)
    });
    &DRIVE
}

fn feed(agent: &mut Agent, frames: Range<usize>) -> Vec<FrameReport> {
    let frame = |i: usize| Frame {
        index: i as u64,
        timestamp: drive().shots[i].timestamp,
        image: drive().shots[i].image.as_ref().clone(),
        color: None,
    };
    frames.map(|i| agent.process(frame(i)).unwrap()).collect()
}

fn places() -> Box<ThumbnailIndex> {
    Box::new(ThumbnailIndex::default())
}

fn mapped(frames: Range<usize>) -> Agent {
    let mut agent = Agent::new(Recording::SMALL_CAMERA, places(), Params::default()).unwrap();
    feed(&mut agent, frames);
    agent.finish();
    agent
}

fn resumed(map: Map, mode: ResumeMode) -> Agent {
    Agent::resume(map, places(), Params::default(), mode).unwrap()
}

/// Largest distance of the trajectory from the truth once world and unit are fitted, metres.
fn error(map: &Map) -> f64 {
    let found: Vec<_> = map.trajectory().iter().map(|p| p.world_from_camera.translation).collect();
    let truth = |f: &map::FramePose| drive().shots[f.frame_index as usize].world_from_camera.translation;
    let truth: Vec<_> = map.frames.iter().map(truth).collect();
    let fit = geometry::umeyama::sim3(&found, &truth).unwrap();
    found.iter().zip(&truth).map(|(f, t)| (fit * *f - t).norm()).fold(0.0, f64::max)
}

#[test]
fn a_map_is_extended_as_if_there_had_been_no_break() {
    let kept = mapped(0..35).into_map();
    let mut agent = resumed(kept.clone(), ResumeMode::Mapping);
    let reports = feed(&mut agent, 35..60);
    assert!(reports.iter().all(|report| report.state == TrackingState::Tracking));
    let mut replica = Map::new(Recording::SMALL_CAMERA);
    let deltas: Vec<MapDelta> = reports.into_iter().flat_map(|report| report.deltas).collect();
    assert!(deltas.iter().zip(0..).all(|(delta, number)| delta.sequence == number));
    deltas.into_iter().for_each(|delta| replica.take_in(delta));
    assert!(replica.keyframes == agent.map().keyframes);
    agent.finish();
    let map = agent.into_map();
    assert_eq!(map.frames.len(), drive().shots.len());
    assert!(map.keyframes.len() > kept.keyframes.len());
    for (id, keyframe) in &kept.keyframes {
        let now = &map.keyframes[id];
        assert!(now.image == keyframe.image && now.semi_dense == keyframe.semi_dense, "{id:?}");
    }
    let joins =
        |e: &map::Edge| (e.to.0 as usize) < kept.keyframes.len() && e.from.0 as usize >= kept.keyframes.len();
    assert!(map.edges.iter().any(joins), "new keyframes hang on old ones");
    let whole = error(&mapped(0..60).into_map());
    assert!(error(&map) < (1.2 * whole).max(0.01), "off by {} m, one run by {whole} m", error(&map));
}

#[test]
fn the_edges_of_a_map_without_are_made_of_its_points() {
    let map = mapped(0..60).into_map();
    let anew = edges_of(&Map { edges: Vec::new(), ..map.clone() }).unwrap();
    let ends = |edges: &[Edge]| edges.iter().map(|e| (e.from, e.to, e.kind)).collect::<Vec<_>>();
    assert!(!anew.is_empty());
    assert_eq!(ends(&anew), ends(&map.edges));
    for (a, b) in anew.iter().zip(&map.edges) {
        let apart = (a.from_from_to * b.from_from_to.inverse()).translation.norm();
        assert!(apart < 1e-6, "{:?} to {:?}: {apart}", a.from, a.to);
        // Numbers are kept as single precision in a map.
        let ratio = a.information.trace() / b.information.trace();
        assert!((ratio - 1.0).abs() < 1e-2, "{:?} to {:?}: {ratio}", a.from, a.to);
    }
    let mut gap = map;
    gap.keyframes.remove(&KeyframeId(1));
    assert!(edges_of(&gap).is_err());
}

#[test]
fn the_sensor_is_stored_with_the_map() {
    let mut params = Params::default();
    params.mapping.calibrate_from = 3;
    let mut agent = Agent::new(Recording::SMALL_CAMERA, places(), params).unwrap();
    let mut replica = Map::new(Recording::SMALL_CAMERA);
    for report in feed(&mut agent, 0..60) {
        report.deltas.into_iter().for_each(|delta| replica.take_in(delta));
    }
    let lens_of =
        |map: &Map| map.agents.values().next().and_then(|about| about.provenance.get("lens")).cloned();
    let lens = lens_of(agent.map()).expect("said from the first keyframes on");
    assert_ne!(lens, "0.0", "there are keyframes enough to solve for it");
    assert_eq!(lens_of(&replica), Some(lens.clone()));
    let mut map = agent.snapshot();
    let about = map.agents.values_mut().next().unwrap();
    about.provenance.insert("readout rows".into(), "0.02".into());
    let resumed = resumed(map, ResumeMode::Mapping).view;
    assert_eq!(resumed.sensor.lens.to_text(), lens);
    assert_eq!(resumed.sensor.readout, [0.0, 0.02]);
    // The camera drives to the right.
    let between = &resumed.keyframes[resumed.keyframes.len() / 2];
    assert!(
        between.motion[0] < -0.01 && between.motion.fixed_rows::<3>(3).norm() < 0.2,
        "{}",
        between.motion
    );
}

#[test]
fn who_localises_leaves_the_map_as_it_is() {
    let kept = mapped(0..60).into_map();
    let mut agent = resumed(kept.clone(), ResumeMode::Localising);
    // From the middle on, and then from the beginning.
    feed(&mut agent, 30..60);
    feed(&mut agent, 0..30);
    agent.finish();
    let map = agent.into_map();
    assert!(map.keyframes == kept.keyframes && map.edges == kept.edges);
    assert_eq!(map.frames.len(), 60);
    let depth = 5.0;
    for frame in &map.frames {
        let there = kept.frames.iter().find(|f| f.frame_index == frame.frame_index).unwrap();
        let [now, then] = [(&map, frame), (&kept, there)].map(|(m, f)| m.world_from_frame(f).unwrap());
        let off = (now.translation - then.translation).norm();
        assert!(off < 0.01 * depth * kept.keyframes[&KeyframeId(0)].world_from_keyframe.scale, "{off}");
    }
}

#[test]
fn a_pose_of_which_too_little_is_seen_is_not_reported() {
    // From the end of the drive the camera moves on and turns away from what was mapped.
    let drive = trajectory::sideways(35, 1.75);
    let away = (1..30).map(|i| {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.035 * f64::from(i));
        drive[34] * Se3::new(yaw, Vector3::new(0.05 * f64::from(i), 0.0, 0.0))
    });
    let path: Vec<Se3> = drive.iter().copied().chain(away).collect();
    let recording = Recording::render(yard(), Recording::SMALL_CAMERA, &path, 20.0);
    let frame = |i: usize| Frame {
        index: i as u64,
        timestamp: recording.shots[i].timestamp,
        image: recording.shots[i].image.as_ref().clone(),
        color: None,
    };
    let mut agent = Agent::new(Recording::SMALL_CAMERA, places(), Params::default()).unwrap();
    (0..35).for_each(|i| _ = agent.process(frame(i)).unwrap());
    agent.finish();
    let mut params = Params::default();
    // Images without noise tell more.
    params.track.max_deviation = 0.0005;
    let mut agent = Agent::resume(agent.into_map(), places(), params, ResumeMode::Localising).unwrap();
    let reports: Vec<FrameReport> = (0..path.len()).map(|i| agent.process(frame(i)).unwrap()).collect();
    let is_reported = |report: &&FrameReport| report.world_from_camera.is_some();
    assert!(reports[..40].iter().all(|report| report.state == TrackingState::Tracking));
    let uncertain: Vec<&FrameReport> = reports
        .iter()
        .filter(|report| report.reason.is_some_and(|why| why.contains("too little of the map")))
        .collect();
    assert!(
        !uncertain.is_empty() && !uncertain.iter().any(|r| is_reported(r) || r.state != TrackingState::Lost)
    );
    assert_eq!(agent.map().frames.len(), reports.iter().filter(is_reported).count());
}

/// Two drives, the second from the middle of the first on, each in a unit of its own, in the world of the first.
fn common(drives: [Range<usize>; 2]) -> Map {
    let maps = drives.map(|frames: Range<usize>| mapped(frames).into_map());
    let [one, other] = maps.each_ref().map(|map| {
        let [first, last] = [&map.frames[0], &map.frames[map.frames.len() - 1]].map(|frame| {
            let truth = drive().shots[frame.frame_index as usize].world_from_camera;
            (map.world_from_frame(frame).unwrap().rigid(), truth)
        });
        let distance = |from: Se3, to: Se3| (to.translation - from.translation).norm();
        let scale = distance(first.1, last.1) / distance(first.0, last.0);
        let metres = Sim3::new(Default::default(), Default::default(), scale);
        Sim3::from(first.1) * metres * Sim3::from(first.0).inverse()
    });
    let mut map = Map::unite(maps.into()).unwrap();
    for keyframe in map.keyframes.values_mut().filter(|keyframe| keyframe.agent == AgentId(1)) {
        keyframe.world_from_keyframe = one.inverse() * other * keyframe.world_from_keyframe;
    }
    map
}

#[test]
fn poses_are_reported_in_the_common_map_of_several_agents() {
    let kept = common([0..35, 25..60]);
    let mut agent = resumed(kept.clone(), ResumeMode::Localising);
    let reports = feed(&mut agent, 0..60);
    assert!(reports.iter().all(|report| report.state == TrackingState::Tracking));
    agent.finish();
    let map = agent.into_map();
    assert!(map.keyframes == kept.keyframes && map.edges == kept.edges && map.agents == kept.agents);
    let whose: Vec<u16> = map.frames.iter().map(|frame| map.keyframes[&frame.reference].agent.0).collect();
    assert!(whose.first() == Some(&0) && whose.last() == Some(&1), "{whose:?}");
    assert!(error(&map) < 0.02, "off by {} m", error(&map));
}

#[test]
fn who_extends_a_common_map_is_one_more_of_its_agents() {
    let kept = common([0..25, 12..35]);
    let mut agent = resumed(kept.clone(), ResumeMode::Mapping);
    let reports = feed(&mut agent, 28..60);
    assert!(reports.iter().all(|report| report.state == TrackingState::Tracking));
    assert_eq!(
        reports[0].new_keyframe,
        Some(KeyframeId(0)),
        "the first frame is a keyframe, whatever is known"
    );
    let mut replica = Map::new(Recording::SMALL_CAMERA);
    reports.into_iter().flat_map(|report| report.deltas).for_each(|delta| replica.take_in(delta));
    assert!(replica.keyframes == agent.map().keyframes);
    agent.finish();
    let joint = agent.joint().unwrap();
    let own = agent.into_map();
    assert_eq!(own.frames.len(), 32);
    assert!(own.keyframes.keys().copied().eq((0..own.keyframes.len() as u32).map(KeyframeId)));
    assert!(own.frames.iter().all(|frame| own.keyframes.contains_key(&frame.reference)));
    let observers = own.keyframes.values().flat_map(|k| &k.points).flat_map(|p| &p.observations);
    assert!(
        observers.clone().count() > 100 && observers.clone().all(|o| own.keyframes.contains_key(&o.keyframe))
    );
    // In the world of the common map.
    let map = joint.united(own.clone()).unwrap();
    assert!(error(&map) < 0.02, "off by {} m", error(&map));
    let alone = [kept.split(), vec![own]].concat();
    assert!(map.split() == alone, "every agent's own map comes out of it bit by bit");
    let is_tie = |edge: &&Edge| {
        let [from, to] = [edge.from, edge.to].map(|id| map.keyframes[&id].agent);
        edge.kind == map::EdgeKind::Merge && from == AgentId(2) && to != AgentId(2)
    };
    assert!(map.edges.iter().filter(is_tie).count() > 2, "its first keyframes hang on the others'");
    // And it is a common map, that can be gone on in.
    let mut agent = resumed(map, ResumeMode::Localising);
    assert!(feed(&mut agent, 0..60).iter().all(|report| report.state == TrackingState::Tracking));
}

#[test]
fn agents_of_a_common_map_that_is_extended_observe_each_other() {
    let (kept, params) = (common([0..25, 12..35]), Params::default());
    let first = kept.keyframes.values().filter(|keyframe| keyframe.agent == AgentId(0)).count();
    let across = |local: &LocalMap| {
        let seen = |host: usize| local.keyframes[host].points.iter().flat_map(|p| &p.observations);
        let crosses =
            |host: usize| seen(host).filter(move |o| (o.keyframe < first) != (host < first)).count();
        (0..local.keyframes.len()).map(crosses).sum::<usize>()
    };
    let local = |map: &Map| {
        let sensor = sensor_of(map).unwrap();
        working_map(map, sensor, params.align.pyramid_levels).unwrap()
    };
    let mut together = local(&kept);
    assert_eq!(across(&together), 0, "a merge says how they lie to each other and no more");
    observe_others(&mut together, &kept, &params);
    assert!(across(&together) > 200, "{}", across(&together));
    // Another place shows nothing of it: the second agent looks the other way.
    let mut turned = kept;
    let back = Sim3::from(crate::test_scene::pose(0.0, 0.0, 0.0, std::f64::consts::PI, 0.0));
    for keyframe in turned.keyframes.values_mut().filter(|keyframe| keyframe.agent == AgentId(1)) {
        keyframe.world_from_keyframe = keyframe.world_from_keyframe * back;
    }
    let mut apart = local(&turned);
    observe_others(&mut apart, &turned, &params);
    assert_eq!(across(&apart), 0);
}

#[test]
fn agents_of_a_common_map_are_optimised_jointly() {
    let (kept, params) = (common([0..35, 15..60]), Params::default());
    // The second agent's map is put down a little beside where it belongs, and a little too large.
    let mut off = kept.clone();
    let perturbation = Sim3::new(Default::default(), Vector3::new(0.02, 0.01, 0.0), 1.01);
    for keyframe in off.keyframes.values_mut().filter(|keyframe| keyframe.agent == AgentId(1)) {
        keyframe.world_from_keyframe = perturbation * keyframe.world_from_keyframe;
    }
    let mut map = off.clone();
    optimise_jointly(&mut map, &params, &|| false).unwrap();
    let [before, after, least] = [&off, &map, &kept].map(error);
    assert!(before > 3.0 * least && after < 0.4 * before, "{before} to {after} m, {least} at the least");
    let first = |map: &Map| map.keyframes[&KeyframeId(0)].world_from_keyframe;
    let (was, is) = (first(&off), first(&map));
    assert!((was.translation - is.translation).norm() < 0.01 && (is.scale / was.scale - 1.0).abs() < 0.01);
    assert!(map.split() == off.split(), "the agents' own maps stay bit by bit");
    let mut stopped = off.clone();
    optimise_jointly(&mut stopped, &params, &|| true).unwrap();
    assert!(error(&stopped) > 0.9 * before, "an optimisation that was stopped moved what it had not asked");
}

#[test]
fn a_common_map_whose_first_agent_holds_no_world_stays_as_it_is() {
    let kept = common([0..35, 25..60]);
    let mut map = kept.clone();
    let first = |id: &KeyframeId, map: &Map| map.keyframes[id].agent == AgentId(0);
    let here = map.keyframes[&KeyframeId(0)].world_from_keyframe;
    for id in kept.keyframes.keys().filter(|id| first(id, &kept)) {
        map.keyframes.get_mut(id).unwrap().world_from_keyframe = here;
    }
    let before = map.clone();
    assert!(matches!(optimise_jointly(&mut map, &Params::default(), &|| false), Err(AgentError::Map(_))));
    assert!(map == before);
}

#[test]
fn what_is_found_nowhere_changes_nothing() {
    let kept = mapped(0..35).into_map();
    let mut agent = Agent::resume(kept.clone(), places(), Params::default(), ResumeMode::Mapping).unwrap();
    let image = GrayImage::filled(320, 240, 90);
    for index in 0..100 {
        let frame = Frame { index, timestamp: index as f64, image: image.clone(), color: None };
        assert_eq!(agent.process(frame).unwrap().state, TrackingState::Lost);
    }
    agent.finish();
    assert!(agent.into_map() == kept, "it is not given up either");
}

#[test]
fn maps_that_cannot_be_gone_on_with_are_refused() {
    let refuse = |map: Map| {
        let agent = Agent::resume(map, places(), Params::default(), ResumeMode::Mapping).map(|_| ());
        agent.unwrap_err().to_string()
    };
    assert!(refuse(Map::new(Recording::SMALL_CAMERA)).contains("no points"));
    let lidar = Map::of(AgentInfo::new("rover", map::Sensor::Lidar));
    assert!(refuse(lidar).contains("LiDAR"));
    let kept = mapped(0..35).into_map();
    let mut without = kept.clone();
    without.keyframes.remove(&KeyframeId(1));
    assert!(refuse(without).contains("keyframe 1 is missing"));
    let of_two = |camera| Map::unite(vec![kept.clone(), Map::of(AgentInfo::new("other", camera))]).unwrap();
    assert!(refuse(of_two(map::Sensor::Lidar)).contains("\"other\" has a LiDAR"));
    let wide = geometry::Pinhole { fx: 100.0, ..Recording::SMALL_CAMERA };
    assert!(refuse(of_two(wide.into())).contains("different cameras"));
}
