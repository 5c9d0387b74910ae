//! Places that look alike, and places that are the same, with the truth known.

use super::*;
use crate::closure::align;
use crate::keyframe::Keyframe;
use crate::merging::merge;
use crate::merging::robot_map::RobotMap;
use crate::merging::verdict::Decision;
use loopbox_tests::lidar::Corners;
use loopbox_tests::lidar_open::{Walls, tunnel};
use loopbox_tests::lidar_paths::{Carried, Carrier};
use loopbox_tests::lidar_sensors::Sensor;
use loopbox_tests::lidar_stairs::stairs;

const DEVIATION: (f64, f64) = (0.01, 0.001);
/// Metres of a tunnel and of the halls on either side of it.
const LENGTH: f64 = 40.0;
const HALL: f64 = 14.0;

/// A sensor's place on the floor and its heading, radians.
fn place(x: f64, y: f64, yaw: f64) -> Se3 {
    Se3::new(UnitQuaternion::from_scaled_axis(Vector3::z() * yaw), Vector3::new(x, y, 0.0))
}

/// What a sensor at rest sees from seven places a metre apart around `middle`.
fn seen(boxes: &[Corners], sensor: Sensor, middle: &Se3, sweep: usize) -> Vec<Keyframe> {
    let keyframe = |k: usize| {
        let pose = *middle * place(k as f64 - 3.0, 0.0, 0.0);
        let sensed = sensor.sweep(boxes, |_| pose, (sweep + k) as f64 * 0.1);
        Keyframe::new(0.0, pose, sensed.iter().map(|s| s.point).collect())
    };
    (0..7).map(keyframe).collect()
}

fn submap(keyframes: &[Keyframe]) -> Submap {
    Submap::new(keyframes.iter(), &keyframes[3].world_from_sensor)
}

/// A place and another as maps, each in the frame of its submap.
fn maps(one: &[Keyframe], other: &[Keyframe]) -> [RobotMap; 2] {
    [one, other].map(|keyframes| {
        let from_world = keyframes[3].world_from_sensor.inverse();
        let moved =
            |k: &Keyframe| Keyframe { world_from_sensor: from_world * k.world_from_sensor, ..k.clone() };
        RobotMap::new(&keyframes.iter().map(moved).collect::<Vec<_>>())
    })
}

/// Odometry along straight pieces of path, a keyframe a metre, that errs by a share of it and by radians a metre.
fn drift(corners: &[Se3], share: f64, turn: f64) -> Drift {
    let (mut drift, mut pose) = (Drift::default(), Se3::identity());
    drift.push(&pose, &Doubt::default());
    for pair in corners.windows(2) {
        let motion = pair[0].inverse() * pair[1];
        let count = motion.translation.norm().ceil().max(1.0);
        let step = Se3::exp(&(motion.log() / count));
        for _ in 0..count as usize {
            pose = pose * step * place(share * step.translation.norm(), 0.0, turn);
            drift.push(&pose, &Doubt::default());
        }
    }
    drift
}

/// What the odometry says of the ends of a path.
fn ends(corners: &[Se3], share: f64, turn: f64) -> Tracked {
    let drift = drift(corners, share, turn);
    drift.between(0, drift.poses.len() - 1, &[], DEVIATION)
}

