use super::*;
use crate::test_support::Numbers;
use nalgebra::SVector;
use proptest::prelude::*;

const A: AgentId = AgentId(0);
const B: AgentId = AgentId(1);
const C: AgentId = AgentId(2);

/// `common_from_agent` of as many agents, each with a world and a unit of its own.
fn worlds(count: u16, seed: u64) -> BTreeMap<AgentId, Sim3> {
    let numbers = &mut Numbers::new(seed);
    let mut world =
        || Sim3::new(numbers.rotation(1.5), numbers.vector(10.0), numbers.uniform(-1.0, 1.0).exp());
    (0..count).map(|agent| (AgentId(agent), world())).collect()
}

fn graph(worlds: &BTreeMap<AgentId, Sim3>) -> MergeGraph {
    let mut graph = MergeGraph::new();
    assert!(worlds.keys().all(|agent| graph.add_agent(*agent)));
    graph
}

fn merge(worlds: &BTreeMap<AgentId, Sim3>, from: AgentId, to: AgentId, confidence: f64) -> Merge {
    let a_from_b = worlds[&from].inverse() * worlds[&to];
    Merge {
        from,
        to,
        from_from_to: Estimate { a_from_b, information: SMatrix::identity() * 1e4 },
        confidence,
    }
}

fn is_near(a: &Sim3, b: &Sim3) -> bool {
    (*a * b.inverse()).log().norm() < 1e-9
}

#[test]
fn an_agent_between_links_two_that_never_met() {
    let worlds = worlds(3, 1);
    let mut graph = graph(&worlds);
    // B met A, A met C; whichever way round the merges were made.
    let with_b = graph.add_merge(merge(&worlds, B, A, 2.0)).unwrap();
    let with_c = graph.add_merge(merge(&worlds, A, C, 1.0)).unwrap();
    let [component] = &graph.components()[..] else { panic!("all hang together") };
    assert_eq!((component.root, &component.tree, component.spare.len()), (A, &vec![with_b, with_c], 0));
    for (agent, place) in &component.agents {
        assert!(is_near(&place.root_from_agent, &(worlds[&A].inverse() * worlds[agent])), "{agent:?}");
    }
    // A point that B and C both saw lies in one place.
    let point = Vector3::new(1.0, -2.0, 3.0);
    let by = |agent| component.agents[&agent].root_from_agent * (worlds[&agent].inverse() * point);
    assert!((by(B) - by(C)).norm() < 1e-9);
    assert_eq!(component.agents[&B].path, [with_b]);
    assert_eq!(component.agents[&C].confidence, 1.0);
    assert_eq!(component.agents[&A].confidence, f64::INFINITY);
}

#[test]
fn the_best_two_of_three_merges_make_the_tree() {
    let worlds = worlds(3, 2);
    for (weakest, path_of_c) in [(0, 1), (1, 2), (2, 1)] {
        let mut graph = graph(&worlds);
        let pairs = [(A, B), (A, C), (C, B)];
        let ids: Vec<MergeId> = pairs
            .iter()
            .enumerate()
            .map(|(i, (from, to))| {
                let mut merge = merge(&worlds, *from, *to, if i == weakest { 1.0 } else { 2.0 + i as f64 });
                if i == weakest {
                    merge.from_from_to.a_from_b.scale *= 1.5;
                }
                graph.add_merge(merge).unwrap()
            })
            .collect();
        let [component] = &graph.components()[..] else { panic!("all hang together") };
        assert_eq!(component.spare, [ids[weakest]]);
        assert_eq!(component.agents[&C].path.len(), path_of_c);
        let right = |(agent, place): (&AgentId, &Placement)| {
            is_near(&place.root_from_agent, &(worlds[&A].inverse() * worlds[agent]))
        };
        assert!(component.agents.iter().all(right), "the weakest merge, which is wrong, has no say");
    }
}

