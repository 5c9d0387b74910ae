//! A robot with a low camera that drives up to a cupboard, turns on the spot and drives on: what comes into view while it turns
//! has no parallax but what a wrong focal length makes of the rotation.

use super::*;
use loopbox_tests::robot::{Drive, RATE};
use nalgebra::Vector3;

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
    const STRETCH: u64 = (3.0 * RATE) as u64;
    let truth = drive.path();
    let poses: Vec<(u64, Vector3<f64>)> = map
        .frames
        .iter()
        .map(|frame| frame.frame_index)
        .zip(map.trajectory().iter().map(|pose| pose.world_from_camera.translation))
        .collect();
    let scale = |first: u64| {
        let own = poses.iter().filter(|(i, _)| (first..first + STRETCH).contains(i));
        let (found, exact): (Vec<_>, Vec<_>) =
            own.map(|(i, found)| (*found, truth[*i as usize].translation)).unzip();
        // Of a turn on the spot alone nothing is said.
        let is_enough = found.len() as u64 > STRETCH / 2 && spread(&exact) > 0.05;
        is_enough.then(|| spread(&found) / spread(&exact))
    };
    let scales: Vec<f64> = (0..truth.len() as u64 - STRETCH).step_by(5).filter_map(scale).collect();
    let (least, most) = scales.iter().fold((f64::INFINITY, 0.0f64), |(l, m), s| (l.min(*s), m.max(*s)));
    most / least
}

/// Root mean square distance from the mean.
fn spread(points: &[Vector3<f64>]) -> f64 {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    (points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / count).sqrt()
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
