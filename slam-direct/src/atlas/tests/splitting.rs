//! A fragment that is parted where its scale is not carried on, while the camera goes on.

use super::*;
use std::collections::BTreeSet;

/// Frames before the one with which the fragment is parted, and in all.
const BEFORE: usize = 60;
const ALL: usize = 90;

/// A break of the scale that was found behind this keyframe.
fn break_behind(before: KeyframeId) -> ScaleBreak {
    ScaleBreak { before, points: 9, inliers: 3 }
}

/// An atlas that has tracked so many frames of a drive, and a keyframe in the middle of its map.
fn tracked(here: &Recording) -> (Atlas, Vec<FrameReport>, KeyframeId) {
    let mut atlas = atlas();
    let reports = feed(&mut atlas, 0, images(here).into_iter().take(BEFORE));
    let middle = KeyframeId(atlas.active().map().keyframes.len() as u32 / 2);
    (atlas, reports, middle)
}

/// The camera goes on in the later part at once, and finds what it sees of the earlier one there when it comes back.
#[test]
fn a_fragment_ends_where_its_scale_is_not_carried_on() {
    let here = drive(1, ALL);
    let (mut atlas, mut reports, middle) = tracked(&here);
    atlas.fragments[0].forget_across(middle);
    atlas.scale_break = Some((0, break_behind(middle)));
    let after = feed(&mut atlas, BEFORE, images(&here).into_iter().skip(BEFORE));
    assert!(after.iter().all(|r| r.state == TrackingState::Tracking && r.fragment == 1));
    let told: Vec<_> =
        after.iter().map(|r| r.scale_break.map(|found| (found.before, found.inliers))).collect();
    assert_eq!((told[0], told[1..].iter().flatten().count()), (Some((middle, 0)), 0));
    reports.extend(after);
    // Deltas give the maps, and no frame is lost between them.
    reports.push(FrameReport { fragment: 0, deltas: atlas.fragments[0].take_deltas(), ..reports[0].clone() });
    let mut replica = [(); 2].map(|()| Map::new(Recording::SMALL_CAMERA));
    let mut next = [0; 2];
    for report in reports {
        for delta in report.deltas {
            assert_eq!(delta.sequence, next[report.fragment], "of fragment {}", report.fragment);
            next[report.fragment] += 1;
            replica[report.fragment].take_in(delta);
        }
    }
    for (replica, agent) in replica.iter().zip(atlas.fragments()) {
        assert!(without_points(replica) == without_points(agent.map()));
    }
    let back = feed(&mut atlas, ALL, images(&here).into_iter().rev());
    assert!(back.iter().filter(|r| r.state == TrackingState::Tracking).count() > ALL - 5);
    atlas.finish_until(&|| false);
    let maps = atlas.into_maps();
    let truth = |i: u64| here.shots[(i as usize).min(2 * ALL - 1 - i as usize)].world_from_camera;
    for map in &maps {
        assert!(error(map, truth) < 0.03, "{}", error(map, truth));
    }
    let frames: BTreeSet<u64> =
        maps.iter().flat_map(|map| &map.frames).map(|frame| frame.frame_index).collect();
    assert!(frames.len() > 2 * ALL - 5, "{}", frames.len());
}

/// Between what was found and when the map may be parted, a loop or more points may have carried the scale.
#[test]
fn a_fragment_whose_scale_is_carried_is_not_parted() {
    let here = drive(1, ALL);
    let (mut atlas, _, middle) = tracked(&here);
    atlas.scale_break = Some((0, break_behind(middle)));
    let after = feed(&mut atlas, BEFORE, images(&here).into_iter().skip(BEFORE));
    assert!(after.iter().all(|r| r.state == TrackingState::Tracking && r.fragment == 0));
    assert!(after.iter().all(|r| r.scale_break.is_none()));
    assert_eq!((atlas.fragments().len(), atlas.scale_break), (1, None));
}
