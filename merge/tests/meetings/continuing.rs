//! Agents that merge their maps on the way and go on.

use crate::merging::{
    PairResult, features, first_and_second, fused, halfway, link, merged, pair_result, reasons,
};
use crate::yard::{Drive, assert_near_truth, first, second};
use geometry::GrayImage;
use map::{AgentId, Edge, EdgeKind, KeyframeId, Map};
use merge::acceptance::AcceptanceParams;
use merge::common_map::{CommonMap, Fused, Link};
use merge::further::FurtherParams;
use merge::key_points::KeyPointParams;
use merge::prepared::PreparedMap;
use merge::verification::{EvaluatedClosure, follow_on};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Every keyframe of the agents' own maps is in the common map, under the id that its agent's first one and its own
/// give, and the own maps come out of it as they went in.
fn assert_holds(fused: &Fused, own: &[&Map]) {
    assert_eq!(fused.map.keyframes.len(), own.iter().map(|map| map.keyframes.len()).sum::<usize>());
    for (agent, own) in fused.map.agents.keys().zip(own) {
        let first = fused.map.agents[agent].own.as_ref().expect("a united map").first_keyframe;
        for (id, keyframe) in &own.keyframes {
            let united = &fused.map.keyframes[&map::KeyframeId(first + id.0)];
            assert_eq!((united.agent, united.frame_index), (*agent, keyframe.frame_index));
        }
    }
    let split = fused.map.split();
    assert!(split.iter().zip(own).all(|(split, own)| split == *own), "the own maps come out as they were");
}

/// The common map's edges between agents are its links.
fn assert_links_are_edges(fused: &Fused, common: &CommonMap) {
    let between: Vec<&Edge> = fused.map.edges.iter().filter(|edge| edge.kind == EdgeKind::Merge).collect();
    assert_eq!(between.len(), common.links().len());
    for (edge, link) in between.iter().zip(common.links()) {
        let agent = |id| fused.map.keyframes[id].agent;
        assert_eq!((agent(&edge.from), agent(&edge.to)), (link.from.agent, link.to.agent));
        assert_eq!(edge.from_from_to, link.from_from_to.a_from_b);
    }
}

#[test]
fn both_agents_go_on_after_a_merge() {
    let (a, b) = (first(), second());
    let drives: [&Drive; 2] = [a, b];
    let (mut common, addresses) = merged(&[&a.early, &b.early], &[([0, 1], halfway())]);
    let early = fused(&common);
    assert_holds(&early, &[&a.early, &b.early]);
    assert_near_truth(&early.map, &drives, 0.005);
    let links = common.links().to_vec();

    // Both go on; nothing is looked for again.
    assert!(common.update(AgentId(0), a.end.clone()) && common.update(AgentId(1), b.end.clone()));
    let ends = |links: &[Link]| links.iter().map(|link| (link.from, link.to)).collect::<Vec<_>>();
    assert_eq!(ends(common.links()), ends(&links), "the closures stay");
    let at_end = fused(&common);
    assert_holds(&at_end, &[&a.end, &b.end]);
    assert_links_are_edges(&at_end, &common);
    assert!(at_end.suppressed.is_empty(), "{:?}", at_end.suppressed);
    assert_near_truth(&at_end.map, &drives, 0.005);

    // They meet again.
    assert!(link(&mut common, [&addresses[0], &addresses[1]], first_and_second()) >= 2);
    assert!(common.links().len() > links.len(), "{} and {} closures", links.len(), common.links().len());
    let later = |l: &Link| !a.early.keyframes.contains_key(&l.from.keyframe);
    assert!(common.links().iter().any(later), "new keyframes take part");
    let last = fused(&common);
    assert_links_are_edges(&last, &common);
    assert_near_truth(&last.map, &drives, 0.005);
}

#[test]
fn one_agent_continues_alone() {
    let (a, b) = (first(), second());
    let (mut common, _) = merged(&[&a.early, &b.early], &[([0, 1], halfway())]);
    assert!(common.update(AgentId(1), b.end.clone()));
    let fused = fused(&common);
    assert_holds(&fused, &[&a.early, &b.end]);
    assert_near_truth(&fused.map, &[a, b], 0.005);
}

/// A map as it was when it had so many keyframes.
fn part(map: &Map, keyframes: usize) -> Map {
    let mut part = map.clone();
    part.keyframes =
        map.keyframes.iter().take(keyframes).map(|(id, keyframe)| (*id, keyframe.clone())).collect();
    part.drop_dangling();
    part
}

