use super::*;
use backend::verdict::Answer;

/// Evidence that passes every line, just.
const ENOUGH: Evidence = Evidence {
    matches: 60,
    pairs: 2,
    pooled: false,
    inlier_share: 0.6,
    total_inlier_share: 0.25,
    rotation_deviation: 0.35,
    translation_deviation: 0.03,
    scale_deviation: 0.03,
    icp_overlap: None,
    rival_place: None,
    ln_false_alarms: -60.0,
    place: Some(PLACE),
    beyond: Some(BEYOND),
};

/// What the rest of both maps says where it says just enough.
const BEYOND: Beyond = Beyond {
    tested: 4,
    confirmed: 2,
    failed: 1,
    closures: 4,
    rival: 2,
    through_share: 0.05,
    missing_share: 0.1,
    views: 8,
    absent_views: 3,
    absent_share: 0.0007,
    unlike_views: 3,
    unlike_share: 0.005,
};

/// Looks that agree, just enough.
const PLACE: PlaceEvidence = PlaceEvidence {
    answer: Answer::Same,
    ln_ratio: 2.5,
    probability: 0.99,
    needed: 0.99,
    changed: 0.0,
    things: 40.0,
    inlier_wear: 0.0,
    expected_change: 0.001,
    own: 1.0,
    grain: 0.99,
};

fn verdict(evidence: Evidence) -> Verdict {
    judge(evidence, &AcceptanceParams::default())
}

fn of_place(answer: Answer, ln_ratio: f64) -> Evidence {
    Evidence { place: Some(PlaceEvidence { answer, ln_ratio, ..PLACE }), ..ENOUGH }
}

/// Surface of which so much differs and that does not tell.
fn undecided(changed: f64) -> Evidence {
    Evidence { place: Some(PlaceEvidence { answer: Answer::CannotTell, changed, ..PLACE }), ..ENOUGH }
}

fn beyond(beyond: Beyond) -> Evidence {
    Evidence { beyond: Some(beyond), ..ENOUGH }
}

#[test]
fn what_is_enough_passes_every_line() {
    let verdict = verdict(ENOUGH);
    assert_eq!((verdict.decision, verdict.lines.len()), (Decision::Accepted, 17));
    assert!(verdict.accepts() && verdict.doubt().is_none());
    assert!(verdict.lines.iter().all(|line| line.says == Says::For), "{:?}", verdict.lines);
}

/// No pair of keyframes speaks for it alone: their images must say more.
#[test]
fn keyframes_matched_together_must_be_more_similar() {
    let pooled = Evidence { pooled: true, inlier_share: 0.7, ..ENOUGH };
    assert!(verdict(pooled).accepts());
    let doubt = Doubt::Unlike { share: 0.69, needed: 0.7 };
    let verdict = verdict(Evidence { inlier_share: 0.69, ..pooled });
    assert_eq!((verdict.decision, verdict.lines.len()), (Decision::Undecided(doubt), 18));
}

