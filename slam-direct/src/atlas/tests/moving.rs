//! Something that was mapped moves, or comes and goes.

use super::recognised::Oracle;
use super::*;
use loopbox_tests::moving::{Mover, moving};

/// Reports on the frames of a recording up to `until`, with the finished maps and the error of each, metres.
fn tracked(mover: Mover, coverage: f64, until: usize) -> (Vec<FrameReport>, Vec<(Map, f64)>) {
    let recording = moving(mover, coverage, 1).recording;
    let mut atlas = atlas();
    let reports = feed(&mut atlas, 0, images(&recording).into_iter().take(until));
    atlas.finish_until(&|| false);
    let truth = |i: u64| recording.shots[i as usize].world_from_camera;
    let with_error = |map: Map| {
        let error = error(&map, truth);
        (map, error)
    };
    (reports, atlas.into_maps().into_iter().map(with_error).collect())
}

/// A lorry covers half of the view, stands there for four seconds and drives off: its points agree with one motion and the others with
/// another, of which the lorry's used to be followed.
#[test]
fn where_a_part_of_the_map_drives_off_the_map_ends_and_says_why() {
    let (reports, maps) = tracked(Mover::Departing, 0.6, 190);
    let lost = reports.iter().position(|report| report.state == TrackingState::Lost).expect("it is lost");
    assert!((130..160).contains(&lost), "lost at {lost}");
    assert_eq!(reports[lost].loss, Some(LossReason::TwoMotions));
    assert!(reports[lost].reason.is_some_and(|why| why.contains("moves against the rest")));
    let errors: Vec<f64> = maps.iter().map(|(_, error)| *error).collect();
    assert!(errors.iter().all(|error| *error < 0.05), "{errors:?}");
}

/// The lorry that drives off is what is found again in the map, since it fills most of the view: features on it say where the camera is
/// beside it.
#[test]
fn a_map_that_a_part_of_left_is_not_gone_on_in_by_that_part() {
    let recording = moving(Mover::Departing, 0.6, 460).recording;
    let mut beside = recording.clone();
    for (i, shot) in beside.shots.iter_mut().enumerate().skip(145) {
        shot.world_from_camera.translation.x -= 0.6 * ((i as f64 - 140.0) / 30.0).powi(2);
    }
    let mut params = Params::default();
    params.track.max_rival = 0.15;
    let places = || -> Box<dyn PlaceIndex> { Box::new(ThumbnailIndex::default()) };
    let atlas = Atlas::new(recording.camera, places, params).expect("it can be worked with");
    let mut atlas = atlas.recognising(Oracle::new(&[&beside], 3.0));
    let reports = feed(&mut atlas, 0, images(&recording).into_iter().take(200));
    let lost =
        reports.iter().position(|report| report.loss == Some(LossReason::TwoMotions)).expect("it is lost");
    let is_back = |report: &FrameReport| report.state == TrackingState::Tracking && report.fragment == 0;
    assert!(lost < 160 && !reports[lost..].iter().any(is_back), "{lost}");
    assert!(reports[lost..].iter().any(|report| report.fragment == 1), "it goes on in another map");
}

/// A camera that is switched on while a lorry drives off before it: two or three views cannot tell that the lorry moves, and a map that was begun
/// with them is given up once more do.
#[test]
fn a_map_is_not_begun_with_what_drives_off() {
    let recording = moving(Mover::Departing, 0.6, 11).recording;
    let (mut atlas, first) = (atlas(), 160);
    let reports = feed(&mut atlas, first, images(&recording).into_iter().skip(first));
    atlas.finish_until(&|| false);
    let given_up =
        |report: &FrameReport| report.reason.is_some_and(|why| why.contains("something moves in the view"));
    assert!(reports.iter().any(given_up));
    for map in atlas.into_maps() {
        let error = error(&map, |i| recording.shots[i as usize].world_from_camera);
        assert!(error < 0.01, "{} frames, {error} m", map.frames.len());
    }
}

/// Whoever walks past was never mapped, or has few points: the rest of the view tells where the camera is.
#[test]
fn who_walks_past_ends_no_map() {
    let (reports, maps) = tracked(Mover::Person, 0.5, 200);
    assert!(reports.iter().all(|report| report.loss.is_none()));
    assert_eq!((maps.len(), maps[0].0.frames.len()), (1, 200));
}