#[test]
fn what_nothing_joins_stays_apart() {
    let worlds = worlds(5, 4);
    let mut graph = graph(&worlds);
    graph.add_merge(merge(&worlds, AgentId(3), B, 1.0)).unwrap();
    graph.add_merge(merge(&worlds, AgentId(4), C, 1.0)).unwrap();
    let components = graph.components();
    let members: Vec<Vec<u16>> = components.iter().map(|c| c.agents.keys().map(|a| a.0).collect()).collect();
    assert_eq!(members, [vec![0], vec![1, 3], vec![2, 4]]);
    assert_eq!(components.iter().map(|c| c.root).collect::<Vec<_>>(), [A, B, C]);
    let place = &components[1].agents[&AgentId(3)].root_from_agent;
    assert!(is_near(place, &(worlds[&B].inverse() * worlds[&AgentId(3)])));
    assert!(MergeGraph::new().components().is_empty());
}

#[test]
fn covariance_grows_along_the_chain_as_samples_do() {
    let worlds = worlds(3, 5);
    let mut graph = graph(&worlds);
    // B is reached against the direction of its merge.
    for merge in [merge(&worlds, B, A, 1.0), merge(&worlds, B, C, 1.0)] {
        graph.add_merge(merge).unwrap();
    }
    let component = &graph.components()[0];
    let chained = &component.agents[&C];
    let numbers = &mut Numbers::new(6);
    let sigma = 1e-2;
    let mut sampled = SMatrix::<f64, 7, 7>::zeros();
    let count = 20_000;
    for _ in 0..count {
        let mut disturb = || Sim3::exp(&SVector::<f64, 7>::from_fn(|_, _| 1e-2 * sigma * numbers.normal()));
        let a_from_b = (disturb() * worlds[&B].inverse() * worlds[&A]).inverse();
        let b_from_c = disturb() * worlds[&B].inverse() * worlds[&C];
        let error = (a_from_b * b_from_c * chained.root_from_agent.inverse()).log() * 1e2;
        sampled += error * error.transpose() / count as f64;
    }
    let difference = (sampled - chained.covariance).norm() / sampled.norm();
    assert!(difference < 0.05, "{difference}");
    assert_eq!(component.agents[&A].covariance, SMatrix::<f64, 7, 7>::zeros());
    assert!(chained.covariance.trace() > component.agents[&B].covariance.trace());
}

#[test]
fn of_equal_merges_the_first_pair_and_then_the_first_added_is_taken() {
    let worlds = worlds(3, 7);
    let tree = |order: [(AgentId, AgentId); 4]| {
        let mut graph = graph(&worlds);
        let pair = |id: &MergeId, graph: &MergeGraph| {
            let merge = graph.merges().find(|(other, _)| other == id).unwrap().1.clone();
            (merge.from.min(merge.to), merge.from.max(merge.to))
        };
        for (from, to) in order {
            graph.add_merge(merge(&worlds, from, to, 1.0)).unwrap();
        }
        let component = graph.components().remove(0);
        let mut pairs: Vec<_> = component.tree.iter().map(|id| pair(id, &graph)).collect();
        pairs.sort();
        (pairs, component.tree)
    };
    let (pairs, ids) = tree([(B, C), (C, A), (B, A), (A, B)]);
    assert_eq!((pairs, ids), (vec![(A, B), (A, C)], vec![MergeId(1), MergeId(2)]));
    let (pairs, ids) = tree([(A, B), (B, A), (C, B), (A, C)]);
    assert_eq!((pairs, ids), (vec![(A, B), (A, C)], vec![MergeId(0), MergeId(3)]));
}

#[test]
fn bad_merges_are_refused() {
    let worlds = worlds(2, 8);
    let good = || merge(&worlds, A, B, 1.0);
    let with = |from_from_to: Estimate| Merge { from_from_to, ..good() };
    let estimate = good().from_from_to;
    let mut graph = graph(&worlds);
    let mut refuse = |merge: Merge| graph.add_merge(merge).unwrap_err();
    assert_eq!(refuse(Merge { to: C, ..good() }), MergeGraphError::UnknownAgent(C));
    assert_eq!(refuse(Merge { to: A, ..good() }), MergeGraphError::SameAgent(A));
    let nowhere = Sim3 { scale: -1.0, ..Sim3::identity() };
    let invalid = MergeGraphError::InvalidSimilarity { from: A, to: B };
    assert_eq!(refuse(with(Estimate { a_from_b: nowhere, ..estimate })), invalid);
    for spoil in [0.0, -1.0, f64::NAN] {
        let mut information = estimate.information;
        information[(6, 6)] = spoil;
        let error = refuse(with(Estimate { information, ..estimate }));
        assert_eq!(error, MergeGraphError::InvalidInformation { from: A, to: B });
    }
    for confidence in [0.0, f64::INFINITY, f64::NAN] {
        assert!(matches!(refuse(Merge { confidence, ..good() }), MergeGraphError::InvalidConfidence { .. }));
    }
    assert_eq!(graph.merges().count(), 0);
}

