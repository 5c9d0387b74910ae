//! Motion that leaves the map, comes back to it, or gives it no parallax.

use crate::documented::assert_documented;
use crate::support::{Case, Outcome, RATE, drive, hand_held, loopbox, restamped, world};
use geometry::Se3;
use loopbox_tests::{Recording, World, trajectory};

fn render(path: &[Se3]) -> Recording {
    Recording::render(world(), Recording::SMALL_CAMERA, path, RATE)
}

/// Time stamps of the frames in the trajectory, seconds.
fn tracked_times(case: &Case) -> Vec<f64> {
    case.map().trajectory().iter().map(|pose| pose.timestamp).collect()
}

#[test]
fn fifteen_dropped_frames_do_not_end_the_map() {
    let mut recording = drive();
    recording.shots.drain(45..60);
    let case = Case::new(&recording);
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 12);
}

/// The camera jumps from the end of its path to an earlier place that it sees from a new angle, too far to be
/// tracked: only relocalisation brings the frames into the same map.
#[test]
fn a_jump_to_a_known_place_is_relocalised_into_the_same_map() {
    let mut recording = drive();
    let offset = Se3::new(Default::default(), nalgebra::Vector3::new(0.04, 0.02, 0.05));
    let back: Vec<Se3> = recording.shots[20..50].iter().map(|s| s.world_from_camera * offset).collect();
    recording.shots.extend(render(&back).shots);
    let recording = restamped(recording);
    let case = Case::new(&recording);
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 14);
    let after = tracked_times(&case).iter().filter(|&&t| t > 89.5 / RATE).count();
    assert!(after >= 20, "{after} of 30 frames tracked after the jump\n{outcome}");
}

/// Turning in place gives no depth: nothing may be made up from it, and the drive that follows must be mapped.
#[test]
fn a_start_of_pure_rotation_makes_no_wrong_map() {
    let drive = trajectory::sideways(80, 4.0);
    let angle = 0.3;
    let rotation = Se3::new(
        nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), -angle),
        Default::default(),
    );
    let mut path = trajectory::turning(drive[0] * rotation, 30, angle);
    path.extend(&drive[1..]);
    let case = Case::new(&render(&path));
    let outcome = case.run(&[]);
    case.assert_accurate(&outcome);
    let driving = tracked_times(&case).iter().filter(|&&t| t > 29.5 / RATE).count();
    assert!(driving >= 60, "{driving} of 79 frames tracked after the turn\n{outcome}");
}

#[test]
fn pure_rotation_in_the_middle_is_survived() {
    let drive = trajectory::sideways(90, 4.5);
    let mut path = drive[..45].to_vec();
    let there = trajectory::turning(drive[44], 21, 0.35);
    path.extend(&there[1..]);
    path.extend(there.iter().rev().skip(1));
    path.extend(&drive[45..]);
    let case = Case::new(&render(&path));
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 4);
}

/// A recording of nothing but turning holds no map; that is said, not hidden behind an empty success.
#[test]
fn a_recording_of_pure_rotation_is_refused() {
    let start = trajectory::sideways(3, 2.0)[1];
    let case = Case::new(&render(&trajectory::turning(start, 40, 0.4)));
    case.run(&[]).assert_refused(&["no frame could be tracked", "sideways"]);
}

/// Two rounds of the same motion fall on each other: there is one copy of the scene, not two.
#[test]
fn a_motion_that_repeats_stays_in_one_place() {
    let case = Case::new(&hand_held(120));
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 2);
    let poses = case.map().trajectory();
    let extent = poses
        .iter()
        .map(|p| (p.world_from_camera.translation - poses[0].world_from_camera.translation).norm());
    let extent = extent.fold(0.0, f64::max);
    let apart = (30..60).map(|i| {
        let (once, again) = (&poses[i].world_from_camera, &poses[i + 60].world_from_camera);
        (once.translation - again.translation).norm()
    });
    let apart = apart.fold(0.0, f64::max) / extent;
    assert!(apart < 0.005, "the rounds are {:.2} % of their extent apart\n{outcome}", 100.0 * apart);
}

/// Once round the group of boxes and on past the start: the loop is found and closed.
#[test]
fn an_orbit_closes_its_loop() {
    let case = Case::new(&render(&trajectory::orbit(240, 3.0, 1.08)));
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 4);
    let map = case.map();
    let frame = |id| map.keyframes[&id].frame_index;
    let meets = |e: &&map::Edge| frame(e.from).abs_diff(frame(e.to)) > 180;
    assert!(map.edges.iter().any(|e| meets(&e)), "no edge joins the end to the beginning\n{outcome}");
}

