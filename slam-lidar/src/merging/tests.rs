//! Maps joined, and poses decided between.

use super::comparison::{Comparison, Difference, compare};
use super::lines::Test;
use super::robot_map::RobotMap;
use super::shifts::Counted;
use super::verdict::{Decision, MergeEvidence, Verdict, decide, distinct};
use super::{MergeMethod, merge, merge_by};
use crate::degeneracy::Conditioning;
use crate::keyframe::Keyframe;
use crate::voxels::{VoxelTable, first_of_each_voxel};
use backend::verdict::{Answer, Piece, PieceKind, Prior, Weighed};
use geometry::Se3;
use loopbox_tests::lidar::{Corners, HALL, THIRTY_TWO, sweep, sweep_of, walk};
use loopbox_tests::lidar_doubles::{Kind, Things};
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

#[test]
fn empty_maps_are_refused() {
    let empty = RobotMap::new(&[]);
    let verdict = merge(&empty, &empty);
    assert_eq!((verdict.decision, verdict.line.test), (Decision::Refused, Test::Pieces));
    assert!(verdict.best.is_none() && decided(Vec::new()).best.is_none());
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
        support: 20.0,
        overlap: 0.9,
        surface: 500.0,
        things: Comparison { shared: 500.0, overlap: 0.9, inlier_ratio: 1.0, ..Comparison::default() },
        weighed: weighed(Answer::Same, 5.0),
        shifts: Default::default(),
        rmse: 0.02,
        conditioning,
    }
}

fn weighed(answer: Answer, ln_ratio: f64) -> Weighed {
    Weighed { answer, ln_ratio, changed: 0.0, pieces: Vec::new() }
}

fn decided(found: Vec<MergeEvidence>) -> Verdict {
    decide(found, &Prior::default(), |_| ())
}

#[test]
fn a_pose_that_was_found_twice_is_no_rival_of_itself() {
    let again = pose(1) * Se3::exp(&Vector6::new(0.002, 0.0, 0.001, 0.0, 0.0, 0.0003));
    let of = |poses: [Se3; 2]| decided(distinct(poses.map(standing).into(), |e| e.a_from_b));
    let twice = of([pose(1), again]);
    assert_eq!((twice.decision, twice.rivals.len()), (Decision::Accepted, 0));
    let rivals = of([pose(1), pose(2)]);
    assert_eq!((rivals.answer, rivals.line.test), (Answer::CannotTell, Test::Rivals));
}

#[test]
fn a_pose_is_held_to_every_test_and_the_answer_says_which_failed() {
    let of = |change: fn(&mut MergeEvidence)| {
        let mut evidence = standing(pose(1));
        change(&mut evidence);
        let verdict = decided(vec![evidence]);
        (verdict.answer, verdict.line.test)
    };
    assert_eq!(of(|_| ()), (Answer::Same, Test::Rivals));
    let changed = |e: &mut MergeEvidence| e.weighed = weighed(Answer::SameChanged, 3.0);
    assert_eq!(of(changed).0, Answer::SameChanged);
    let open = |e: &mut MergeEvidence| e.weighed = weighed(Answer::CannotTell, -1.0);
    assert_eq!(of(open), (Answer::CannotTell, Test::Likelihood));
    let other = |e: &mut MergeEvidence| e.weighed = weighed(Answer::Different, -20.0);
    assert_eq!(of(other), (Answer::Different, Test::Likelihood));
    assert_eq!(of(|e| e.overlap = 0.2), (Answer::Different, Test::Overlap));
    assert_eq!(of(|e| e.things.inlier_ratio = 0.8), (Answer::Different, Test::InlierRatio));
    let shifted =
        |e: &mut MergeEvidence| e.shifts = [(30, 400), (3, 500)].map(|(shifted, of)| Counted { shifted, of });
    assert_eq!(of(shifted), (Answer::CannotTell, Test::Shifts));
    assert_eq!(of(|e| e.conditioning.weak = 1), (Answer::CannotTell, Test::Conditioning));
    assert_eq!(of(|e| e.pieces = 1), (Answer::CannotTell, Test::Pieces));
}