#[test]
fn each_line_alone_says_what_it_says() {
    let vague = |rotation, translation, scale| Doubt::Vague { rotation, translation, scale };
    let left_open = [
        (Evidence { pairs: 1, ..ENOUGH }, Doubt::Unconfirmed { pairs: 1, needed: 2 }),
        (Evidence { matches: 59, ..ENOUGH }, Doubt::FewMatches { matches: 59, needed: 60 }),
        (Evidence { rotation_deviation: 0.36, ..ENOUGH }, vague(0.36, 0.03, 0.03)),
        (Evidence { translation_deviation: 0.031, ..ENOUGH }, vague(0.35, 0.031, 0.03)),
        (Evidence { scale_deviation: 0.031, ..ENOUGH }, vague(0.35, 0.03, 0.031)),
        (
            beyond(Beyond { absent_share: 0.0015, ..BEYOND }),
            Doubt::Absent { views: 3, share: 0.0015, limit: 0.0014 },
        ),
        (
            beyond(Beyond { unlike_share: 0.011, ..BEYOND }),
            Doubt::OtherLook { views: 3, share: 0.011, limit: 0.01 },
        ),
        (
            beyond(Beyond { absent_share: 0.0014, ..BEYOND }),
            Doubt::AbsentAndOtherLook { absent: 0.0014, unlike: 0.005, sum: 1.5 },
        ),
        (
            beyond(Beyond { absent_views: 4, ..BEYOND }),
            Doubt::InManyViews { views: 8, absent: 4, unlike: 3, share: 0.4375, limit: 0.375 },
        ),
        (beyond(Beyond { rival: 3, ..BEYOND }), Doubt::Rival { closures: 4, rival: 3 }),
        (Evidence { rival_place: Some(0.76), ..ENOUGH }, Doubt::OtherPlace { share: 0.76, limit: 0.75 }),
        (undecided(0.1), Doubt::CannotTell { percent: 10.0, ln_ratio: 2.5 }),
    ];
    for (evidence, doubt) in left_open {
        assert_eq!(verdict(evidence).decision, Decision::Undecided(doubt));
    }
    let refused = [
        (of_place(Answer::Different, -9.0), Doubt::Double { percent: 0.0, against: 9.0 }),
        (Evidence { inlier_share: 0.59, ..ENOUGH }, Doubt::Unlike { share: 0.59, needed: 0.6 }),
        (Evidence { total_inlier_share: 0.24, ..ENOUGH }, Doubt::LittleAgrees { share: 0.24, needed: 0.25 }),
        (beyond(Beyond { confirmed: 1, ..BEYOND }), Doubt::Alone { confirmed: 1, tested: 4, needed: 50.0 }),
        (beyond(Beyond { failed: 2, ..BEYOND }), Doubt::Alone { confirmed: 2, tested: 4, needed: 75.0 }),
        (beyond(Beyond { through_share: 0.06, ..BEYOND }), Doubt::SeenThrough { share: 0.06, limit: 0.05 }),
        (beyond(Beyond { missing_share: 0.11, ..BEYOND }), Doubt::Missing { share: 0.11, limit: 0.1 }),
    ];
    for (evidence, doubt) in refused {
        let verdict = verdict(evidence);
        assert_eq!(verdict.decision, Decision::Refused(doubt));
        let against = verdict.lines.iter().filter(|line| line.says == Says::Against);
        assert_eq!(against.count(), 1, "{:?}", verdict.lines);
    }
}

/// What contradicts weighs more than what is not known, whichever is asked first.
#[test]
fn a_contradiction_decides_over_what_is_open() {
    let evidence = Evidence { pairs: 1, inlier_share: 0.1, ..ENOUGH };
    assert_eq!(verdict(evidence).decision, Decision::Refused(Doubt::Unlike { share: 0.1, needed: 0.6 }));
}

/// Before the maps are asked, only the closure's own lines are there.
#[test]
fn the_closure_is_evaluated_alone_first() {
    assert_eq!(verdict(Evidence { beyond: None, ..ENOUGH }).lines.len(), 8);
}

/// What could not be computed is no evidence.
#[test]
fn what_is_no_number_does_not_pass() {
    for evidence in [
        Evidence { inlier_share: f32::NAN, ..ENOUGH },
        Evidence { total_inlier_share: f32::NAN, ..ENOUGH },
        Evidence { rotation_deviation: f64::NAN, ..ENOUGH },
        Evidence { translation_deviation: f64::NAN, ..ENOUGH },
        Evidence { scale_deviation: f64::NAN, ..ENOUGH },
        Evidence { rotation_deviation: f64::INFINITY, ..ENOUGH },
        beyond(Beyond { through_share: f64::NAN, ..BEYOND }),
        beyond(Beyond { missing_share: f64::NAN, ..BEYOND }),
        beyond(Beyond { absent_share: f64::NAN, ..BEYOND }),
        beyond(Beyond { unlike_share: f64::NAN, ..BEYOND }),
    ] {
        assert!(!verdict(evidence).accepts(), "{evidence:?}");
    }
}

/// What keeps places apart that look alike is no want of evidence, which another closure could bring.
#[test]
fn missing_things_distinguish_similar_places() {
    let doubt = |evidence| verdict(evidence).doubt().expect("it is kept open");
    assert!(doubt(beyond(Beyond { absent_share: 0.0015, ..BEYOND })).is_similar_place());
    assert!(doubt(beyond(Beyond { unlike_share: 0.011, ..BEYOND })).is_similar_place());
    assert!(doubt(beyond(Beyond { absent_share: 0.0014, ..BEYOND })).is_similar_place());
    assert!(doubt(beyond(Beyond { unlike_views: 6, ..BEYOND })).is_similar_place());
    assert!(doubt(Evidence { rival_place: Some(0.8), ..ENOUGH }).is_similar_place());
    assert!(!doubt(beyond(Beyond { rival: 3, ..BEYOND })).is_similar_place());
    assert!(!doubt(Evidence { matches: 31, ..ENOUGH }).is_similar_place());
}

