//! Common maps of maps without images: the truth is exact, closures are made by hand.

mod agents;
mod arranged;
mod contradicting;

use super::*;
use crate::test_support::Numbers;
use agents::{Traveller, assert_near, exact, far_off};
use geometry::GrayImage;
use map::{Scan, Sensor};
use proptest::prelude::*;
use std::sync::Arc;

/// The common map of travellers, as they are.
fn common(travellers: &[&Traveller]) -> CommonMap {
    let maps: Vec<Map> = travellers.iter().map(|traveller| traveller.own_map()).collect();
    CommonMap::from_maps(&maps.iter().collect::<Vec<_>>()).unwrap().0
}

/// The one map of a common map whose agents hang together.
fn fused(common: &CommonMap, optimise: bool) -> Fused {
    let mut all = common.fuse(&FusionParams { optimise, ..FusionParams::default() }).unwrap();
    assert_eq!(all.len(), 1);
    all.remove(0)
}

fn address(agent: u16, keyframe: u32) -> Address {
    Address { agent: AgentId(agent), keyframe: KeyframeId(keyframe) }
}

#[test]
fn a_chain_of_three_is_in_the_world_of_the_first() {
    let [a, b, c] = [1, 2, 3].map(|seed| Traveller::new(seed, 5));
    let travellers = [&a, &b, &c];
    let mut common = common(&travellers);
    // c hangs on b, b on a.
    assert!(common.link(exact(&travellers, address(1, 4), address(2, 0))));
    assert!(common.link(exact(&travellers, address(0, 3), address(1, 1))));
    for optimise in [false, true] {
        let fused = fused(&common, optimise);
        assert_eq!(fused.agents, [AgentId(0), AgentId(1), AgentId(2)]);
        assert_eq!(fused.component.agents[&AgentId(2)].path.len(), 2);
        assert_near(&fused.map, &travellers, 1e-6);
        assert_eq!(fused.report.is_some(), optimise);
    }
}

#[test]
fn a_closure_says_the_same_from_either_side() {
    let [a, b] = [4, 5].map(|seed| Traveller::new(seed, 4));
    let travellers = [&a, &b];
    for (from, to) in [(address(0, 1), address(1, 2)), (address(1, 2), address(0, 1))] {
        let mut common = common(&travellers);
        assert!(common.link(exact(&travellers, from, to)));
        assert_near(&fused(&common, false).map, &travellers, 1e-6);
        assert_near(&fused(&common, true).map, &travellers, 1e-6);
    }
}

/// A keyframe without depth says nothing of how far its agent sees; what the other closures say holds all the same.
#[test]
fn a_keyframe_without_depth_undoes_no_merge() {
    let [a, b] = [6, 7].map(|seed| Traveller::new(seed, 4));
    let travellers = [&a, &b];
    let mut maps = travellers.map(|traveller| traveller.own_map());
    let bare = maps[0].keyframes.get_mut(&KeyframeId(1)).unwrap();
    bare.semi_dense = map::SemiDense::default().into();
    let (mut common, _) = CommonMap::from_maps(&[&maps[0], &maps[1]]).unwrap();
    assert!(common.link(exact(&travellers, address(0, 1), address(1, 2))));
    assert!(common.link(exact(&travellers, address(0, 3), address(1, 0))));
    let (fused, taken_back) = common.fuse_consistently(&FusionParams::default()).unwrap();
    assert_eq!((fused.len(), taken_back), (1, Vec::new()));
    // Alone it cannot join them, and that is what is said.
    assert_eq!(common.separate(AgentId(0), AgentId(1)), 2);
    assert!(common.link(exact(&travellers, address(0, 1), address(1, 2))));
    let (fused, taken_back) = common.fuse_consistently(&FusionParams::default()).unwrap();
    assert_eq!((fused.len(), taken_back.len()), (2, 1));
    assert!(taken_back[0].why.contains("depth"), "{taken_back:?}");
}

/// The way over the closures that are trusted more is taken, not the direct one.
#[test]
fn agents_are_placed_over_the_closures_trusted_most() {
    let [a, b, c] = [6, 7, 8].map(|seed| Traveller::new(seed, 4));
    let travellers = [&a, &b, &c];
    let mut common = common(&travellers);
    assert!(common.link(exact(&travellers, address(0, 1), address(1, 1))));
    assert!(common.link(exact(&travellers, address(1, 2), address(2, 2))));
    let mut vague = far_off(exact(&travellers, address(0, 0), address(2, 0)), 0.1);
    vague.from_from_to.information *= 1e-4;
    assert!(common.link(vague));
    let fused = fused(&common, false);
    assert_near(&fused.map, &travellers, 1e-6);
    assert_eq!((fused.component.tree.len(), fused.component.spare.len()), (2, 1));
}