#[test]
fn where_the_likelihood_does_not_tell_nothing_may_be_absent_and_much_must_be_shared() {
    let of = |overlap: f64, surface: f64, area: f64, answer: Answer| {
        let mut e = standing(pose(1));
        e.weighed = weighed(answer, if answer.joins() { 3.0 } else { 0.0 });
        let differences = vec![Difference { in_first: true, area, middle: [0.0; 3], rays: 9 }];
        (e.overlap, e.surface, e.things.differences) = (overlap, surface, differences);
        let verdict = decided(vec![e]);
        (verdict.decision, verdict.line.test, verdict.answer)
    };
    use Answer::{CannotTell, Same, SameChanged};
    use Decision::{Accepted, Undecided};
    assert_eq!(of(0.4, 250.0, 0.125, CannotTell), (Accepted, Test::Rivals, Same));
    assert_eq!(of(0.4, 250.0, 0.19, CannotTell), (Undecided, Test::Absent, CannotTell));
    // Of more that both saw a little more may be absent.
    assert_eq!(of(0.4, 600.0, 0.25, CannotTell), (Accepted, Test::Rivals, Same));
    assert_eq!(of(0.4, 190.0, 0.0, CannotTell), (Undecided, Test::Shared, CannotTell));
    assert_eq!(of(0.8, 190.0, 0.0, CannotTell), (Accepted, Test::Rivals, Same));
    // What the likelihood tells needs neither.
    assert_eq!(of(0.4, 100.0, 2.0, SameChanged), (Accepted, Test::Rivals, SameChanged));
    let mut nothing = standing(pose(1));
    nothing.weighed = weighed(CannotTell, f64::NAN);
    assert_eq!(decided(vec![nothing]).line.test, Test::Likelihood);
}

#[test]
fn a_refused_pose_with_more_inliers_leaves_the_one_that_passes_open() {
    let (mut refused, passes) = (standing(pose(1)), standing(pose(2)));
    refused.weighed = weighed(Answer::Different, -9.0);
    refused.support = 30.0;
    let verdict = decided(vec![refused.clone(), passes.clone()]);
    assert_eq!((verdict.answer, verdict.line.test), (Answer::CannotTell, Test::Rivals));
    // One that a repetition's things contradict is none, nor is one at which less is alike.
    let repetition = Comparison { inlier_ratio: 0.9, ..refused.things.clone() };
    let repeated = MergeEvidence { things: repetition, ..refused.clone() };
    assert_eq!(decided(vec![repeated, passes.clone()]).answer, Answer::Same);
    // Nor one at which as much differs as a repetition has of its own: the other explains more.
    let piece = |ln_agreement| Piece {
        kind: PieceKind::Shape,
        share: 0.01,
        things: 1.0,
        occurrences: 1.0,
        ln_agreement,
    };
    let (mut door, mut right) = (refused.clone(), passes.clone());
    right.things.pieces = vec![piece(2.25); 13];
    door.things.pieces = [vec![piece(2.25); 15], vec![piece(-9.0); 9]].concat();
    assert_eq!(decided(vec![door.clone(), right.clone()]).answer, Answer::Same);
    door.things.pieces.extend(vec![piece(2.25); 30]);
    assert_eq!(decided(vec![door, right]).line.test, Test::Rivals);
    refused.support = 10.0;
    let verdict = decided(vec![refused, passes]);
    assert_eq!(verdict.answer, Answer::Same);
    assert_eq!(verdict.best.expect("a pose was judged").a_from_b.to_tum(), pose(2).to_tum());
}

#[test]
fn of_refused_poses_the_undecided_one_is_reported() {
    let (mut refused, mut open) = (standing(pose(1)), standing(pose(2)));
    refused.weighed = weighed(Answer::Different, -9.0);
    open.weighed = weighed(Answer::CannotTell, -1.0);
    let verdict = decided(vec![refused, open]);
    assert_eq!((verdict.decision, verdict.line.test), (Decision::Undecided, Test::Likelihood));
    let reported = verdict.best.expect("a pose was judged").a_from_b;
    assert_eq!(reported.to_tum(), pose(2).to_tum());
}

/// A person knows the place, and not the pose.
#[test]
fn who_confirms_a_place_settles_what_differs_and_nothing_else() {
    let of = |change: fn(&mut MergeEvidence), others: Vec<MergeEvidence>| {
        let mut evidence = standing(pose(1));
        change(&mut evidence);
        let verdict = decided([vec![evidence], others].concat());
        assert_ne!(verdict.decision, Decision::Accepted);
        let confirmed = verdict.confirmed_where(&Prior::default(), |_| ());
        (confirmed.decision, confirmed.line.test)
    };
    let other = |e: &mut MergeEvidence| e.weighed = weighed(Answer::Different, -20.0);
    assert_eq!(of(other, Vec::new()).0, Decision::Accepted);
    let shifted =
        |e: &mut MergeEvidence| e.shifts = [(30, 400), (3, 500)].map(|(shifted, of)| Counted { shifted, of });
    assert_eq!(of(shifted, Vec::new()).0, Decision::Accepted);
    assert_eq!(of(|e| e.overlap = 0.2, Vec::new()), (Decision::Refused, Test::Overlap));
    assert_eq!(of(|e| e.pieces = 1, Vec::new()), (Decision::Undecided, Test::Pieces));
    assert_eq!(of(|e| e.conditioning.weak = 1, Vec::new()), (Decision::Undecided, Test::Conditioning));
    let mut elsewhere = standing(pose(2));
    elsewhere.weighed = weighed(Answer::Different, -30.0);
    assert_eq!(of(other, vec![elsewhere.clone()]), (Decision::Undecided, Test::Rivals));
    // Unless what both saw says which it is.
    let agrees =
        Piece { kind: PieceKind::Shape, share: 0.1, things: 9.0, occurrences: 1.0, ln_agreement: 9.0 };
    elsewhere.things.pieces = vec![agrees];
    let verdict = decided(vec![standing(pose(1)), standing(pose(3)), elsewhere]);
    let best = verdict.confirmed_where(&Prior::default(), |_| ()).best.expect("a pose");
    assert_eq!(best.a_from_b.to_tum(), pose(2).to_tum());
}