/// The camera is carried to another world: what it maps there has files of its own, which are named.
#[test]
fn a_camera_carried_elsewhere_begins_a_second_fragment() {
    let mut recording = drive();
    recording.shots.truncate(60);
    let path = trajectory::sideways(80, 4.0);
    recording.shots.extend(Recording::render(&World::yard(2), recording.camera, &path, RATE).shots);
    let case = Case::new(&restamped(recording));
    let outcome = case.run(&[]);
    outcome.assert_success();
    let text = std::fs::read(case.out().join("run.json")).expect("the numbers are written");
    let record: serde_json::Value = serde_json::from_slice(&text).expect("they are JSON");
    let fragments = record["fragments"].as_array().expect("the fragments are listed");
    assert_eq!(fragments.len(), 2, "{outcome}");
    // That of most frames comes first: the second drive, but for the half second of search.
    let numbers =
        |of: &serde_json::Value| ["frames", "first_frame", "last_frame"].map(|n| of[n].as_u64().expect(n));
    let [frames, first, last] = numbers(&fragments[0]);
    assert!(frames >= 62 && first >= 60 && last == 139, "{fragments:?}");
    let [frames, first, last] = numbers(&fragments[1]);
    assert!(frames >= 58 && first == 0 && last == 59, "{fragments:?}");
    assert_eq!(fragments[1]["trajectory"], "trajectory-2.txt");
    let apart = map::load_map(case.out().join("map-2.mcap")).expect("the second map loads").map;
    assert_eq!(apart.frames.len() as u64, frames);
    assert!(case.out().join("trajectory-2.txt").is_file());
    outcome.assert_says(&["trajectory-2.txt"]);
    let evaluate = |more: &[&str]| {
        let mut command = loopbox();
        command.arg("eval").arg(case.out()).arg("--gt").arg(case.source().join("groundtruth.txt")).args(more);
        Outcome::of(command)
    };
    let found: serde_json::Value = serde_json::from_str(&evaluate(&["--json"]).text).expect("it is JSON");
    assert_documented(&found);
    let [apart] = found["fragments"].as_array().expect("the other fragment is measured").as_slice() else {
        panic!("there is one other: {found}")
    };
    assert_eq!((&apart["trajectory"], &apart["pairs"]), (&"trajectory-2.txt".into(), &frames.into()));
    let errors = [&found["ate"]["rmse"], &apart["ate"]["rmse"]].map(|rmse| rmse.as_f64().expect("a number"));
    assert!(errors.iter().all(|&rmse| rmse < 0.02), "{errors:?} m");
    evaluate(&[]).assert_says(&["other fragments, each aligned by itself", "trajectory-2.txt"]);
}

/// The lens is covered while the camera is carried on; later it comes by where it was before: one map in the end.
#[test]
fn a_camera_carried_elsewhere_and_back_ends_with_one_map() {
    let drive_back = trajectory::sideways(150, 7.5);
    let mut recording = render(&drive_back[..70]);
    let mut covered = render(&vec![drive_back[70]; 20]);
    let black =
        |_, image: &geometry::GrayImage| geometry::GrayImage::filled(image.width(), image.height(), 0);
    crate::support::repaint(&mut covered, 0..20, black);
    recording.shots.extend(covered.shots);
    let back: Vec<Se3> = drive_back[20..].iter().rev().copied().collect();
    recording.shots.extend(render(&back).shots);
    let case = Case::new(&restamped(recording));
    let outcome = case.run(&[]);
    let tracked = case.assert_accurate(&outcome);
    assert!(tracked >= 180, "{tracked} of the 200 frames that show something hang together\n{outcome}");
    assert!(!case.out().join("map-2.mcap").exists(), "{outcome}");
}

/// A camera that turns before it moves has no map yet; its frames get their poses from the one that comes, and are counted.
#[test]
fn frames_from_before_the_map_are_found_later_and_counted() {
    let drive = trajectory::sideways(60, 3.0);
    let there = trajectory::turning(drive[0], 45, 0.5);
    let path: Vec<_> = there.iter().chain(there.iter().rev()).chain(&drive).copied().collect();
    let case = Case::new(&render(&path));
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 5);
    let record = std::fs::read_to_string(case.out().join("run.json")).expect("the run wrote its record");
    let record: serde_json::Value = serde_json::from_str(&record).expect("it is JSON");
    let later = record["frames"]["found_later"].as_u64().expect("run.json counts them");
    assert!((85..120).contains(&later), "{later} found later\n{outcome}");
}