/// Surface that differs refuses a closure of which all else is right; surface that agrees outweighs no line of the pose.
#[test]
fn surface_refuses_and_outweighs_no_pose() {
    let place = |answer| Some(PlaceEvidence { answer, ..PLACE });
    let right = Evidence { place: place(Answer::Same), ..beyond(BEYOND) };
    assert!(verdict(right).accepts() && !verdict(right).is_double());
    let double = verdict(Evidence { place: place(Answer::Different), ..right });
    assert!(!double.accepts() && double.is_double());
    // A pose that other lines refuse differs by its being wrong.
    let wrong = Evidence { inlier_share: 0.4, ..right };
    assert!(!verdict(wrong).accepts());
    assert!(!verdict(Evidence { place: place(Answer::Different), ..wrong }).is_double());
}

/// Where much differs, what the surface does not tell is no merge and no double; what other lines lack is said before it, as more may
/// bring that.
#[test]
fn surface_that_differs_and_does_not_tell_joins_nothing() {
    let open = verdict(undecided(0.1));
    assert!(
        !open.accepts() && !open.is_double() && open.doubt().is_some_and(|doubt| doubt.is_similar_place())
    );
    let few = verdict(Evidence { matches: 31, ..undecided(0.1) });
    assert_eq!(few.decision, Decision::Undecided(Doubt::FewMatches { matches: 31, needed: 60 }));
    // Where little differs, or little was seen, other lines tell.
    assert!(verdict(undecided(0.09)).accepts() && verdict(undecided(0.0)).accepts());
    let never = AcceptanceParams { min_undecided_change: 0.0, ..AcceptanceParams::default() };
    assert!(!judge(undecided(0.0), &never).accepts());
    assert!(verdict(Evidence { place: Some(PlaceEvidence { changed: 0.3, ..PLACE }), ..ENOUGH }).accepts());
}

/// Doubles pass the other lines as one place does: these do not outweigh surface that is twice as likely of two places.
#[test]
fn surface_that_is_likelier_of_two_places_joins_nothing() {
    let of = |probability: f64| {
        let place = Some(PlaceEvidence { probability, ..undecided(0.02).place.unwrap() });
        verdict(Evidence { place, ..undecided(0.02) })
    };
    assert!(of(0.34).accepts() && of(0.9).accepts());
    let open = of(0.32);
    assert!(!open.accepts() && !open.is_double() && open.doubt().unwrap().is_similar_place());
    assert!(!of(f64::NAN).accepts());
}

/// A hundred looks that agree are of a place or of its double: surface that is nowhere else must not speak against it.
#[test]
fn surface_that_is_nowhere_else_may_not_speak_against_a_closure() {
    let of = |own: f64| {
        let place = Some(PlaceEvidence { own, ..undecided(0.02).place.unwrap() });
        verdict(Evidence { place, ..undecided(0.02) })
    };
    // Where none was measured other lines tell.
    assert!(of(1.0).accepts() && of(0.0).accepts());
    for own in [-0.1, -2.0, f64::NAN] {
        let open = of(own);
        assert!(!open.accepts() && !open.is_double() && open.doubt().unwrap().is_similar_place());
    }
}

/// Without grain a place of which something was moved and a double that shares the rest look the same.
#[test]
fn what_differs_without_grain_may_be_another_place() {
    let of = |changed: f64, expected_change: f64, grain: f64| {
        let place = PlaceEvidence { expected_change, grain, ..undecided(changed).place.unwrap() };
        verdict(Evidence { place: Some(place), ..undecided(changed) })
    };
    assert!(of(0.02, 0.001, 0.99).accepts(), "grain would be another there");
    assert!(of(0.0, 0.001, 0.0).accepts(), "nothing differs");
    assert!(of(0.02, 0.1, 0.0).accepts(), "as much is expected after days");
    for (changed, grain) in [(0.02, 0.98), (0.002, 0.0), (0.02, f64::NAN)] {
        let open = of(changed, 0.001, grain);
        assert!(!open.accepts() && !open.is_double() && open.doubt().unwrap().is_similar_place());
    }
    // What looks like wear may be print, whatever it says.
    let answered = |grain: f64| {
        let place = PlaceEvidence { answer: Answer::SameChanged, grain, changed: 0.02, ..PLACE };
        verdict(Evidence { place: Some(place), ..ENOUGH })
    };
    assert!(answered(0.99).accepts() && !answered(0.8).accepts());
}

