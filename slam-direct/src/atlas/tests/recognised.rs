//! Places recognised from elsewhere, by somebody who knows where each image was taken.

use super::*;
use crate::recognise::{Hypothesis, KnownView};
use nalgebra::{UnitQuaternion, Vector3, Vector6};

/// Knows where images were taken, to 2 cm and half a degree.
pub(super) struct Oracle {
    recordings: Vec<Recording>,
    /// How far it recognises a place from, metres.
    reach: f64,
    /// By how much it errs.
    error: Se3,
}

impl Oracle {
    pub(super) fn new(recordings: &[&Recording], reach: f64) -> Box<Self> {
        let error = Se3::exp(&Vector6::new(0.015, -0.01, 0.01, 0.005, -0.005, 0.006));
        Box::new(Self { recordings: recordings.iter().map(|&r| r.clone()).collect(), reach, error })
    }

    fn truth(&self, image: &GrayImage) -> Option<Se3> {
        let mut shots = self.recordings.iter().flat_map(|recording| &recording.shots);
        shots.find(|shot| *shot.image == *image).map(|shot| shot.world_from_camera)
    }
}

impl Recognise for Oracle {
    fn recognise(&mut self, image: &GrayImage, _: &Pinhole, views: &[KnownView]) -> Vec<Hypothesis> {
        let Some(frame) = self.truth(image) else { return Vec::new() };
        let mut found = Vec::new();
        for fragment in 0..views.iter().map(|view| view.fragment + 1).max().unwrap_or(0) {
            let of_fragment = views.iter().filter(|view| view.fragment == fragment);
            let known: Vec<(&KnownView, Se3)> =
                of_fragment.filter_map(|view| Some((view, self.truth(&view.image)?))).collect();
            let away = |pose: &Se3| (pose.translation - frame.translation).norm();
            let nearest = known.iter().min_by(|a, b| away(&a.1).total_cmp(&away(&b.1)));
            let Some((view, truth)) = nearest.filter(|near| away(&near.1) < self.reach) else { continue };
            let (Some(first), Some(last)) = (known.first(), known.last()) else { continue };
            let travelled = first.0.world_from_keyframe.translation - last.0.world_from_keyframe.translation;
            let metre = travelled.norm() / (first.1.translation - last.1.translation).norm();
            let relative = truth.inverse() * frame * self.error;
            let translation = relative.translation * (metre / view.world_from_keyframe.scale);
            let keyframe_from_frame = Se3::new(relative.rotation, translation);
            found.push(Hypothesis { fragment, keyframe: view.keyframe, keyframe_from_frame });
        }
        found
    }
}

fn rendered(path: &[Se3]) -> Recording {
    Recording::render(&World::yard(1), Recording::SMALL_CAMERA, path, RATE)
}

/// The lens is covered for a moment, in which the camera is moved aside and rolled.
#[test]
fn a_camera_that_comes_back_elsewhere_continues_its_map() {
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.6);
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.25);
    let aside = Se3::new(yaw * roll, Vector3::new(-1.2, 0.0, 0.4));
    let path = trajectory::sideways(80, 4.0);
    let (here, there) =
        (rendered(&path[..50]), rendered(&path[50..].iter().map(|p| *p * aside).collect::<Vec<_>>()));
    let black = GrayImage::filled(320, 240, 0);
    let all = || images(&here).into_iter().chain([&black; 30]).chain(images(&there));
    let run = |recogniser: Option<Box<Oracle>>| {
        let mut atlas = atlas();
        if let Some(recogniser) = recogniser {
            atlas = atlas.recognising(recogniser);
        }
        let reports = feed(&mut atlas, 0, all());
        atlas.finish_until(&|| false);
        (reports, atlas.into_maps())
    };
    let (reports, maps) = run(None);
    assert!(reports[109].fragment == 1 && maps.len() == 2, "from there nothing else finds it");
    let (reports, maps) = run(Some(Oracle::new(&[&here, &there], 3.0)));
    let found = reports[80..].iter().position(|report| report.state == TrackingState::Tracking);
    assert!(found.is_some_and(|i| i <= 10), "found again after {found:?} frames");
    assert!(reports.iter().all(|report| report.fragment == 0));
    assert_eq!(maps.len(), 1);
    // The frames that were shown before it was found have their poses as well.
    let since: Vec<u64> = maps[0].frames.iter().map(|f| f.frame_index).filter(|i| *i >= 50).collect();
    assert_eq!(since, (80..110).collect::<Vec<_>>());
    let shots: Vec<Se3> = here.shots.iter().chain(&there.shots).map(|shot| shot.world_from_camera).collect();
    let truth = |i: u64| shots[if i < 50 { i } else { i - 30 } as usize];
    assert!(error(&maps[0], truth) < 0.03, "{}", error(&maps[0], truth));
    let (again, _) = run(Some(Oracle::new(&[&here, &there], 3.0)));
    let poses = |reports: &[FrameReport]| reports.iter().map(|r| r.world_from_camera).collect::<Vec<_>>();
    assert_eq!(poses(&reports), poses(&again), "runs repeat");
}

