//! Agents in a ray-cast hall: mapped, saved, loaded, merged.

use super::merging::{Input, LidarMergeParams, LidarMergeRecord, decision, merge};
use super::poses::GivenPoses;
use super::run::{Event, LidarRun, RunOptions, run};
use geometry::Se3;
use loopbox_tests::lidar::{HALL, PERIOD, Return, sweep, walk};
use loopbox_tests::pages::{assert_points_nowhere, embedded, opened};
use map::{AgentInfo, Map, Sensor};
use scans::{NextScan, Scan, ScanError, ScanInfo, ScanSource};
use slam_lidar::mapping::MappingParams;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Scans along a way, ray-cast as they are asked for.
struct Cast<P> {
    info: ScanInfo,
    pose: P,
    next: u64,
    /// Every so many scans, one is unreadable.
    bad_every: u64,
}

impl<P: Fn(f64) -> Se3> Cast<P> {
    fn new(pose: P, duration: f64) -> Self {
        let count = (duration / PERIOD) as u64;
        let path = PathBuf::from("cast");
        let info = ScanInfo {
            path,
            kind: "cast".into(),
            count: Some(count),
            duration: Some(duration),
            is_kitti: false,
            facts: Vec::new(),
        };
        Self { info, pose, next: 0, bad_every: u64::MAX }
    }
}

impl<P: Fn(f64) -> Se3> ScanSource for Cast<P> {
    fn info(&self) -> &ScanInfo {
        &self.info
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        let index = self.next;
        self.next += 1;
        let stamp = index as f64 * PERIOD;
        let scan = || {
            let returns = sweep(&HALL, &self.pose, stamp);
            let points = returns.iter().map(|r: &Return| r.point).collect();
            let times = returns.iter().map(|r| r.time).collect();
            let rings = returns.iter().map(|r| r.ring.into()).collect();
            Scan { stamp, points, times, rings, stale: 0 }
        };
        let bad = || ScanError::Format { name: "cast".into(), what: "cut off".into() };
        let scan = if (index + 1).is_multiple_of(self.bad_every) { Err(bad()) } else { Ok(scan()) };
        (index < self.info.count?).then_some(NextScan { index, stamp, scan })
    }
}

fn options(name: &str) -> RunOptions {
    let about = AgentInfo::new(name, Sensor::Lidar);
    RunOptions { about, params: MappingParams::default(), poses: None, start: None, end: None }
}

/// The map of a way, and the largest error of its poses, metres.
fn mapped(name: &str, corners: &[[f64; 2]]) -> (LidarRun, f64) {
    let (pose, duration) = walk(corners);
    let done = run(&mut Cast::new(&pose, duration), options(name), &mut |_| Ok(ControlFlow::Continue(())));
    let done = done.unwrap();
    let trajectory = done.maps[0].trajectory();
    let world = pose(trajectory[0].timestamp);
    let off = |found: &map::StampedPose| {
        let truth = world.inverse() * pose(found.timestamp);
        (truth.translation - found.world_from_camera.translation).norm()
    };
    let worst = trajectory.iter().map(off).fold(0.0, f64::max);
    (done, worst)
}

/// Along the northern aisle, and the same way back from beyond.
const A: [[f64; 2]; 2] = [[-11.0, 4.5], [3.0, 4.5]];
const B: [[f64; 2]; 2] = [[9.0, 5.0], [-6.0, 5.5]];