/// What becomes of a merge of parts of the `target` and the `source` once they are these.
fn followed(
    before: &EvaluatedClosure,
    parts: [&Map; 2],
    [target, source]: [&Map; 2],
) -> Option<EvaluatedClosure> {
    let fresh = |part: &Map, map: &Map| -> BTreeSet<KeyframeId> {
        map.keyframes.keys().copied().filter(|id| !part.keyframes.contains_key(id)).collect()
    };
    let (of_target, of_source) = (fresh(parts[0], target), fresh(parts[1], source));
    let (target_features, source_features) = (features(target), features(source));
    let key_points = KeyPointParams::default();
    let source = PreparedMap::new(source, &source_features, &key_points);
    let target = PreparedMap::new(target, &target_features, &key_points);
    let (acceptance, further) = (AcceptanceParams::default(), FurtherParams::default());
    follow_on(&source, &target, before, [&of_source, &of_target], &acceptance, &further)
}

#[test]
fn a_merge_is_followed_on_by_the_keyframes_that_are_new() {
    let (a, b) = (&first().end, &second().end);
    let parts = [part(a, a.keyframes.len() - 2), part(b, b.keyframes.len() - 1)];
    let met = pair_result(&parts[0], &parts[1]);
    let evaluated = met.tested.iter().find_map(|tested| tested.outcome.accepted());
    let before = evaluated.unwrap_or_else(|| panic!("{:?}", reasons(&met)));
    let of_before = before.joined.as_ref().unwrap();
    let [of_a, of_b] = parts.each_ref();

    // Nothing is new: it is what it was.
    let same = followed(before, [of_a, of_b], [of_a, of_b]).expect("nothing changed");
    assert_eq!((&same.verdict, &same.closure.at_keyframes), (&before.verdict, &before.closure.at_keyframes));
    assert_eq!(same.joined.as_ref().unwrap().edges, of_before.edges);

    // Both went on, and the source's world was moved meanwhile.
    let mut moved = b.clone();
    let elsewhere = geometry::Sim3::exp(&nalgebra::SVector::from([0.3, -2.0, 1.0, 0.2, 0.5, -0.1, 0.4]));
    moved.transform(&elsewhere);
    let after = followed(before, [of_a, of_b], [a, &moved]).expect("what is new agrees");
    let joined = after.joined.clone().unwrap();
    let tested = joined.tested - of_before.tested;
    assert!((1..=3).contains(&tested), "of three new keyframes {tested} pairs were tried");
    assert!(of_before.edges.iter().all(|edge| joined.edges.contains(edge)), "what was known stays");
    let is_new =
        |edge: &Edge| !of_a.keyframes.contains_key(&edge.from) || !of_b.keyframes.contains_key(&edge.to);
    assert!(joined.edges.iter().any(is_new), "{:?}", joined.edges.len());
    let there = before.closure.motion.a_from_b * elsewhere.inverse();
    assert!((there * after.closure.motion.a_from_b.inverse()).log().amax() < 0.02);
    let (mut common, addresses) = CommonMap::from_maps(&[a, &moved]).unwrap();
    let met = PairResult { tested: Vec::new(), joined: Some(joined) };
    assert!(link(&mut common, [&addresses[0], &addresses[1]], &met) > of_before.edges.len());
    assert_near_truth(&fused(&common).map, &[first(), second()], 0.005);
}

#[test]
fn a_merge_that_what_is_new_contradicts_is_looked_at_anew() {
    let (a, b) = (&first().end, &second().end);
    let parts = [part(a, 4), part(b, 4)];
    let met = pair_result(&parts[0], &parts[1]);
    let evaluated = met.tested.iter().find_map(|tested| tested.outcome.accepted());
    let before = evaluated.unwrap_or_else(|| panic!("{:?}", reasons(&met)));
    let parts = [&parts[0], &parts[1]];
    assert!(followed(before, parts, [a, b]).is_some());
    // What comes is of another place.
    let mut strange = b.clone();
    for (_, keyframe) in strange.keyframes.iter_mut().filter(|(id, _)| !parts[1].keyframes.contains_key(id)) {
        let image = &keyframe.image;
        let turned = image.data().iter().rev().map(|value| 255 - value).collect();
        keyframe.image = Arc::new(GrayImage::from_vec(image.width(), image.height(), turned).unwrap());
    }
    assert!(followed(before, parts, [parts[0], &strange]).is_none());
    // A keyframe that was aligned is gone.
    let mut less = b.clone();
    less.keyframes.remove(&before.joined.as_ref().unwrap().edges[0].to);
    less.drop_dangling();
    assert!(followed(before, parts, [a, &less]).is_none());
}