/// Another world is taken for the one that is known.
#[test]
fn a_place_that_is_not_there_is_not_believed() {
    let (here, elsewhere) = (drive(1, 50), drive(2, 60));
    // Both drives are the same way in their worlds: each image of the one is said to be where the other was taken.
    let oracle = Oracle::new(&[&here, &elsewhere], 3.0);
    let mut atlas = atlas().recognising(oracle);
    let reports = feed(&mut atlas, 0, images(&here).into_iter().chain(images(&elsewhere)));
    atlas.finish_until(&|| false);
    assert_eq!((reports[109].state, reports[109].fragment), (TrackingState::Tracking, 1));
    let maps = atlas.into_maps();
    assert_eq!(maps.len(), 2, "neither is it found there, nor are the maps joined");
    assert!(maps[0].frames.iter().all(|frame| frame.frame_index < 50));
}

/// Fragments that seem to meet are one only where that is decided.
#[test]
fn fragments_that_meet_stay_apart_where_it_is_not_decided() {
    use crate::judge::ClaimedPlace;
    use backend::verdict::Answer;
    struct Doubts;
    impl JudgePlace for Doubts {
        fn judge(&self, claim: &ClaimedPlace) -> Answer {
            assert!(!claim.frames.is_empty() && !claim.keyframes.is_empty());
            Answer::CannotTell
        }
    }
    let path = trajectory::sideways(201, 10.0);
    let back: Vec<Se3> = path[20..=180].iter().rev().copied().collect();
    let (here, there) = (rendered(&path[..60]), rendered(&back));
    let black = GrayImage::filled(320, 240, 0);
    let mut atlas = atlas().recognising(Oracle::new(&[&here, &there], 1.2)).judge_by(Arc::new(Doubts));
    feed(&mut atlas, 0, images(&here).into_iter().chain([&black; 12]));
    let reports = feed(&mut atlas, 72, images(&there));
    assert!(reports.last().is_some_and(|r| r.state == TrackingState::Tracking && r.fragment == 1));
    atlas.finish_until(&|| false);
    let maps = atlas.into_maps();
    assert_eq!(maps.len(), 2);
    assert!(maps[0].frames.iter().all(|frame| frame.frame_index < 72));
}

/// The camera is lost, is used elsewhere, and comes to where it was before: two maps become one while it goes on.
#[test]
fn fragments_that_meet_become_one() {
    let path = trajectory::sideways(201, 10.0);
    let back: Vec<Se3> = path[20..=180].iter().rev().copied().collect();
    let (here, there) = (rendered(&path[..60]), rendered(&back));
    let black = GrayImage::filled(320, 240, 0);
    let mut atlas = atlas().recognising(Oracle::new(&[&here, &there], 1.2));
    let mut reports = feed(&mut atlas, 0, images(&here).into_iter().chain([&black; 12]));
    reports.extend(feed(&mut atlas, 72, images(&there)));
    let apart = reports.iter().position(|report| report.fragment == 1).expect("it is lost and begins anew");
    let joined = reports.iter().rposition(|report| report.fragment == 1).expect("it is apart") + 1;
    assert!(apart < joined && joined < reports.len(), "{apart} {joined} of {}", reports.len());
    assert!(reports[joined..].iter().all(|report| report.state == TrackingState::Tracking));
    // Who takes in what is said has the map.
    let mut replica = Map::new(Recording::SMALL_CAMERA);
    let deltas = reports.iter().filter(|report| report.fragment == 0).flat_map(|report| &report.deltas);
    deltas.cloned().for_each(|delta| replica.take_in(delta));
    assert!(without_points(&replica) == without_points(atlas.active().map()));
    assert!(atlas.active().map().keyframes.values().any(|keyframe| keyframe.frame_index > 72));
    atlas.finish_until(&|| false);
    let maps = atlas.into_maps();
    assert_eq!(maps.len(), 1);
    let map = &maps[0];
    map.check().expect("it is whole");
    assert!(map.frames.windows(2).all(|two| two[0].frame_index < two[1].frame_index));
    assert!(map.frames.len() > 210, "{} of 221 frames have poses", map.frames.len());
    let shots: Vec<Se3> = here.shots.iter().chain(&there.shots).map(|shot| shot.world_from_camera).collect();
    let truth = |i: u64| shots[if i < 60 { i } else { i - 12 } as usize];
    assert!(error(map, truth) < 0.05, "{}", error(map, truth));
}