#[test]
fn agents_map_a_hall_and_their_maps_come_together() {
    let folder = tempfile::tempdir().unwrap();
    let mut given = Vec::new();
    for (name, corners) in [("a", A), ("b", B)] {
        let (done, worst) = mapped(name, &corners);
        assert!(worst < 0.05, "{name}: {worst:.3} m");
        assert_eq!(done.record.scans.tracked, done.maps[0].frames.len() as u64);
        assert!(done.maps[0].keyframes.len() >= 14, "{}", done.maps[0].keyframes.len());
        let path = folder.path().join(format!("{name}.mcap"));
        map::save_map(&path, &done.maps[0]).unwrap();
        let loaded = map::load_map(&path).unwrap().map;
        assert_eq!(loaded, done.maps[0]);
        // The whole file, views of at most 8192 points among it; the format says three bytes a point.
        let bytes = std::fs::metadata(&path).unwrap().len() as usize;
        assert!(bytes < 20 * done.record.map.points, "{bytes} bytes, {} points", done.record.map.points);
        given.push((path, loaded));
    }
    let inputs = Input::all(given.clone()).unwrap();
    let merging = merge(&inputs, &LidarMergeParams::default(), &mut |_| Ok(())).unwrap();
    assert_eq!(decision(&merging.pairs[0]), "accepted", "{}", merging.pairs[0].reason());
    let [group] = &merging.groups[..] else { panic!("one group is expected") };
    // Both in the frame of a's first sweep, whose middle the poses belong to.
    let (paths, middle) = ([walk(&A).0, walk(&B).0], 0.5 * PERIOD);
    let world = paths[0](middle);
    for keyframe in group.map.keyframes.values() {
        let truth = world.inverse() * paths[usize::from(keyframe.agent.0)](keyframe.timestamp);
        let off = truth.inverse() * keyframe.world_from_keyframe.rigid();
        assert!(off.translation.norm() < 0.05, "keyframe {}: {:.3} m", keyframe.id.0, off.translation.norm());
    }
    assert_eq!(group.map.edges.iter().filter(|edge| edge.kind == map::EdgeKind::Merge).count(), 1);
    let own: Vec<Map> = given.into_iter().map(|(_, map)| map).collect();
    assert_eq!(group.map.split(), own, "a merge can be undone");
    let record = LidarMergeRecord::of(&inputs, &merging);
    assert_eq!((record.pair_results.len(), record.groups.len()), (1, 1));
    let off = paths[0](middle).inverse() * paths[1](middle);
    let found = Se3::from_tum(record.inputs[1].world_from_map);
    assert!((off.inverse() * found).translation.norm() < 0.05);
}

/// The same agent along two ways, between which it is carried from the end of the one to the begin of the other.
fn carried(paths: [&[[f64; 2]]; 2]) -> (LidarRun, impl Fn(f64) -> Se3) {
    let [(one, first), (other, second)] = paths.map(walk);
    let change = (first / PERIOD).ceil() * PERIOD;
    let pose = move |time: f64| if time < change { one(time) } else { other(time - change) };
    let done =
        run(&mut Cast::new(&pose, change + second), options("a"), &mut |_| Ok(ControlFlow::Continue(())));
    (done.unwrap(), pose)
}

#[test]
fn a_sensor_that_is_carried_to_where_it_was_ends_with_one_map() {
    let (done, pose) = carried([&A, &B]);
    let scans = &done.record.scans;
    assert_eq!((scans.losses, scans.tracked_apart, scans.skipped["lost"]), (1, 0, 2), "{scans:?}");
    assert!(done.maps.len() == 1 && done.record.fragments.len() == 1 && done.record.fragments[0].joined == 2);
    assert_eq!(scans.tracked, done.maps[0].frames.len() as u64);
    let world = pose(0.5 * PERIOD);
    let trajectory = done.maps[0].trajectory();
    assert!(trajectory.windows(2).all(|pair| pair[0].timestamp < pair[1].timestamp));
    for found in trajectory {
        let off = (world.inverse() * pose(found.timestamp)).translation - found.world_from_camera.translation;
        assert!(off.norm() < 0.05, "{:.3} m at {:.1} s", off.norm(), found.timestamp);
    }
}

#[test]
fn a_sensor_that_is_carried_to_where_nothing_is_known_has_two_maps() {
    // Two scans' way from where the first one ends, and back to the far end of the hall: too short for a merge.
    let (done, pose) = carried([&A, &[[9.0, -5.0], [7.0, -5.0]]]);
    let [first, other] = &done.maps[..] else { panic!("{:?}", done.record.fragments) };
    let scans = &done.record.scans;
    assert_eq!((scans.losses, scans.tracked_apart), (1, other.frames.len() as u64));
    let ids = [first, other].map(|map| map.agents.values().next().unwrap().identity.unwrap());
    assert!(ids[0].uuid == ids[1].uuid && (ids[0].epoch, ids[1].epoch) == (0, 1));
    for map in [first, other] {
        let trajectory = map.trajectory();
        let world = pose(trajectory[0].timestamp) * trajectory[0].world_from_camera.inverse();
        let off = |p: &map::StampedPose| {
            (world.inverse() * pose(p.timestamp)).translation - p.world_from_camera.translation
        };
        assert!(trajectory.iter().all(|p| off(p).norm() < 0.05));
    }
}

#[test]
fn a_map_on_given_poses_is_where_these_are() {
    let (pose, duration) = walk(&[[-11.0, 4.5], [-5.0, 4.5]]);
    let poses = (0..(duration * 100.0) as usize).map(|i| 0.01 * i as f64).map(|t| (t, pose(t))).collect();
    let options = RunOptions { poses: Some(GivenPoses::new(poses).unwrap()), ..options("a") };
    let done = run(&mut Cast::new(&pose, duration), options, &mut |_| Ok(ControlFlow::Continue(()))).unwrap();
    assert!(done.record.given_poses && done.record.scans.skipped.is_empty());
    for keyframe in done.maps[0].keyframes.values() {
        let off = pose(keyframe.timestamp).inverse() * keyframe.world_from_keyframe.rigid();
        // Between a sweep's ends the sensor is taken to keep its speed.
        assert!(off.log().norm() < 5e-3, "{off:?}");
    }
}

