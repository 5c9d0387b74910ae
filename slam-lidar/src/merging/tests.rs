//! Maps joined, and poses decided between.

use super::absent::Comparison;
use super::graph::{Merge, joined};
use super::merge;
use super::robot_map::RobotMap;
use super::verdict::{Decision, MergeEvidence, Test, distinct, judged};
use crate::degeneracy::Conditioning;
use crate::keyframe::Keyframe;
use geometry::Se3;
use loopbox_tests::lidar::{Corners, sweep};
use nalgebra::{Matrix6, Vector3, Vector6};

/// The map of a world of boxes from keyframes a metre apart on a lane along x, whose first one's frame it has.
pub fn seen_along(world: &[Corners], from: f64, to: f64) -> RobotMap {
    let keyframe = |k: usize| {
        let place = |x: f64| Se3::new(Default::default(), Vector3::new(x, 5.0, 0.0));
        let along = k as f64;
        let returns = sweep(world, |_| place(from + along), along);
        let pose = Se3::new(Default::default(), Vector3::new(along, 0.0, 0.0));
        Keyframe::new(along, pose, returns.iter().map(|r| r.point).collect())
    };
    RobotMap::new(&(0..=(to - from) as usize).map(keyframe).collect::<Vec<_>>())
}

fn pose(i: usize) -> Se3 {
    let i = i as f64;
    Se3::exp(&Vector6::new(3.0 * i, -i * i, 0.1 * i, 0.01 * i, -0.02, 0.7 * i))
}

fn exact(from: usize, to: usize, trust: f64) -> Merge {
    Merge { from, to, from_from_to: pose(from).inverse() * pose(to), trust }
}

#[test]
fn a_trusted_but_wrong_merge_is_outvoted_by_the_cycles() {
    let mut merges: Vec<Merge> =
        [(0, 1), (1, 2), (0, 2), (2, 3), (1, 3)].map(|(i, j)| exact(i, j, 1.0)).into();
    let wrong = Se3::exp(&Vector6::new(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)) * exact(3, 0, 1.0).from_from_to;
    merges.push(Merge { from: 3, to: 0, from_from_to: wrong, trust: 9.0 });
    let found = joined(5, &merges);
    assert_eq!(found.tree.len(), 3);
    assert_eq!(found.root, [0, 0, 0, 0, 4]);
    for map in 0..4 {
        let error = (pose(0).inverse() * pose(map)).inverse() * found.root_from_map[map];
        assert!(error.log().norm() < 0.02, "map {map}: {error:?}");
    }
    assert!(found.weights[5] < 0.1 && found.weights[..5].iter().all(|w| *w > 0.9), "{:?}", found.weights);
}

#[test]
fn merges_that_name_no_map_are_left_out() {
    let found = joined(2, &[exact(0, 7, 1.0), exact(1, 1, 1.0)]);
    assert_eq!((found.root, found.tree), (vec![0, 1], vec![]));
}

#[test]
fn empty_maps_are_refused() {
    let empty = RobotMap::new(&[]);
    let verdict = merge(&empty, &empty);
    assert_eq!((verdict.decision, verdict.line.test), (Decision::Refused, Test::Pieces));
    assert!(verdict.best.is_none() && judged(Vec::new()).best.is_none());
}

/// All that a right merge shows, at a pose.
fn standing(a_from_b: Se3) -> MergeEvidence {
    let conditioning =
        Conditioning { translation: 0.001, weakest: [1.0, 0.0, 0.0], rotation: 0.001, weak: 0 };
    MergeEvidence {
        a_from_b,
        information: Matrix6::identity(),
        finding: 4,
        pieces: 4,
        of_pieces: 4,
        support: 1.0,
        overlap: 0.9,
        violated: 0.0,
        agreeing: 0.95,
        things: Comparison { shared: 500.0, absent: 0.0 },
        rmse: 0.02,
        conditioning,
    }
}

#[test]
fn a_pose_that_was_found_twice_is_no_rival_of_itself() {
    let again = pose(1) * Se3::exp(&Vector6::new(0.002, 0.0, 0.001, 0.0, 0.0, 0.0003));
    let decided = |poses: [Se3; 2]| judged(distinct(poses.map(standing).into(), |e| e.a_from_b));
    let twice = decided([pose(1), again]);
    assert_eq!((twice.decision, twice.rivals.len()), (Decision::Accepted, 0));
    let rivals = decided([pose(1), pose(2)]);
    assert_eq!((rivals.decision, rivals.line.test), (Decision::Undecided, Test::Rivals));
}

#[test]
fn a_place_that_lacks_a_thing_or_of_which_little_is_shared_is_left_open() {
    let decided = |change: fn(&mut MergeEvidence)| {
        let mut evidence = standing(pose(1));
        change(&mut evidence);
        let verdict = judged(vec![evidence]);
        (verdict.decision, verdict.line.test)
    };
    assert_eq!(decided(|_| ()).0, Decision::Accepted);
    assert_eq!(decided(|e| e.things.absent = 0.5), (Decision::Undecided, Test::Absent));
    let cart = |e: &mut MergeEvidence| (e.things.absent, e.things.shared) = (1.4, 2250.0);
    assert_eq!(decided(cart).0, Decision::Accepted, "a cart that was moved in a hall");
    assert_eq!(decided(|e| e.things.shared = 100.0).0, Decision::Accepted, "most of a small place is shared");
    let little = |e: &mut MergeEvidence| (e.things.shared, e.overlap) = (100.0, 0.5);
    assert_eq!(decided(little), (Decision::Undecided, Test::Shared));
    let refused = |e: &mut MergeEvidence| (e.things.absent, e.violated) = (0.5, 0.1);
    assert_eq!(decided(refused), (Decision::Refused, Test::FreeSpace));
}

#[test]
fn of_poses_that_do_not_stand_the_one_that_may_be_is_told() {
    let (mut refused, mut open) = (standing(pose(1)), standing(pose(2)));
    (refused.violated, open.things.absent) = (0.1, 0.5);
    let verdict = judged(vec![refused, open]);
    assert_eq!((verdict.decision, verdict.line.test), (Decision::Undecided, Test::Absent));
    let told = verdict.best.expect("a pose was judged").a_from_b;
    assert_eq!(told.to_tum(), pose(2).to_tum());
}