#[test]
fn a_merge_undone_leaves_no_trace() {
    let [a, b, c] = [9, 10, 11].map(|seed| Traveller::new(seed, 4));
    let travellers = [&a, &b, &c];
    let mut common = common(&travellers);
    assert!(common.link(exact(&travellers, address(0, 1), address(1, 1))));
    let before = common.fuse(&FusionParams::default()).unwrap();
    assert!(common.link(exact(&travellers, address(2, 0), address(1, 3))));
    assert!(common.link(far_off(exact(&travellers, address(1, 2), address(2, 3)), 0.02)));
    assert_eq!(fused(&common, true).agents.len(), 3);
    assert_eq!(common.merged(), [(AgentId(0), AgentId(1)), (AgentId(1), AgentId(2))].into());

    assert_eq!(common.separate(AgentId(2), AgentId(1)), 2);
    let after = common.fuse(&FusionParams::default()).unwrap();
    assert!(before.iter().zip(&after).all(|(before, after)| before.map == after.map), "bit for bit");
    assert!(after[1].map == c.own_map(), "an agent alone has its own map");
    assert_eq!(common.separate(AgentId(0), AgentId(2)), 0);

    assert_eq!(common.separate(AgentId(0), AgentId(1)), 1);
    let apart = common.fuse(&FusionParams::default()).unwrap();
    assert!(apart.iter().zip(travellers).all(|(fused, of)| fused.map == of.own_map()));
    assert_eq!(apart.len(), 3);
}

#[test]
fn a_common_map_keeps_the_words_that_it_is_searched_by_and_own_maps_have_none() {
    let [a, b] = [30, 31].map(|seed| Traveller::new(seed, 5));
    let searched = |mut own: Map| {
        let bytes = |id: KeyframeId| Some(vec![id.0 as u8; 3].into());
        own.keyframes.values_mut().for_each(|keyframe| keyframe.words = bytes(keyframe.id));
        own
    };
    let maps = [searched(a.own_map()), searched(b.own_map())];
    let (mut together, _) = CommonMap::from_maps(&maps.each_ref()).unwrap();
    assert!(together.link(exact(&[&a, &b], address(0, 1), address(1, 1))));
    let map = fused(&together, true).map;
    assert!(map.split() == [a.own_map(), b.own_map()]);
    // Once more, as a file of it is read again.
    let (again, _) = CommonMap::from_maps(&[&map]).unwrap();
    let words = |map: &Map| map.keyframes.values().map(|keyframe| keyframe.words.clone()).collect::<Vec<_>>();
    let expected: Vec<_> = maps.iter().flat_map(words).collect();
    assert!(words(&map) == expected && words(&fused(&again, true).map) == expected);
    assert_eq!(together.separate(AgentId(0), AgentId(1)), 1);
    let apart = together.fuse(&FusionParams::default()).unwrap();
    assert!(apart[0].map == a.own_map() && apart[1].map == b.own_map());
}

#[test]
fn an_agent_that_went_on_brings_its_new_keyframes() {
    let (whole_a, whole_b) = (Traveller::new(12, 8), Traveller::new(13, 9));
    let (a, b) = (whole_a.first(4), whole_b.first(5));
    let mut common = common(&[&a, &b]);
    assert!(common.link(exact(&[&a, &b], address(0, 3), address(1, 2))));
    assert_near(&fused(&common, true).map, &[&a, &b], 1e-6);

    assert!(common.update(AgentId(1), whole_b.own_map()));
    assert_near(&fused(&common, true).map, &[&a, &whole_b], 1e-6);
    // Its world may be another by now: nothing of the earlier one is kept.
    let elsewhere = whole_a.in_another_world(99);
    assert!(common.update(AgentId(0), elsewhere.own_map()));
    let travellers = [&elsewhere, &whole_b];
    assert_near(&fused(&common, true).map, &travellers, 1e-6);
    assert!(common.link(exact(&travellers, address(0, 7), address(1, 8))), "new keyframes take part");
    assert_near(&fused(&common, true).map, &travellers, 1e-6);
    assert_eq!(common.links().len(), 2);
}

