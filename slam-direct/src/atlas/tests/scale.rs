//! A robot with a low camera that drives up to a cupboard, turns on the spot and drives on: what comes into view while it turns
//! has no parallax but what a wrong focal length makes of the rotation.

use super::*;
use loopbox_tests::robot::{Drive, RATE};
use loopbox_tests::scale::{FoundAt, scale_ratio};

/// What the tracker makes of a drive: the reports and the fragments' maps.
fn track(drive: &Drive) -> (Vec<FrameReport>, Vec<Map>) {
    let recording = drive.recording();
    let index = || Box::new(ThumbnailIndex::default()) as Box<dyn PlaceIndex>;
    let mut atlas = Atlas::new(drive.assumed(), index, Params::default()).expect("a camera");
    let frame = |(i, shot): (usize, &loopbox_tests::Shot)| Frame {
        index: i as u64,
        timestamp: shot.timestamp,
        image: shot.image.as_ref().clone(),
        color: None,
    };
    let shots = recording.shots.iter().enumerate();
    let reports = shots.map(|shot| atlas.process(frame(shot)).expect("it is of the size")).collect();
    atlas.finish_until(&|| false);
    (reports, atlas.into_maps())
}

/// Largest ratio of the scales of two stretches of three seconds of a map, each over the truth.
fn worst_ratio(drive: &Drive, map: &Map) -> f64 {
    let truth = drive.path();
    let found = |(frame, pose): (&map::FramePose, map::StampedPose)| FoundAt {
        time: frame.frame_index as f64 / RATE,
        found: pose.world_from_camera.translation,
        truth: truth[frame.frame_index as usize].translation,
    };
    let frames: Vec<FoundAt> = map.frames.iter().zip(map.trajectory()).map(found).collect();
    scale_ratio(&frames, RATE).expect("it goes somewhere")
}

/// Nothing of the cupboard is in view after the turn: the map ends there and says why, and another one begins.
#[test]
fn a_scale_that_a_pure_rotation_does_not_carry_is_lost_and_not_made_up() {
    for (seed, angle, focal) in [(5, 1.57, 0.96), (7, 1.4, 1.05), (8, -1.4, 0.95)] {
        let drive = Drive { seed, angle, focal };
        let (reports, maps) = track(&drive);
        let lost = reports.iter().position(|report| report.state == TrackingState::Lost).expect("it is lost");
        assert!(
            (50..75).contains(&lost) && reports[lost].loss == Some(LossReason::Scale),
            "{seed}: lost at {lost}"
        );
        assert!(reports[lost].reason.is_some_and(|why| why.contains("scale")));
        assert_eq!(maps.len(), 2, "{seed}");
        for map in &maps {
            let ratio = worst_ratio(&drive, map);
            assert!(map.frames.len() >= 30 && ratio < 1.5, "{seed}: {} frames, {ratio}", map.frames.len());
        }
    }
}

/// A part of the cupboard stays in view: its points carry the scale over the turn.
#[test]
fn a_scale_that_points_in_view_carry_is_kept_over_a_pure_rotation() {
    let drive = Drive { seed: 3, angle: 1.1, focal: 1.04 };
    let (reports, maps) = track(&drive);
    assert!(reports.iter().all(|report| report.state != TrackingState::Lost && report.loss.is_none()));
    assert_eq!(maps.len(), 1);
    let (frames, ratio) = (maps[0].frames.len(), worst_ratio(&drive, &maps[0]));
    assert!(frames == drive.path().len() && ratio < 1.1, "{frames} frames, {ratio}");
}

/// A focal length that is 4 % short stretches what is seen in a turn, as a shutter does that reads columns. All rows are read at once here.
#[test]
fn a_wrong_focal_length_is_not_taken_for_a_shutter_that_reads_columns() {
    let drive = Drive::of(4 * 321 + 3);
    let (_, maps) = track(&drive);
    for map in &maps {
        let sensor = map.agents.values().find_map(map::AgentInfo::image_sensor);
        assert!(sensor.is_none_or(|sensor| !sensor.is_rolling()), "{sensor:?}");
        let ratio = worst_ratio(&drive, map);
        assert!(ratio < 1.5, "{} frames, {ratio}", map.frames.len());
    }
}
