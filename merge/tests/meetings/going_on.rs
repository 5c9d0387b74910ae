//! Agents that merge their maps on the way and go on.

use crate::merging::{first_and_second, fused, link, merged, on_the_way};
use crate::yard::{Drive, assert_near_truth, first, second};
use map::{AgentId, Edge, EdgeKind, Map};
use merge::common_map::{CommonMap, Fused, Link};

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
    let (mut common, addresses) = merged(&[&a.early, &b.early], &[([0, 1], on_the_way())]);
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
fn one_agent_goes_on_alone() {
    let (a, b) = (first(), second());
    let (mut common, _) = merged(&[&a.early, &b.early], &[([0, 1], on_the_way())]);
    assert!(common.update(AgentId(1), b.end.clone()));
    let fused = fused(&common);
    assert_holds(&fused, &[&a.early, &b.end]);
    assert_near_truth(&fused.map, &[a, b], 0.005);
}
