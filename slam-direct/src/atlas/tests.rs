//! A run with losses, on rendered drives.

use super::*;
use crate::test_scene::without_points;
use geometry::{GrayImage, Se3, umeyama};
use loopbox_tests::{Recording, World, trajectory};
use place_recog::ThumbnailIndex;

mod claims;
mod moving;
mod recognised;
mod scale;
mod splitting;

const RATE: f64 = 20.0;

fn atlas() -> Atlas {
    Atlas::new(Recording::SMALL_CAMERA, || Box::new(ThumbnailIndex::default()), Params::default())
        .expect("it can be worked with")
}

/// A drive past the boxes of a world of its own.
fn drive(seed: u64, count: usize) -> Recording {
    let path = trajectory::sideways(count, 0.05 * count as f64);
    Recording::render(&World::yard(seed), Recording::SMALL_CAMERA, &path, RATE)
}

/// Gives the atlas images at `RATE`, beginning with frame `first`.
fn feed<'a>(
    atlas: &mut Atlas,
    first: usize,
    images: impl IntoIterator<Item = &'a GrayImage>,
) -> Vec<FrameReport> {
    let frame = |(i, image): (usize, &GrayImage)| Frame {
        index: (first + i) as u64,
        timestamp: (first + i) as f64 / RATE,
        image: image.clone(),
        color: None,
    };
    images
        .into_iter()
        .enumerate()
        .map(|(i, image)| atlas.process(frame((i, image))).expect("it is of the size"))
        .collect()
}

fn images(recording: &Recording) -> Vec<&GrayImage> {
    recording.shots.iter().map(|shot| shot.image.as_ref()).collect()
}

/// Root mean square distance of a fragment's frames from the truth once unit and world are fitted, metres.
fn error(map: &Map, truth: impl Fn(u64) -> Se3) -> f64 {
    let found: Vec<_> = map.trajectory().iter().map(|p| p.world_from_camera.translation).collect();
    let truth: Vec<_> = map.frames.iter().map(|f| truth(f.frame_index).translation).collect();
    let fit = umeyama::sim3(&found, &truth).unwrap();
    let square: f64 = found.iter().zip(&truth).map(|(f, t)| (fit * *f - t).norm_squared()).sum();
    (square / found.len() as f64).sqrt()
}

/// The camera is carried to another world and back: both are mapped, and the first is found again.
#[test]
fn a_camera_carried_elsewhere_and_back_has_two_fragments() {
    let (here, elsewhere) = (drive(1, 50), drive(2, 60));
    let mut atlas = atlas();
    feed(&mut atlas, 0, images(&here));
    let away = feed(&mut atlas, 50, images(&elsewhere));
    let back = feed(&mut atlas, 110, images(&here).into_iter().rev());
    atlas.finish_until(&|| false);
    assert_eq!((away[59].state, away[59].fragment), (TrackingState::Tracking, 1), "{:?}", away[59].reason);
    let found = back.iter().position(|r| r.state == TrackingState::Tracking && r.fragment == 0);
    assert!(found.is_some_and(|i| i <= 3), "found again after {found:?} frames");
    assert!(back[found.unwrap()..].iter().all(|r| r.state == TrackingState::Tracking && r.fragment == 0));
    let maps = atlas.into_maps();
    assert_eq!(maps.len(), 2);
    // What came before the second map was certain is tracked backwards; only the half second of search is lost.
    let tracked_away = maps[1].frames.len();
    assert!(tracked_away >= 48, "{tracked_away} of 60 frames elsewhere have poses");
    assert!(error(&maps[1], |i| elsewhere.shots[i as usize - 50].world_from_camera) < 0.03);
    let there_and_back = |i: u64| match i {
        0..50 => here.shots[i as usize].world_from_camera,
        _ => here.shots[159 - i as usize].world_from_camera,
    };
    assert!(error(&maps[0], there_and_back) < 0.03);
}

/// Who takes in all deltas of all fragments has their maps, though reports of a fragment that is only tried are not seen.
#[test]
fn no_delta_of_a_fragment_is_lost() {
    let (here, elsewhere) = (drive(1, 50), drive(2, 60));
    let mut atlas = atlas();
    let reports = [
        feed(&mut atlas, 0, images(&here)),
        feed(&mut atlas, 50, images(&elsewhere)),
        feed(&mut atlas, 110, images(&here).into_iter().rev()),
    ];
    let mut replica = [(); 2].map(|()| Map::new(Recording::SMALL_CAMERA));
    let mut next = [0; 2];
    for report in reports.concat() {
        for delta in report.deltas {
            assert_eq!(delta.sequence, next[report.fragment], "of fragment {}", report.fragment);
            next[report.fragment] += 1;
            replica[report.fragment].take_in(delta);
        }
    }
    let fragments = atlas.fragments();
    assert_eq!(fragments.len(), 2);
    assert!(
        replica
            .iter()
            .zip(fragments)
            .all(|(replica, agent)| without_points(replica) == without_points(agent.map()))
    );
}

/// The lens is covered for longer than a new fragment waits for, and the camera stays where it is.
#[test]
fn a_covered_lens_makes_no_fragment() {
    let here = drive(1, 50);
    let black = GrayImage::filled(320, 240, 0);
    let mut atlas = atlas();
    feed(&mut atlas, 0, images(&here));
    let covered = feed(&mut atlas, 50, vec![&black; 40]);
    assert!(covered.iter().all(|r| r.state == TrackingState::Lost && r.reason.is_some()));
    let after = feed(&mut atlas, 90, images(&here).into_iter().rev());
    assert!(after.iter().all(|r| r.state == TrackingState::Tracking && r.fragment == 0));
    atlas.finish_until(&|| false);
    assert_eq!(atlas.into_maps().len(), 1);
}

/// A recording that ends soon after a loss keeps what was tracked since.
#[test]
fn a_fragment_that_had_no_time_to_grow_is_kept() {
    let (here, elsewhere) = (drive(1, 50), drive(2, 60));
    let mut atlas = atlas();
    feed(&mut atlas, 0, images(&here));
    feed(&mut atlas, 50, images(&elsewhere).into_iter().take(22));
    atlas.finish_until(&|| false);
    let maps = atlas.into_maps();
    assert_eq!(maps.len(), 2);
    assert!(maps[1].frames.len() >= 8, "{}", maps[1].frames.len());
}
