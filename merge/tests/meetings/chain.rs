//! More than two agents, and the opposite way of travel.

use crate::merging::{first_and_opposite, first_and_second, fused, merged, pair_result, second_and_first};
use crate::yard::{assert_near_truth, first, opposite, second};
use map::AgentId;
use merge::acceptance::Evidence;
use merge::common_map::FusionParams;
use merge::pairing::Travel;

#[test]
fn opposite_directions_of_travel_are_recognised_and_merged() {
    let (a, c) = (first(), opposite());
    let met = first_and_opposite();
    assert_eq!(met.closure().map(|closure| closure.travel), Some(Travel::Opposite));
    let (common, _) = merged(&[&a.end, &c.end], &[([0, 1], met)]);
    assert_near_truth(&fused(&common).map, &[a, c], 0.02);
}

#[test]
fn the_same_direction_of_travel_is_recognised() {
    let met = first_and_second();
    assert_eq!(met.closure().map(|closure| closure.travel), Some(Travel::Same));
}

/// A motion that pairs along both maps agree on is known better than its first closure says.
#[test]
fn further_pairs_that_agree_say_how_well_the_motion_is_known() {
    let met = first_and_second();
    let found = met.tested.iter().find_map(|tested| tested.outcome.accepted()).expect("they meet");
    let beyond = found.verdict.evidence.beyond.expect("both maps were asked");
    assert!(beyond.confirmed > 0, "{beyond:?}");
    let deviations = |e: &Evidence| [e.rotation_deviation, e.translation_deviation, e.scale_deviation];
    let alone = deviations(&Evidence::new(&found.closure, None));
    let together = deviations(&found.verdict.evidence);
    assert!(alone.iter().zip(&together).all(|(a, t)| t < a && *t > 0.0), "{alone:?} {together:?}");
}

/// b – a – c, where b and c are never compared.
#[test]
fn an_agent_that_met_both_connects_two_that_never_met() {
    let (a, b, c) = (first(), second(), opposite());
    let (mut common, addresses) =
        merged(&[&b.end, &a.end, &c.end], &[([0, 1], second_and_first()), ([1, 2], first_and_opposite())]);
    let together = fused(&common);
    let [of_b, of_a, of_c] = [0, 1, 2].map(|number: usize| addresses[number].agents().next().unwrap());
    assert_eq!(together.agents, [of_b, of_a, of_c]);
    assert_eq!(together.component.agents[&of_c].path.len(), 2, "c is reached through a");
    assert!(!common.merged().contains(&(of_b, of_c)));
    assert_near_truth(&together.map, &[b, a, c], 0.02);

    // Without the one in the middle they fall apart again.
    assert!(common.separate(of_a, of_c) >= 2);
    let apart = common.fuse(&FusionParams::default()).unwrap();
    assert_eq!(apart.iter().map(|f| f.agents.clone()).collect::<Vec<_>>(), [vec![of_b, of_a], vec![of_c]]);
    assert!(apart[1].map == c.end, "the agent alone has its own map, bit for bit");
    assert_eq!(apart[0].map.agents.keys().copied().collect::<Vec<_>>(), [AgentId(0), AgentId(1)]);
}

/// A common map is a map like any other: a third agent joins it later.
#[test]
fn a_common_map_merges_further() {
    let (a, b, c) = (first(), second(), opposite());
    let (common, _) = merged(&[&b.end, &a.end], &[([0, 1], second_and_first())]);
    let two = fused(&common).map;
    let links = common.links().len();
    let met = pair_result(&two, &c.end);
    let (mut common, addresses) =
        merge::common_map::CommonMap::from_maps(&[&two, &c.end]).expect("they go together");
    assert_eq!(common.links().len(), links, "the closures of the common map are taken over");
    let joined = met.joined.as_ref().expect("c met the others");
    for edge in &joined.edges {
        let agent = two.keyframes[&edge.from].agent;
        let added = common.link(merge::common_map::Link {
            from: addresses[0].of(agent, edge.from).expect("a keyframe of the common map"),
            to: addresses[1].of(AgentId(0), edge.to).expect("a keyframe of c"),
            from_from_to: merge::estimate::Estimate {
                a_from_b: edge.from_from_to,
                information: edge.information,
            },
        });
        assert!(added);
    }
    let three = fused(&common);
    assert_near_truth(&three.map, &[b, a, c], 0.02);
}