#[test]
fn bad_scans_are_counted_with_their_reason_and_a_run_can_be_ended() {
    let (pose, duration) = walk(&[[-11.0, 4.5], [-8.0, 4.5]]);
    let mut source = Cast { bad_every: 4, ..Cast::new(&pose, duration) };
    let mut skipped = Vec::new();
    let mut observe = |event: Event<'_>| {
        Ok(match event {
            Event::Scan { row, map, .. } => {
                assert_eq!(map.frames.last().map(|frame| frame.frame_index), Some(row.index));
                if row.index == 9 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            }
            Event::Skipped { index, reason, detail } => {
                skipped.push((index, reason, detail.to_owned()));
                ControlFlow::Continue(())
            }
        })
    };
    let done = run(&mut source, options("a"), &mut observe).unwrap();
    assert_eq!(skipped.iter().map(|s| (s.0, s.1)).collect::<Vec<_>>(), [(3, "damaged"), (7, "damaged")]);
    assert!(skipped[0].2.contains("cut off"));
    assert!(done.record.interrupted);
    let scans = &done.record.scans;
    assert_eq!((scans.offered, scans.tracked, scans.skipped["damaged"]), (10, 8, 2));
    let mut bad = Cast { bad_every: 1, ..Cast::new(&pose, duration) };
    let error = run(&mut bad, options("a"), &mut |_| Ok(ControlFlow::Continue(()))).err().unwrap();
    assert!(error.to_string().contains("no scan could be used: cast: cut off"), "{error}");
}

#[test]
fn maps_of_cameras_are_refused() {
    let camera = geometry::Pinhole { width: 4, height: 3, fx: 2.0, fy: 2.0, cx: 1.5, cy: 1.0 };
    let given = vec![(PathBuf::from("yard.mcap"), Map::new(camera))];
    let error = Input::all(given).err().unwrap();
    assert!(
        format!("{error:#}").contains("yard.mcap") && format!("{error:#}").contains("has a camera"),
        "{error:#}"
    );
}

#[test]
fn the_report_shows_scans_with_the_tools_of_all_maps() {
    let (done, _) = mapped("a", &[[-11.0, 4.5], [-6.0, 4.5]]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    super::report::of_run(&path, &done.maps[0], &done.agent, &done.record).unwrap();
    let page = std::fs::read_to_string(path).unwrap();
    assert_points_nowhere(&page);
    let alone = folder.path().join("alone.html");
    crate::write_report(&alone, &done.maps[0]).unwrap();
    let alone = embedded(&std::fs::read_to_string(alone).unwrap());
    assert_eq!(alone["cloud"], embedded(&page)["cloud"], "a map alone has the same report");
    assert_eq!(alone["plots"].as_array().map(Vec::len), Some(0), "but for what its scans took");
    for tool in ["measure", "cut-sides", "save-cloud", "save-path"] {
        assert!(page.contains(&format!(r#"id="{tool}""#)), "{tool}");
    }
    let data = embedded(&page);
    let points: usize =
        done.maps[0].keyframes.values().filter_map(|k| k.scan.as_ref()).map(|s| s.len()).sum();
    assert_eq!(data["cloud"]["total"], points);
    assert_eq!(data["scene"]["keyframes"]["count"], done.maps[0].keyframes.len());
    assert!(data["scene"]["agents"][0]["camera"].is_null() && data["scene"]["metric"] == true, "{data}");
    // It stands upright and looks ahead, from where its map begins.
    let direction = |name: &str| {
        let axes = data["scene"][name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
        nalgebra::Vector3::from_iterator(axes)
    };
    assert!(direction("up").z > 0.99 && direction("forward").x > 0.99, "{}", direction("forward"));
    let Some(dom) = opened(&page) else {
        eprintln!("SKIPPED: no Chromium here, the report was not opened in a browser");
        return;
    };
    let works = ["complete", "without-3d"].iter().any(|how| dom.contains(&format!(r#"data-report="{how}""#)));
    assert!(works, "the page's scripts did not run to their end");
    assert!(
        dom.contains("Places refused") && dom.contains("milliseconds a scan"),
        "tables and plots are there"
    );
}
