//! Poses that no motion leads to, decided on by somebody who always says the same.

use super::*;
use crate::agent::Claim;
use crate::judge::ClaimedPlace;
use backend::verdict::Answer;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Says the same whatever is asked, and counts.
struct Says(Answer, AtomicUsize);

impl JudgePlace for Says {
    fn judge(&self, claim: &ClaimedPlace) -> Answer {
        assert!(claim.frames.len() >= 5 && claim.keyframes.len() >= 2, "{} frames", claim.frames.len());
        assert!(claim.keyframes.iter().all(|view| !view.keyframe.semi_dense.is_empty()));
        self.1.fetch_add(1, Ordering::Relaxed);
        self.0
    }
}

fn says(answer: Answer) -> Arc<Says> {
    Arc::new(Says(answer, AtomicUsize::new(0)))
}

/// A drive, so many black frames, and back.
fn covered(answer: Answer, black: usize) -> (Vec<FrameReport>, Vec<Map>, usize) {
    let here = drive(1, 50);
    let dark = GrayImage::filled(320, 240, 0);
    let judge = says(answer);
    let mut atlas = atlas().judge_by(judge.clone());
    let sequence = images(&here).into_iter().chain(vec![&dark; black]).chain(images(&here).into_iter().rev());
    let reports = feed(&mut atlas, 0, sequence);
    atlas.finish_until(&|| false);
    (reports, atlas.into_maps(), judge.1.load(Ordering::Relaxed))
}

#[test]
fn what_is_found_after_a_loss_is_handed_out_once_it_is_decided() {
    let (reports, maps, _) = covered(Answer::Same, 16);
    let decided = reports.iter().position(|report| report.claim == Some(Claim::Accepted));
    let decided = decided.expect("it is the place");
    let found = reports.iter().position(|report| report.claim == Some(Claim::Pending)).expect("it is found");
    assert!((66..70).contains(&found) && (found + 10..found + 20).contains(&decided), "{found} {decided}");
    for report in &reports[found..decided] {
        assert!(report.state == TrackingState::Lost && report.world_from_camera.is_none());
        assert!(report.new_keyframe.is_none() && report.reason.is_some());
    }
    assert!(reports[decided..].iter().all(|report| report.state == TrackingState::Tracking));
    assert_eq!(maps.len(), 1);
    // The frames on which it was decided have their poses then.
    let since: Vec<u64> = maps[0].frames.iter().map(|f| f.frame_index).filter(|i| *i >= 50).collect();
    assert_eq!(since, (found as u64..116).collect::<Vec<_>>());
    let here = drive(1, 50);
    let truth = |i: u64| here.shots[if i < 50 { i } else { 115 - i } as usize].world_from_camera;
    assert!(error(&maps[0], truth) < 0.03);
}

#[test]
fn what_is_not_decided_to_be_the_place_is_a_fragment_of_its_own() {
    for answer in [Answer::Different, Answer::CannotTell] {
        let (reports, maps, asked) = covered(answer, 16);
        assert!(asked > 0 && maps.len() == 2, "{answer:?}: {} maps", maps.len());
        assert!(maps[0].frames.iter().all(|frame| frame.frame_index < 50), "{answer:?}");
        assert!(maps[1].frames.len() >= 40, "{answer:?}: {} frames", maps[1].frames.len());
        assert!(
            reports[50..].iter().all(|report| report.fragment == 1 || report.world_from_camera.is_none())
        );
    }
}

/// Over a quarter of a second the motion leads on.
#[test]
fn short_losses_are_nobodys_to_decide() {
    let (reports, maps, asked) = covered(Answer::Different, 5);
    assert_eq!((asked, maps.len()), (0, 1));
    assert!(reports[56..].iter().all(|r| r.state == TrackingState::Tracking && r.claim.is_none()));
}

