//! Places that share what is made in numbers, and the same place after things were moved.

use crate::merging::{PairResult, pair_result_after, reasons};
use crate::rendered::{noisy_map, rendered_map};
use backend::sim3_align::KeyframeView;
use geometry::Pyramid;
use loopbox_tests::doubles::{Kind, Version};
use map::{Map, SemiDense};
use merge::key_points::KeyPointParams;
use merge::place_verdict::{Answer, PlaceParams, SeenFrame, frames_verdict};
use merge::prepared::PreparedMap;
use place_recog::KeyframeFeatures;

/// An office of one plan with walls and boards that have a grain of their own.
const HERE: Version = Version::first(1, 3.0);

fn map(version: &Version, pass: u64) -> Map {
    rendered_map(&Kind::Office.world(version), &Kind::Office.path(pass, 8))
}

/// The same of another kind, with noise of as many grey levels as cameras have.
fn noisy(kind: Kind, version: &Version, pass: u64) -> Map {
    noisy_map(&kind.world(version), &kind.path(pass, 8), (1.5, pass))
}

/// What both ways past two versions of an office make of each other so many days apart, whichever is looked for in the other.
fn met(other: &Version, days: f64) -> [PairResult; 2] {
    let (here, there) = (map(&HERE, 0), map(other, 1));
    [pair_result_after(&here, &there, days), pair_result_after(&there, &here, days)]
}

/// Whether little differs or everything that can: the grain of its walls tells an office from its double, and later as well.
#[test]
fn offices_of_one_plan_are_two() {
    for (share, days) in [(0.02, 0.0), (1.0, 0.0), (0.3, 30.0)] {
        for met in met(&Version { place: 1, share, ..HERE }, days) {
            assert!(met.closure().is_none(), "{share} differs after {days} days: {:?}", reasons(&met));
        }
    }
}

/// Of aisles and halls of one stock nearly all that is in view is alike; what tells them is a grain fainter than the noise.
#[test]
fn places_of_one_stock_are_two() {
    for (kind, number) in [(Kind::Aisle, 1), (Kind::Hall, 0)] {
        let here = Version { seed: number + 1, ..HERE };
        let [first, same, double] = [
            noisy(kind, &here, 2 * number),
            noisy(kind, &Version { time: 1, ..here }, 2 * number + 1),
            noisy(kind, &Version { place: number + 1, share: 0.02, ..here }, 2 * number + 1),
        ];
        assert!(pair_result_after(&first, &same, 0.0).closure().is_some(), "{kind:?}");
        for met in [pair_result_after(&first, &double, 0.0), pair_result_after(&double, &first, 0.0)] {
            assert!(met.closure().is_none(), "{kind:?}");
        }
    }
}

/// The office itself is joined, whichever way is looked for in the other.
#[test]
fn an_office_is_the_same_at_another_time() {
    for met in met(&Version { time: 1, ..HERE }, 0.0) {
        let closure = met.closure().unwrap_or_else(|| panic!("{:?}", reasons(&met)));
        assert!(closure.motion.a_from_b.log().amax() < 0.02, "the worlds are one");
    }
}

/// What frames of a version of the office say, which have no depth, where they were taken of the office itself.
fn seen(other: &Version) -> Answer {
    let (here, there) = (map(&HERE, 0), map(other, 1));
    let features: KeyframeFeatures = here.keyframes.keys().map(|&id| (id, Default::default())).collect();
    let key_points = KeyPointParams::default();
    let prepared = PreparedMap::new(&here, &features, &key_points);
    let frame = |keyframe: &map::Keyframe| {
        let pyramid = Pyramid::new(keyframe.image.as_ref().clone(), 5);
        let view = KeyframeView::new(&pyramid, &SemiDense::default(), there.camera(keyframe));
        SeenFrame { world_from_frame: keyframe.world_from_keyframe, view }
    };
    let frames: Vec<SeenFrame> = there.keyframes.values().map(frame).collect();
    frames_verdict(&prepared, &frames, &PlaceParams::default()).weighed.answer
}

/// Frames alone tell the office from its double, and know it again.
#[test]
fn frames_without_depth_tell_an_office_from_its_double() {
    assert!(seen(&Version { time: 1, ..HERE }).joins());
    for share in [0.02, 0.3, 1.0] {
        let answer = seen(&Version { place: 1, share, ..HERE });
        assert!(!answer.joins(), "{share}: {answer}");
    }
}