#[test]
fn confidence_tells_how_far_points_are_misplaced_whatever_the_unit() {
    let centre = Vector3::new(30.0, -5.0, 10.0);
    // Known about its centre to 1 % of the extent, 0.01 rad and 1 %, in each axis.
    let extent = 4.0;
    let shift = 0.01 * extent;
    let sigma = SVector::<f64, 7>::from([shift, shift, shift, 0.01, 0.01, 0.01, 0.01]);
    let about_centre = Estimate {
        a_from_b: Sim3::identity(),
        information: SMatrix::from_diagonal(&sigma.map(|sigma| 1.0 / (sigma * sigma))),
    };
    let to_world = Sim3::new(UnitQuaternion::identity(), centre, 1.0);
    let estimate = about_centre.carried(&to_world, &Sim3::identity()).unwrap();
    let found = confidence(&estimate, &centre, extent).unwrap();
    assert!((found - 1.0 / (0.01 * 6f64.sqrt())).abs() < 1e-6, "{found}");
    // The same world in a unit three times as small.
    let unit = Sim3 { scale: 3.0, ..Sim3::identity() };
    let scaled = estimate.carried(&unit, &Sim3::identity()).unwrap();
    assert!((confidence(&scaled, &(centre * 3.0), extent * 3.0).unwrap() - found).abs() < 1e-6);
    assert_eq!(confidence(&Estimate { information: SMatrix::zeros(), ..estimate }, &centre, extent), None);
}

/// The largest sum of confidences of a spanning forest, over all subsets of the merges.
fn brute_force(agents: usize, merges: &[(usize, usize, u32)]) -> (usize, u32) {
    (0..1u32 << merges.len())
        .filter_map(|set| {
            let mut group: Vec<usize> = (0..agents).collect();
            let (mut count, mut sum) = (0, 0);
            for (_, &(from, to, weight)) in merges.iter().enumerate().filter(|(i, _)| set >> i & 1 == 1) {
                let (one, other) = (group[from], group[to]);
                if one == other {
                    return None;
                }
                group.iter_mut().filter(|name| **name == other).for_each(|name| *name = one);
                count += 1;
                sum += weight;
            }
            Some((count, sum))
        })
        .max()
        .unwrap_or_default()
}

proptest! {
    #[test]
    fn no_forest_that_joins_as_much_is_trusted_more(
        count in 1usize..6, drawn in prop::collection::vec((0usize..6, 0usize..6, 1u32..5), 0..9), seed in 0u64..1000,
    ) {
        let worlds = worlds(count as u16, seed);
        let merges: Vec<_> =
            drawn.into_iter().map(|(f, t, w)| (f % count, t % count, w)).filter(|(f, t, _)| f != t).collect();
        let mut graph = graph(&worlds);
        for &(from, to, weight) in &merges {
            let merge = merge(&worlds, AgentId(from as u16), AgentId(to as u16), f64::from(weight));
            graph.add_merge(merge).unwrap();
        }
        let components = graph.components();
        let tree: Vec<MergeId> = components.iter().flat_map(|c| c.tree.clone()).collect();
        let trusted = tree.iter().map(|id| merges[id.0 as usize].2).sum::<u32>();
        prop_assert_eq!((tree.len(), trusted), brute_force(count, &merges));
        let spare: usize = components.iter().map(|c| c.spare.len()).sum();
        prop_assert_eq!(spare + tree.len(), merges.len());
        prop_assert_eq!(components.iter().map(|c| c.agents.len()).sum::<usize>(), count);
        for component in &components {
            prop_assert_eq!(component.tree.len() + 1, component.agents.len());
            for (agent, place) in &component.agents {
                let truth = worlds[&component.root].inverse() * worlds[agent];
                prop_assert!(is_near(&place.root_from_agent, &truth));
                prop_assert!(place.path.iter().all(|id| component.tree.contains(id)));
            }
        }
    }
}
