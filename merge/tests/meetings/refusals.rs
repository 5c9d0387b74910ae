//! What must not merge, and maps with something wrong in them.

use crate::merging::{PairResult, features, pair_result, pair_result_everywhere, reasons};
use crate::rendered::rendered_map;
use crate::yard::{past, yard};
use backend::posegraph::PoseGraphError;
use geometry::{GrayImage, Se3};
use loopbox_tests::World;
use loopbox_tests::similar_places::Kind;
use map::{KeyframeId, Map, MapError, SemiDense};
use merge::common_map::{CommonMap, FusionError, FusionParams};
use merge::further::{FurtherParams, join};
use merge::key_points::KeyPointParams;
use merge::prepared::PreparedMap;
use merge::verification::{Outcome, Place, VerificationParams, meet};
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock};

/// Turned right by `yaw`.
fn turned(yaw: f64) -> Se3 {
    Se3::new(UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw), Vector3::zeros())
}

/// Five keyframes past the boxes, x from −1 to 1 m.
fn here() -> &'static Map {
    static MAP: LazyLock<Map> =
        LazyLock::new(|| rendered_map(yard(), &past(-1.0, 1.0, 0.5, &Se3::identity())));
    &MAP
}

/// Five keyframes over the same place, a little aside.
fn there() -> &'static Map {
    static MAP: LazyLock<Map> = LazyLock::new(|| rendered_map(yard(), &past(-0.7, 1.3, 0.5, &turned(0.1))));
    &MAP
}

/// Fails when the maps meet, whichever way they are asked.
fn assert_strangers(target: &Map, source: &Map) {
    let proposed = pair_result(target, source);
    assert!(proposed.closure().is_none(), "{:?}", reasons(&proposed));
    let everywhere = pair_result_everywhere(target, source);
    assert!(everywhere.closure().is_none(), "{:?}", reasons(&everywhere));
    assert!(everywhere.joined.is_none());
}

/// The counterpart of all refusals here: maps of this kind do meet, and the true motion between them, none, comes out.
#[test]
fn maps_of_one_place_meet() {
    let met = pair_result(here(), there());
    let closure = met.closure().unwrap_or_else(|| panic!("{:?}", reasons(&met)));
    let off = closure.motion.a_from_b.log();
    assert!(off.amax() < 0.01, "the worlds are one: {off}");
    let joined = met.joined.as_ref().expect("an accepted closure is joined");
    assert!(joined.edges.len() >= 3 && joined.rejected.is_empty(), "{joined:?}");
}

#[test]
fn yards_that_share_nothing_stay_apart() {
    let elsewhere = rendered_map(&World::yard(8), &past(-1.0, 1.0, 0.5, &Se3::identity()));
    assert_strangers(here(), &elsewhere);
    let room = rendered_map(&World::varied(3), &past(-1.0, 1.0, 0.5, &Se3::identity()));
    assert_strangers(here(), &room);
}

/// A map of one way past a place of equal houses.
fn houses(place: u64, pass: u64) -> Map {
    let path = Kind::Houses.path(2, place, pass, 72);
    rendered_map(&Kind::Houses.place(2, place), &path.into_iter().step_by(6).collect::<Vec<_>>())
}

/// Before these houses nothing stands where the maps see the same: shifted by a house they fit in all that is asked but that
/// they fit elsewhere as well.
#[test]
fn a_row_of_equal_houses_is_no_place() {
    let one = houses(5, 1);
    let others = [(8, 1), (3, 1), (8, 0)].map(|(place, pass)| pair_result(&houses(place, pass), &one));
    for other in &others {
        assert!(other.closure().is_none(), "{:?}", reasons(other));
    }
    let elsewhere = |other: &PairResult| reasons(other).iter().any(|reason| reason.contains("another place"));
    assert!(others.iter().any(elsewhere), "{:?}", others.each_ref().map(reasons));
}

/// One yard in one recording, first ahead, then back: nothing is seen twice.
#[test]
fn halves_without_overlap_stay_apart() {
    let behind = rendered_map(yard(), &past(-1.0, 1.0, 0.5, &turned(PI)));
    assert_strangers(here(), &behind);
}

#[test]
fn blank_images_match_nothing() {
    let mut blank = there().clone();
    for keyframe in blank.keyframes.values_mut() {
        keyframe.image = Arc::new(GrayImage::filled(keyframe.image.width(), keyframe.image.height(), 128));
    }
    for (target, source) in [(here(), &blank), (&blank, here()), (&blank, &blank)] {
        let met = pair_result_everywhere(target, source);
        assert!(!met.tested.is_empty());
        let unmatched =
            |tested: &merge::verification::TestedPlace| matches!(tested.outcome, Outcome::NotMatched(_));
        assert!(met.tested.iter().all(unmatched), "{:?}", reasons(&met));
    }
}

#[test]
fn keyframes_without_depth_are_not_looked_at() {
    let mut flat = there().clone();
    flat.keyframes.values_mut().for_each(|keyframe| keyframe.semi_dense = SemiDense::default().into());
    for (target, source) in [(here(), &flat), (&flat, here())] {
        assert!(pair_result(target, source).tested.is_empty());
    }
}

#[test]
fn an_empty_map_meets_nobody() {
    let empty = Map::new(loopbox_tests::Recording::SMALL_CAMERA);
    assert!(pair_result(here(), &empty).tested.is_empty());
    assert!(pair_result(&empty, here()).tested.is_empty());
    let (common, _) = CommonMap::from_maps(&[here(), &empty]).unwrap();
    assert_eq!(common.fuse(&FusionParams::default()).unwrap().len(), 2);
}