/// The hall before a tunnel and the one after it, turned by half a turn, fit in each other's place by their surfaces.
#[test]
fn halls_at_the_ends_of_a_tunnel_are_not_one_place() {
    let (boxes, _) = tunnel(1003, 30.0, Walls::Furnished, HALL);
    let before = |k: f64| place(-HALL / 2.0 + k, 0.0, 0.0);
    let (mut alike, mut first) = (0, None);
    for k in 0..6 {
        let (one, other) = (before(f64::from(k)), place(30.0 + HALL / 2.0 - f64::from(k), 0.0, 0.0));
        let [one_sees, other_sees] =
            [(&one, 0), (&other, 40)].map(|(at, k)| seen(&boxes, Sensor::Vlp16, at, k));
        let (target, source) = (submap(&one_sees), submap(&other_sees));
        let found = align(&target, &source, &place(0.0, 0.0, PI), true);
        let tracked = ends(&[one, other], 0.01, 0.001);
        let refused = refusal(&target, &source, &found, &tracked, || maps(&one_sees, &other_sees));
        let refused = refused.unwrap_or_else(|| panic!("{k}: {found:?}"));
        if failed(&found.evidence).is_none() {
            assert_eq!(refused.test, LoopTest::Drift, "{k}: {refused}");
            alike += 1;
            first.get_or_insert((one_sees, other_sees));
        }
    }
    assert!(alike > 0, "surfaces alone refuse all of them");
    // Nor are they as fragments of a run, which are judged as maps of two agents are.
    let (one, other) = first.unwrap();
    let verdict = merge(&RobotMap::new(&one), &RobotMap::new(&other));
    assert_ne!(verdict.decision, Decision::Accepted, "{verdict:?}");
}

/// Back in the hall after a hundred metres, from aside and looking elsewhere, with an odometry that errs by two per cent and two degrees.
#[test]
fn a_hall_that_is_seen_again_is_believed() {
    let (boxes, _) = tunnel(7, LENGTH, Walls::Smooth, HALL);
    let path = [
        place(-7.0, 0.0, 0.0),
        place(LENGTH + 7.0, 0.0, 0.0),
        place(LENGTH + 7.0, 1.0, PI),
        place(-5.5, 1.0, PI),
    ];
    let [one_sees, other_sees] =
        [(&path[0], 0), (&path[3], 40)].map(|(at, k)| seen(&boxes, Sensor::Vlp16, at, k));
    let (target, source) = (submap(&one_sees), submap(&other_sees));
    let found = align(&target, &source, &place(0.0, 0.0, PI), true);
    let truth = path[0].inverse() * path[3];
    let off = (truth.inverse() * found.target_from_source).translation.norm();
    assert!(off < 0.02, "{off} m: {found:?}");
    let tracked = ends(&path, 0.02, 0.0003);
    assert!((tracked.from_from_to.translation - truth.translation).norm() > 0.5);
    let believed =
        |tracked: &Tracked| refusal(&target, &source, &found, tracked, || maps(&one_sees, &other_sees));
    assert_eq!(believed(&tracked), None);
    // Nor do metres that were guessed in between take it away, of which 12 are missing.
    let x = Vector3::x();
    let doubt = Doubt { guessed: x * x.transpose() * 64.0, is_reported: true };
    assert_eq!(believed(&step(&(truth * place(-12.0, 0.0, 0.0)), &doubt)), None);
}

/// A place of the building two storeys up fits in one that is like it, and the odometry, which slid on the stairs in between, admits it.
#[test]
fn storeys_of_a_building_are_not_one_place() {
    let (boxes, corners) = stairs(301);
    let path = Carried::along(&corners, 0.9, Carrier::BackPack);
    let sees = |corner: usize| {
        let way: f64 = corners[..=corner]
            .windows(2)
            .map(|two| (0..3).map(|i| (two[1][i] - two[0][i]).powi(2)).sum::<f64>().sqrt())
            .sum();
        let keyframe = |k: usize| {
            let time = 1.0 + (way + k as f64 - 3.0) / 0.9;
            let sensed = Sensor::Vlp16.sweep(&boxes, |_| path.at(time), (40 * corner + k) as f64 * 0.1);
            Keyframe::new(0.0, path.at(time), sensed.iter().map(|s| s.point).collect())
        };
        (0..7).map(keyframe).collect::<Vec<_>>()
    };
    let z = Vector3::z();
    let slid = Doubt { is_reported: true, ..Doubt::default() };
    let guessed = Doubt { guessed: z * z.transpose() * 1.3f64.powi(2), is_reported: true };
    let mut alike = 0;
    for corner in 2..8 {
        let (one_sees, other_sees) = (sees(corner), sees(corner + 16));
        let (target, source) = (submap(&one_sees), submap(&other_sees));
        let found = align(&target, &source, &Se3::identity(), true);
        if failed(&found.evidence).is_some() {
            continue;
        }
        alike += 1;
        for (above, doubt) in [(0.0, &slid), (1.0, &slid), (5.0, &guessed)] {
            let up = Se3::new(UnitQuaternion::identity(), z * above);
            let tracked = step(&(up * found.target_from_source), doubt);
            assert!(tracked.bent(&found.target_from_source) < bounds::DRIFT);
            let refused = refusal(&target, &source, &found, &tracked, || maps(&one_sees, &other_sees));
            assert!(refused.is_some(), "{corner}, {above}: {found:?}");
        }
    }
    assert!(alike > 0, "surfaces alone refuse all of them");
}