/// What was moved differs in one place too: where grain that is all over tells that it is one, that decides, and views that cannot be aligned
/// contradict nothing. The pose must still be right.
#[test]
fn grain_that_is_all_over_outweighs_what_differs() {
    let same = PlaceEvidence { answer: Answer::SameChanged, inlier_wear: 0.1, changed: 0.2, ..PLACE };
    let of = |place: PlaceEvidence, beyond: Beyond| {
        verdict(Evidence { place: Some(place), beyond: Some(beyond), ..ENOUGH })
    };
    let moved = Beyond { absent_share: 0.1, unlike_share: 0.1, absent_views: 8, unlike_views: 8, ..BEYOND };
    assert!(of(same, moved).accepts());
    for place in [
        PlaceEvidence { inlier_wear: 0.09, ..same },
        PlaceEvidence { grain: 0.98, ..same },
        PlaceEvidence { answer: Answer::CannotTell, changed: 0.0, ..same },
    ] {
        assert!(!of(place, moved).accepts(), "{place:?}");
    }
    for wrong in [Beyond { failed: 2, ..BEYOND }, Beyond { confirmed: 1, ..BEYOND }] {
        assert!(matches!(of(same, wrong).decision, Decision::Undecided(Doubt::Alone { .. })));
        assert!(matches!(of(PLACE, wrong).decision, Decision::Refused(Doubt::Alone { .. })));
    }
    assert!(!of(same, Beyond { rival: 3, ..BEYOND }).accepts());
    assert!(!of(same, Beyond { through_share: 0.06, ..BEYOND }).accepts());
}

/// A person knows the place, and not the pose.
#[test]
fn who_confirms_a_place_settles_what_differs_and_nothing_else() {
    let confirmed = |evidence| verdict(evidence).confirmed(&AcceptanceParams::default());
    for evidence in [
        undecided(0.3),
        of_place(Answer::Different, -9.0),
        beyond(Beyond { absent_share: 0.5, unlike_share: 0.5, absent_views: 8, unlike_views: 8, ..BEYOND }),
    ] {
        assert!(
            !verdict(evidence).accepts() && confirmed(evidence).accepts() && confirmed(evidence).is_confirmed
        );
    }
    for evidence in [
        Evidence { inlier_share: 0.4, ..undecided(0.3) },
        Evidence { rival_place: Some(0.8), ..undecided(0.3) },
        Evidence { beyond: Some(Beyond { rival: 3, ..BEYOND }), ..undecided(0.3) },
        Evidence { scale_deviation: 0.5, ..undecided(0.3) },
    ] {
        assert!(!confirmed(evidence).accepts(), "{evidence:?}");
    }
}

/// Depths may be wrong in one view or two; a thing that is not there is missing in all.
#[test]
fn a_view_or_two_say_nothing() {
    let none = Beyond { absent_views: 0, absent_share: 0.0, unlike_views: 0, unlike_share: 0.0, ..BEYOND };
    assert!(verdict(beyond(Beyond { absent_views: 2, absent_share: 0.5, ..none })).accepts());
    assert!(verdict(beyond(Beyond { unlike_views: 2, unlike_share: 0.5, ..none })).accepts());
}

#[test]
fn a_doubt_says_what_is_missing() {
    let doubt = verdict(Evidence { matches: 31, ..ENOUGH }).doubt().unwrap();
    assert_eq!(doubt.to_string(), "only 31 key points match over the pairs that agree; 60 are needed");
    let doubt = verdict(beyond(Beyond { confirmed: 1, tested: 8, ..BEYOND })).doubt().unwrap();
    assert!(doubt.to_string().starts_with("only 1 of 8 other keyframe pairs"), "{doubt}");
}
