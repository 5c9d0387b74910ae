//! Maps joined, and poses decided between.

use super::graph::{Merge, joined};
use super::merge;
use super::robot_map::RobotMap;
use super::verdict::{Decision, MergeEvidence, Test, judged};
use crate::degeneracy::Conditioning;
use geometry::Se3;
use nalgebra::{Matrix6, Vector6};

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
        rmse: 0.02,
        conditioning,
    }
}

#[test]
fn a_pose_that_was_found_twice_is_no_rival_of_itself() {
    let again = pose(1) * Se3::exp(&Vector6::new(0.002, 0.0, 0.001, 0.0, 0.0, 0.0003));
    let twice = judged(vec![standing(pose(1)), standing(again)]);
    assert_eq!((twice.decision, twice.rivals.len()), (Decision::Accepted, 0));
    let rivals = judged(vec![standing(pose(1)), standing(pose(2))]);
    assert_eq!((rivals.decision, rivals.line.test), (Decision::Undecided, Test::Rivals));
}