#[test]
fn one_map_twice_is_refused() {
    let refusal = CommonMap::from_maps(&[here(), here()]).unwrap_err();
    assert!(matches!(refusal, MapError::SameMapTwice { maps: [0, 1], .. }), "{refusal}");
}

/// A place that no longer is in a map, or has no features, is passed over.
#[test]
fn places_that_are_not_there_are_passed_over() {
    let (of_here, mut of_there) = (features(here()), features(there()));
    of_there.remove(KeyframeId(1));
    let key_points = KeyPointParams::default();
    let target = PreparedMap::new(here(), &of_here, &key_points);
    let source = PreparedMap::new(there(), &of_there, &key_points);
    let place = |source, target| Place { source: KeyframeId(source), target: KeyframeId(target) };
    let places = [place(77, 0), place(0, 77), place(1, 1)];
    let (usual_params, further) = (VerificationParams::default(), FurtherParams::default());
    assert!(meet(&source, &target, &places, &usual_params, &further).is_empty());
}

/// Of many good places only as many are matched as asked for, and only one is accepted.
#[test]
fn no_more_places_are_tested_than_asked_for() {
    let (of_here, of_there) = (features(here()), features(there()));
    let key_points = KeyPointParams::default();
    let target = PreparedMap::new(here(), &of_here, &key_points);
    let source = PreparedMap::new(there(), &of_there, &key_points);
    let places: Vec<Place> = (0..5).map(|k| Place { source: KeyframeId(k), target: KeyframeId(k) }).collect();
    let params = VerificationParams { places: 3, rounds: 1, ..VerificationParams::default() };
    let tested = meet(&source, &target, &places, &params, &FurtherParams::default());
    assert_eq!(tested.len(), 3);
    assert!(tested.windows(2).all(|pair| pair[0].match_count >= pair[1].match_count), "most matches first");
    assert_eq!(tested.iter().filter(|t| t.outcome.accepted().is_some()).count(), 1);
    let unwilling = VerificationParams { closures: 0, neighbourhoods: 0, ..params };
    let tested = meet(&source, &target, &places, &unwilling, &FurtherParams::default());
    assert!(tested.iter().all(|t| t.outcome == Outcome::NotFollowed));
}

/// Where no pair of keyframes is followed by itself, those around a place are matched together and say the same.
#[test]
fn keyframes_matched_together_say_what_their_pairs_do() {
    let (of_here, of_there) = (features(here()), features(there()));
    let key_points = KeyPointParams::default();
    let target = PreparedMap::new(here(), &of_here, &key_points);
    let source = PreparedMap::new(there(), &of_there, &key_points);
    let places: Vec<Place> = (0..5).map(|k| Place { source: KeyframeId(k), target: KeyframeId(k) }).collect();
    let found = |params: &VerificationParams| {
        let tested = meet(&source, &target, &places, params, &FurtherParams::default());
        tested.iter().find_map(|t| t.outcome.accepted().cloned()).expect("they meet")
    };
    let alone = found(&VerificationParams::default());
    let together = found(&VerificationParams { closures: 0, ..VerificationParams::default() });
    assert!(
        alone.closure.pooled.is_none() && together.closure.pooled.is_some_and(|pooled| pooled.matches >= 60)
    );
    let apart = together.closure.motion.a_from_b * alone.closure.motion.a_from_b.inverse();
    assert!(apart.log().norm() < 0.02, "{}", apart.log().norm());
}

/// A pose that is not a number is never believed, and named where maps are made of it.
#[test]
fn poses_that_are_no_numbers_are_refused() {
    let mut broken = there().clone();
    for keyframe in broken.keyframes.values_mut() {
        keyframe.world_from_keyframe.translation.x = f64::NAN;
    }
    for (target, source) in [(here(), &broken), (&broken, here())] {
        let met = pair_result(target, source);
        assert!(!met.tested.is_empty() && met.closure().is_none(), "{:?}", reasons(&met));
    }
}

/// One bad pose away from the meeting does not hide behind it.
#[test]
fn one_pose_that_is_no_number_is_named() {
    let mut broken = there().clone();
    let bad = KeyframeId(4);
    broken.keyframes.get_mut(&bad).unwrap().world_from_keyframe.scale = f64::NAN;
    let met = pair_result(here(), there());
    let closure = met.closure().expect("they meet");
    let (of_here, of_broken) = (features(here()), features(&broken));
    let key_points = KeyPointParams::default();
    let target = PreparedMap::new(here(), &of_here, &key_points);
    let source = PreparedMap::new(&broken, &of_broken, &key_points);
    let refusal = join(&source, &target, closure, &FurtherParams::default()).unwrap_err();
    assert_eq!(refusal, PoseGraphError::InvalidNode(bad));

    let (mut common, addresses) = CommonMap::from_maps(&[here(), there()]).unwrap();
    crate::merging::link(&mut common, [&addresses[0], &addresses[1]], &met);
    let own = addresses[1].agents().next().unwrap();
    assert!(common.update(own, broken));
    let refusal = common.fuse(&FusionParams::default()).unwrap_err();
    let named = matches!(&refusal, FusionError::Closures { source: PoseGraphError::InvalidNode(id), .. } if *id == bad);
    assert!(named, "{refusal}");
    assert!(common.update(own, there().clone()));
    assert_eq!(common.fuse(&FusionParams::default()).unwrap().len(), 1, "the bad map leaves no trace");
}