/// Closing a loop gives keyframes another unit; closures measured in the earlier one follow.
#[test]
fn closures_follow_the_units_of_their_keyframes() {
    let [a, b] = [40, 41].map(|seed| Traveller::new(seed, 5));
    let mut common = common(&[&a, &b]);
    assert!(common.link(exact(&[&a, &b], address(0, 1), address(1, 2))));
    assert!(common.link(exact(&[&a, &b], address(1, 4), address(0, 3))));
    let links = common.links().to_vec();
    assert!(common.update(AgentId(1), b.own_map()));
    assert_eq!(common.links(), links, "in the same units they stay as they are, bit for bit");

    let mut other = b.clone();
    let factors = [1.0, 1.0, 1.3, 1.0, 0.6];
    for (pose, factor) in other.truth_from_keyframe.iter_mut().zip(factors) {
        pose.scale *= factor;
    }
    assert!(common.update(AgentId(1), other.own_map()));
    assert_near(&fused(&common, false).map, &[&a, &other], 1e-5);
    assert_near(&fused(&common, true).map, &[&a, &other], 1e-5);
}

#[test]
fn closures_with_keyframes_that_are_gone_are_dropped() {
    let (a, whole_b) = (Traveller::new(14, 4), Traveller::new(15, 6));
    let mut common = common(&[&a, &whole_b]);
    assert!(common.link(exact(&[&a, &whole_b], address(0, 0), address(1, 5))));
    assert!(common.link(exact(&[&a, &whole_b], address(1, 1), address(0, 2))));
    let b = whole_b.first(3);
    assert!(common.update(AgentId(1), b.own_map()));
    assert_eq!(common.links().iter().map(|link| link.from).collect::<Vec<_>>(), [address(1, 1)]);
    assert_near(&fused(&common, true).map, &[&a, &b], 1e-6);
}

#[test]
fn only_the_map_of_one_agent_replaces_an_agents() {
    let [a, b, c] = [16, 17, 18].map(|seed| Traveller::new(seed, 3));
    let mut common = common(&[&a, &b]);
    assert!(!common.update(AgentId(5), c.own_map()), "there is no such agent");
    let both = Map::unite(vec![b.own_map(), c.own_map()]).unwrap();
    assert!(!common.update(AgentId(1), both), "two agents are not one");
    assert!(common.agents()[&AgentId(1)] == b.own_map());
    // Another agent's map in its place is found out when maps are made.
    assert!(common.update(AgentId(1), a.own_map()));
    common.link(exact(&[&a, &a], address(0, 1), address(1, 1)));
    let refusal = common.fuse(&FusionParams::default()).unwrap_err();
    assert!(matches!(refusal, FusionError::Map(MapError::SameMapTwice { .. })), "{refusal}");
}

#[test]
fn closures_without_their_keyframes_are_refused() {
    let [a, b] = [19, 20].map(|seed| Traveller::new(seed, 3));
    let mut common = common(&[&a, &b]);
    let good = exact(&[&a, &b], address(0, 0), address(1, 0));
    for (from, to) in [
        (address(0, 7), address(1, 0)),
        (address(0, 0), address(1, 7)),
        (address(0, 0), address(2, 0)),
        (address(1, 0), address(1, 1)),
    ] {
        assert!(!common.link(Link { from, to, ..good }));
    }
    assert!(common.links().is_empty());
    assert!(common.link(good));
}

/// A closure measured again takes the place of the earlier one: the same two images say nothing new.
#[test]
fn two_keyframes_have_one_closure() {
    let [a, b] = [21, 22].map(|seed| Traveller::new(seed, 3));
    let travellers = [&a, &b];
    let mut common = common(&travellers);
    let good = exact(&travellers, address(0, 1), address(1, 1));
    assert!(common.link(far_off(good, 0.3)));
    assert!(common.link(good.swapped()));
    assert_eq!(common.links(), [good.swapped()]);
    assert_near(&fused(&common, true).map, &travellers, 1e-6);
}

