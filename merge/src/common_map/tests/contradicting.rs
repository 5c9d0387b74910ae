//! Closures that are wrong: which are not believed, and which merges are taken back.

use super::*;

#[test]
fn a_wrong_closure_loses_its_pull_and_is_named() {
    let (a, b) = (Traveller::new(28, 8), Traveller::new(29, 8));
    let travellers = [&a, &b];
    for size in [0.5, 3.0] {
        let mut common = common(&travellers);
        let wrong = far_off(exact(&travellers, address(0, 5), address(1, 2)), size);
        for link in [0, 2, 4, 6].map(|k| exact(&travellers, address(0, k), address(1, k))) {
            assert!(common.link(link));
        }
        assert!(common.link(wrong));
        let fused = fused(&common, true);
        assert_eq!(fused.suppressed, [wrong]);
        assert_near(&fused.map, &travellers, 1e-3);
    }
}

#[test]
fn a_closure_that_is_no_number_is_named() {
    let [a, b] = [30, 31].map(|seed| Traveller::new(seed, 3));
    let mut common = common(&[&a, &b]);
    let mut link = exact(&[&a, &b], address(0, 0), address(1, 0));
    link.from_from_to.a_from_b.scale = f64::NAN;
    assert!(common.link(link));
    let refusal = common.fuse(&FusionParams::default()).unwrap_err().to_string();
    assert!(refusal.contains("agents 0 and 1"), "{refusal}");
}

/// Two closures that contradict each other, and nothing that says which is right: neither is believed, whatever their
/// keyframes are called.
#[test]
fn of_two_closures_that_contradict_neither_is_believed() {
    let [a, b, c] = [50, 51, 52].map(|seed| Traveller::new(seed, 6));
    let travellers = [&a, &b, &c];
    for (good, bad) in [(0, 4), (4, 0)] {
        let mut common = common(&travellers);
        assert!(common.link(exact(&travellers, address(0, good), address(1, good))));
        assert!(common.link(far_off(exact(&travellers, address(0, bad), address(1, bad)), 3.0)));
        assert!(common.link(exact(&travellers, address(1, 2), address(2, 2))));
        assert_eq!(common.fuse(&FusionParams::default()).unwrap().len(), 2, "a is apart");
        let (all, taken_back) = common.fuse_consistently(&FusionParams::default()).unwrap();
        assert_eq!(all.len(), 2);
        let agents: Vec<_> = taken_back.iter().map(|taken| taken.agents).collect();
        assert_eq!(agents, [(AgentId(0), AgentId(1))], "{taken_back:?}");
    }
}

/// What is wrong between two agents is named and taken back; the others stay merged.
#[test]
fn a_broken_merge_does_not_end_the_others() {
    let [a, b, c] = [53, 54, 55].map(|seed| Traveller::new(seed, 4));
    let travellers = [&a, &b, &c];
    let mut common = common(&travellers);
    let mut broken = exact(&travellers, address(0, 0), address(1, 0));
    broken.from_from_to.a_from_b.scale = f64::NAN;
    assert!(common.link(broken));
    assert!(common.link(exact(&travellers, address(1, 1), address(2, 1))));
    let (all, taken_back) = common.fuse_consistently(&FusionParams::default()).unwrap();
    assert_eq!(all.iter().map(|fused| fused.agents.len()).collect::<Vec<_>>(), [1, 2]);
    assert_eq!(taken_back[0].agents, (AgentId(0), AgentId(1)));
    assert_eq!(common.merged(), [(AgentId(1), AgentId(2))].into());
}

/// Over a third agent, by merges trusted more, two agents stand to each other otherwise than by their own merge.
#[test]
fn a_merge_that_contradicts_those_over_a_third_agent_is_taken_back() {
    let [a, b, c] = [56, 57, 58].map(|seed| Traveller::new(seed, 4));
    let travellers = [&a, &b, &c];
    for (wrong, left) in [(3.0, 2), (1e-4, 3)] {
        let mut common = common(&travellers);
        for k in [0, 2] {
            assert!(common.link(exact(&travellers, address(0, k), address(1, k))));
            assert!(common.link(exact(&travellers, address(1, k), address(2, k))));
        }
        let mut third = far_off(exact(&travellers, address(0, 1), address(2, 1)), wrong);
        third.from_from_to.information *= 1e-2;
        assert!(common.link(third));
        let (all, taken_back) = common.fuse_consistently(&FusionParams::default()).unwrap();
        assert_eq!((all.len(), common.merged().len()), (1, left), "{taken_back:?}");
        assert_near(&all[0].map, &travellers, 1e-2);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    /// Neither the order in which closures come nor the side they are told from matters.
    #[test]
    fn the_order_of_closures_does_not_matter(
        order in Just((0..9).collect::<Vec<usize>>()).prop_shuffle(),
        swap in prop::collection::vec(any::<bool>(), 9),
        seed in 0u64..1000,
    ) {
        let numbers = &mut Numbers::new(seed);
        let of: Vec<Traveller> = (0..4).map(|k| Traveller::new(4 * seed + k, 5)).collect();
        let travellers: Vec<&Traveller> = of.iter().collect();
        let pairs = [(0, 1), (0, 1), (1, 2), (1, 2), (2, 3), (3, 2), (0, 3), (0, 2), (3, 1)];
        let (mut next, apart) = (0, numbers.uniform(0.0, 5.0) as u32);
        let links = pairs.map(|(i, j)| {
            // No two closures are of the same two keyframes.
            next = (next + 1) % 5;
            let (from, to) = (address(i, next), address(j, (next + apart) % 5));
            far_off(exact(&travellers, from, to), numbers.uniform(0.0, 2e-3))
        });
        let mut plain = common(&travellers);
        let mut mixed = plain.clone();
        links.iter().for_each(|link| assert!(plain.link(*link)));
        for k in order {
            let link = if swap[k] { links[k].swapped() } else { links[k] };
            prop_assert!(mixed.link(link));
        }
        prop_assert_eq!(plain.links().len(), links.len());
        for optimise in [false, true] {
            let (plain, mixed) = (fused(&plain, optimise), fused(&mixed, optimise));
            for (id, keyframe) in &plain.map.keyframes {
                let other = mixed.map.keyframes[id].world_from_keyframe;
                let apart = (keyframe.world_from_keyframe.inverse() * other).log().norm();
                prop_assert!(apart < if optimise { 1e-3 } else { 1e-8 }, "{id:?}: {apart}");
            }
        }
    }
}