/// What is localised in a map has poses once it is decided that it is there, back to the first frame.
#[test]
fn localising_is_a_claim() {
    let here = drive(1, 50);
    let mut first = atlas();
    feed(&mut first, 0, images(&here));
    first.finish_until(&|| false);
    let map = first.into_maps().remove(0);
    for (answer, poses) in [(Answer::Same, 40), (Answer::Different, 0), (Answer::CannotTell, 0)] {
        let places = || Box::new(ThumbnailIndex::default()) as Box<dyn PlaceIndex>;
        let agent = Agent::resume(map.clone(), places(), Params::default(), ResumeMode::Localising).unwrap();
        let mut atlas = Atlas::resume(agent, places, Params::default()).judge_by(says(answer));
        let reports = feed(&mut atlas, 0, images(&here).into_iter().take(40));
        atlas.finish_until(&|| false);
        assert_eq!(atlas.fragments()[0].map().frames.len(), poses, "{answer:?}");
        assert_eq!(reports.iter().any(|r| r.world_from_camera.is_some()), poses > 0, "{answer:?}");
    }
}

/// A recording that ends before there was time is decided by what there is.
#[test]
fn a_recording_that_ends_is_decided_by_what_there_is() {
    let here = drive(1, 50);
    let dark = GrayImage::filled(320, 240, 0);
    let mut atlas = atlas().judge_by(says(Answer::Same));
    let back = images(&here).into_iter().rev().take(8);
    feed(&mut atlas, 0, images(&here).into_iter().chain(vec![&dark; 16]).chain(back));
    atlas.finish_until(&|| false);
    let maps = atlas.into_maps();
    assert_eq!(maps.len(), 1);
    assert!(maps[0].frames.iter().filter(|frame| frame.frame_index >= 66).count() >= 6);
}

/// Fragments are joined though the first claim was not believed, and where the camera is then is nobody's to decide again.
#[test]
fn a_fragment_that_is_joined_later_continues_at_once() {
    use std::sync::atomic::AtomicBool;
    struct Later(AtomicBool);
    impl JudgePlace for Later {
        fn judge(&self, _: &ClaimedPlace) -> Answer {
            if self.0.load(Ordering::Relaxed) { Answer::Same } else { Answer::CannotTell }
        }
    }
    let here = drive(1, 80);
    let dark = GrayImage::filled(320, 240, 0);
    let judge = Arc::new(Later(AtomicBool::new(false)));
    let recogniser = recognised::Oracle::new(&[&here], 3.0);
    let mut atlas = atlas().recognising(recogniser).judge_by(judge.clone());
    feed(&mut atlas, 0, images(&here).into_iter().chain(vec![&dark; 16]));
    let back: Vec<&GrayImage> = images(&here).into_iter().rev().collect();
    let apart = feed(&mut atlas, 96, back[..40].iter().copied());
    assert_eq!((apart[39].state, apart[39].fragment), (TrackingState::Tracking, 1), "{:?}", apart[39].reason);
    judge.0.store(true, Ordering::Relaxed);
    let reports = feed(&mut atlas, 136, back[40..].iter().copied());
    assert!(reports.iter().all(|r| r.state == TrackingState::Tracking), "it is tracked all along");
    assert_eq!(reports.last().map(|r| r.fragment), Some(0), "they are joined");
}

/// A map of one keyframe has no depth to compare with: where no frame comes for six seconds then, what follows is a fragment of its own.
#[test]
fn a_claim_that_nothing_can_decide_holds_up_no_fragment() {
    const PAUSE: usize = 120;
    let here = drive(1, 80);
    let images = images(&here);
    let mut atlas = atlas().judge_by(says(Answer::CannotTell));
    let starts = |i: &usize| feed(&mut atlas, *i, [images[*i]])[0].state == TrackingState::Tracking;
    let begun = (0..images.len()).find(starts).expect("a map begins");
    // The second frame tells the time from frame to frame, beside which the pause is one.
    let (before, after) = images[begun + 1..].split_at(2);
    feed(&mut atlas, begun + 1, before.iter().copied());
    let after = feed(&mut atlas, begun + 3 + PAUSE, after.iter().copied());
    assert_eq!(after[0].claim, Some(Claim::Pending), "{:?}", after[0].state);
    assert!(after.iter().any(|report| report.claim == Some(Claim::Undecided)));
    let tracked = after.iter().rev().take_while(|report| report.state == TrackingState::Tracking).count();
    assert!(tracked > 20, "{tracked} of {} frames, begun at {begun}", after.len());
}