/// Shelves of one plan whose tins all stand otherwise, none of them larger than what maps err by; and of one of the two seen again.
#[test]
fn a_shop_aisle_is_not_joined_with_one_of_other_goods() {
    let aisle = |things: u64, visit: f64| {
        let site = Kind::Aisle.site(20, Things::new(things));
        let (pose, _) = walk(&site.paths[1]);
        let keyframe = |k: usize| {
            let at = pose(2.0 * k as f64);
            let returns = sweep_of(&THIRTY_TWO, &site.boxes, |_| at, visit + k as f64);
            let points: Vec<[f32; 3]> = returns.iter().map(|r| r.point).collect();
            let mut kept = Vec::new();
            first_of_each_voxel(&points, 0.15, &mut VoxelTable::default(), &mut kept);
            Keyframe::new(k as f64, at, kept.iter().map(|&i| points[i as usize]).collect())
        };
        RobotMap::new(&(0..12).map(keyframe).collect::<Vec<_>>())
    };
    let (own, again, other) = (aisle(60, 0.0), aisle(60, 100.0), aisle(61, 200.0));
    let verdict = merge(&own, &other);
    assert_eq!((verdict.answer, verdict.line.test), (Answer::CannotTell, Test::Shifts), "{}", verdict.line);
    let confirmed = verdict.confirmed(&own, &other, &Prior::default());
    // Of shelves whose tins are all others, another pose fits as well.
    assert_eq!(
        (confirmed.answer, confirmed.line.test),
        (Answer::CannotTell, Test::Rivals),
        "{}",
        confirmed.line
    );
    let turned = merge(&other, &own);
    assert_eq!((verdict.answer, verdict.line), (turned.answer, turned.line));
    let right = merge(&own, &again);
    assert_eq!(right.decision, Decision::Accepted, "{}", right.line);
    let [between, within] = right.best.expect("it is joined").shifts;
    assert!(between.of > 100 && within.of > 100, "{between:?} {within:?}");
}

/// By both methods; the pose of the one is the other's inverse.
#[test]
fn both_orders_of_the_maps_give_one_verdict_bit_by_bit() {
    let (west, east) = (seen_along(&HALL, -9.0, 3.0), seen_along(&HALL, -3.0, 9.0));
    for method in MergeMethod::ALL {
        let forth = merge_by(method, &west, &east, &Prior::default());
        let back = merge_by(method, &east, &west, &Prior::default());
        assert_eq!((forth.answer, forth.line), (back.answer, back.line), "{method:?}");
        let (forth, back) = (forth.best.expect("a pose"), back.best.expect("a pose"));
        assert_eq!(forth.weighed, back.weighed);
        let same = |pose: Se3| pose.inverse().inverse().to_tum().map(f64::to_bits);
        assert_eq!(same(forth.a_from_b), same(back.a_from_b.inverse()));
    }
}

#[test]
fn what_stands_in_one_map_only_differs_and_errors_of_poses_do_not() {
    let (west, east) = (seen_along(&HALL, -9.0, 3.0), seen_along(&HALL, -3.0, 9.0));
    let truth = Se3::new(Default::default(), Vector3::new(6.0, 0.0, 0.0));
    let right = compare(&west, &east, &truth);
    assert!(right.absent() <= 0.2 && right.overlap > 0.5, "{:?}", right.differences);
    let tilted = truth * Se3::exp(&Vector6::new(0.02, -0.02, 0.02, 0.0, 0.002, 0.0));
    assert!(compare(&west, &east, &tilted).absent() <= 0.2);
    // A cabinet of 5 × 2 m that stands 2.5 m wide along the lane, and one whose front is moved by 0.2 m.
    let without: Vec<_> = HALL.iter().copied().filter(|corners| corners != &HALL[8]).collect();
    let other = compare(&west, &seen_along(&without, -3.0, 9.0), &truth);
    assert!(other.absent() > 2.0, "{:?}", other.differences);
    assert!(other.differences[0].in_first);
    let mut moved = HALL;
    moved[2][0][1] -= 0.2;
    let moved = compare(&west, &seen_along(&moved, -3.0, 9.0), &truth);
    assert!(moved.absent() > 1.0 && !moved.differences.is_empty(), "{:?}", moved.differences);
}