/// What the odometry says of a motion over a place 10 m aside.
fn step(from_from_to: &Se3, doubt: &Doubt) -> Tracked {
    let mut drift = Drift::default();
    drift.push(&Se3::identity(), &Doubt::default());
    drift.push(&place(0.0, 10.0, 0.0), &Doubt::default());
    drift.push(from_from_to, doubt);
    drift.between(0, 2, &[], DEVIATION)
}

/// In a smooth tunnel a place fits in that of another half a metre on, and no witness tells them apart.
#[test]
fn where_a_tunnel_does_not_tell_the_place_no_loop_is_believed() {
    let (boxes, _) = tunnel(11, LENGTH, Walls::Smooth, 0.0);
    let path = [place(20.0, 0.0, 0.0), place(40.0, 0.0, 0.0), place(40.0, 0.5, PI), place(20.0, 0.5, PI)];
    for sensor in [Sensor::Vlp16, Sensor::Os0] {
        let [one_sees, other_sees] =
            [(&path[0], 0), (&path[3], 40)].map(|(at, k)| seen(&boxes, sensor, at, k));
        let (target, source) = (submap(&one_sees), submap(&other_sees));
        let found = align(&target, &source, &(place(0.5, 0.5, PI)), false);
        let tracked = ends(&path, 0.0, 0.0);
        let refused = refusal(&target, &source, &found, &tracked, || maps(&one_sees, &other_sees));
        let test = refused.map(|line| line.test);
        assert!(
            matches!(test, Some(LoopTest::Rivals | LoopTest::Conditioning)),
            "{sensor:?}: {refused:?} {found:?}"
        );
    }
}

#[test]
fn drift_grows_with_the_path_and_is_taken_back_by_a_loop() {
    let path = [place(0.0, 0.0, 0.0), place(300.0, 0.0, 0.0)];
    let drift = drift(&path, 0.0, 0.0);
    // As far aside as a heading that errs by half a degree a root of a metre: 0.0087 · √(300³ / 3) and a little.
    let aside = |tracked: &Tracked| tracked.covariance[(1, 1)].sqrt();
    let all = drift.between(0, 300, &[], DEVIATION);
    assert!((aside(&all) - (0.0087f64.powi(2) * 9e6 + 0.01 * 300.0).sqrt()).abs() < 0.3, "{}", aside(&all));
    // A loop from there to the begin leaves the steps beside it.
    let tie = Tie { from: 2, to: 297, from_from_to: place(1.0, 0.0, PI) };
    let known = drift.between(0, 300, &[tie], DEVIATION);
    assert!(aside(&known) < 0.3, "{}", aside(&known));
    let expected = place(2.0, 0.0, 0.0) * tie.from_from_to * place(3.0, 0.0, 0.0);
    assert!(known.bent(&expected) < 1e-6 && known.bent(&place(0.0, 0.0, 0.0)) > bounds::DRIFT);
    assert!(known.may_be_near() && known.may_be_turned(PI) && !known.may_be_turned(0.0));
    assert!(!all.may_be_turned(PI) && !drift.between(0, 60, &[], DEVIATION).may_be_near());
    // A tie from the later end back is as far as one on.
    let back = Tie { from: 5, to: 290, from_from_to: place(0.0, 0.0, 0.0) };
    let one = drift.between(3, 292, &[back], DEVIATION);
    let other = drift.between(7, 288, &[back], DEVIATION);
    assert!((aside(&one) - aside(&other)).abs() < 0.05, "{} {}", aside(&one), aside(&other));
}