#[test]
fn a_common_map_is_merged_further() {
    let [a, b, c] = [23, 24, 25].map(|seed| Traveller::new(seed, 4));
    let mut earlier = common(&[&a, &b]);
    assert!(earlier.link(exact(&[&a, &b], address(0, 1), address(1, 2))));
    assert!(earlier.link(exact(&[&a, &b], address(1, 3), address(0, 3))));
    let two = fused(&earlier, true).map;

    let (mut common, addresses) = CommonMap::from_maps(&[&c.own_map(), &two]).unwrap();
    assert_eq!(addresses[0].agents().collect::<Vec<_>>(), [AgentId(0)]);
    assert_eq!(addresses[1].agents().collect::<Vec<_>>(), [AgentId(1), AgentId(2)]);
    assert!(common.agents().values().zip([&c, &a, &b]).all(|(own, of)| *own == of.own_map()));
    // In the united map b's keyframes come after the four of a.
    assert_eq!(addresses[1].of(AgentId(1), KeyframeId(4 + 2)), Some(address(2, 2)));
    assert_eq!(addresses[1].of(AgentId(1), KeyframeId(2)), None, "this one is not b's");
    assert_eq!(addresses[1].of(AgentId(2), KeyframeId(2)), None, "there were only two");
    let travellers = [&c, &a, &b];
    let carried =
        [exact(&travellers, address(1, 1), address(2, 2)), exact(&travellers, address(2, 3), address(1, 3))];
    assert_eq!(common.links(), carried);
    assert!(common.link(exact(&travellers, address(0, 0), address(2, 0))));
    assert_near(&fused(&common, true).map, &travellers, 1e-6);
}

/// Closures at both ends of a map that drifts pull it straight; placed as a whole it stays bent.
#[test]
fn closures_at_both_ends_take_the_drift_out() {
    let (a, b) = (Traveller::new(26, 12), Traveller::new(27, 12));
    let maps = [a.own_map(), b.drifted_map(0.02)];
    let (mut common, _) = CommonMap::from_maps(&maps.each_ref()).unwrap();
    for k in [0, 1, 10, 11] {
        assert!(common.link(exact(&[&a, &b], address(0, k), address(1, k))));
    }
    let (bent, straight) = (fused(&common, false), fused(&common, true));
    let (bent, straight) = (agents::worst(&bent.map, &[&a, &b]), agents::worst(&straight.map, &[&a, &b]));
    assert!(bent > 0.2 && straight < 0.1 * bent, "{bent} {straight}");
}

/// The map of a traveller with a LiDAR: exact, in metres, and it sees as far as the cameras do.
fn lidar_map(lidar: &Traveller) -> Map {
    let mut map = lidar.own_map();
    map.agents.values_mut().for_each(|info| info.sensor = Sensor::Lidar);
    for keyframe in map.keyframes.values_mut() {
        keyframe.image = Arc::new(GrayImage::filled(0, 0, 0));
        keyframe.semi_dense = Default::default();
        keyframe.scan = Some(Arc::new(Scan::new([[5.0, 0.0, 0.0], [0.0, -5.0, 0.0], [3.0, 0.0, 4.0]])));
    }
    map
}

/// Maps in metres and without: a camera's, whose scale runs away, is held by the LiDAR's beside it, and a second LiDAR that
/// is known over the camera alone stays in metres.
#[test]
fn known_and_unknown_scales_come_together_in_metres() {
    let [lidar, camera, other] = [Traveller::new(1, 12), Traveller::new(2, 12), Traveller::new(3, 12)];
    let (lidar, other) = (lidar.in_metres(), other.in_metres());
    let maps = [lidar_map(&lidar), camera.drifted_map(0.02), lidar_map(&other)];
    let (mut common, _) = CommonMap::from_maps(&maps.iter().collect::<Vec<_>>()).unwrap();
    let all = [&lidar, &camera, &other];
    for number in [0, 3, 6, 9, 11] {
        let address = |agent| Address { agent: AgentId(agent), keyframe: KeyframeId(number) };
        for ends in [[0, 1], [1, 2]] {
            assert!(common.link(exact(&all, address(ends[0]), address(ends[1]))));
        }
    }
    let (fused, taken_back) = common.fuse_consistently(&FusionParams::default()).unwrap();
    let [one] = &fused[..] else { panic!("all hang together") };
    assert!(taken_back.is_empty() && one.suppressed.is_empty(), "{taken_back:?} {:?}", one.suppressed);
    assert!(one.map.is_metric());
    for keyframe in one.map.keyframes.values().filter(|keyframe| keyframe.scan.is_some()) {
        assert_eq!(keyframe.world_from_keyframe.scale, 1.0, "metres are metres");
    }
    assert_eq!(one.component.agents[&AgentId(2)].root_from_agent.scale, 1.0);
    assert_near(&one.map, &all, 0.03);
    assert_eq!(one.map.split(), maps, "a merge can be undone");
}
