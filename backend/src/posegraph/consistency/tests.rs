use super::*;
use crate::posegraph::tests::two_maps::{TwoMaps, Wrong};
use map::EdgeKind;

#[test]
fn the_right_half_is_selected() {
    for seed in 0..10 {
        for (wrong, how, rival) in
            [(10, Wrong::Random, 1..=1), (10, Wrong::Pairs, 2..=2), (9, Wrong::Together, 9..=9)]
        {
            let scene = TwoMaps::new(seed, 20, wrong, how);
            let [from, to] = scene.graphs();
            let set = consistent_set(&scene.closures, from, to, &ConsistencyParams::default()).unwrap();
            assert_eq!(set.selected, scene.right(), "{how:?} {seed}");
            assert_eq!(set.rejected, scene.wrong, "{how:?} {seed}");
            assert!(set.exact && rival.contains(&set.rival), "{how:?} {seed}: rival {}", set.rival);
        }
    }
}

#[test]
fn nothing_gives_nothing_and_one_stands_alone() {
    let scene = TwoMaps::new(1, 1, 0, Wrong::Random);
    let [from, to] = scene.graphs();
    let params = ConsistencyParams::default();
    let none = ConsistentSet { selected: vec![], rejected: vec![], rival: 0, exact: true };
    assert_eq!(consistent_set(&[], from, to, &params).unwrap(), none);
    assert_eq!(consistent_set(&scene.closures, from, to, &params).unwrap().selected, [0]);
}

/// Keyframes at 0, `length`, `2 length`, … along x, and edges between successive ones.
fn row(count: u32, length: f64, unit: f64) -> (BTreeMap<KeyframeId, Sim3>, Vec<Edge>) {
    let pose = |i| Sim3::new(Default::default(), [length * i as f64, 0.0, 0.0].into(), unit);
    let nodes = (0..count).map(|i| (KeyframeId(i), pose(i))).collect();
    (nodes, (1..count).map(|i| edge(i - 1, i, Sim3::identity(), 1.0)).collect())
}

fn edge(from: u32, to: u32, from_from_to: Sim3, sigma: f64) -> Edge {
    let information = SMatrix::identity() / (sigma * sigma);
    Edge { from: KeyframeId(from), to: KeyframeId(to), from_from_to, information, kind: EdgeKind::Merge }
}

#[test]
fn the_squared_error_counts_both_measurements_and_the_drift_of_both_maps() {
    const SIGMA: f64 = 0.01;
    const UNIT: f64 = 2.0;
    let (nodes, edges) = row(5, 3.0, UNIT);
    let graph = MapGraph { nodes: &nodes, edges: &edges };
    for drift in [0.0, 0.02] {
        let params = ConsistencyParams {
            drift_translation: drift,
            drift_rotation: 0.0,
            drift_scale: 0.0,
            ..Default::default()
        };
        // Off along the row, where turns do not reach.
        let off = Sim3::new(Default::default(), [0.3, 0.0, 0.0].into(), 1.0);
        let closures = [edge(0, 0, Sim3::identity(), SIGMA), edge(4, 4, off, SIGMA)];
        let pairs = Pairs::new(&closures, graph, graph, &params).unwrap();
        let error = pairs.squared_error(0, 1).unwrap();
        // Twelve map units of way in either map. The scale of the second closure moves the end of the loop by
        // the six keyframe units to the first.
        let drifted = drift * 12.0 / UNIT;
        let variance = 2.0 * SIGMA * SIGMA + 2.0 * drifted * drifted + (6.0 * SIGMA).powi(2);
        // That part shows in the scale of the loop as well, which fits.
        let of_scale = 6.0 * SIGMA * SIGMA;
        let conditioned = variance - of_scale * of_scale / (2.0 * SIGMA * SIGMA);
        assert!((error / (0.09 / conditioned) - 1.0).abs() < 1e-6, "{error} against {}", 0.09 / conditioned);
        let at = |max_squared_error| {
            let params = ConsistencyParams { max_squared_error, ..params.clone() };
            consistent_set(&closures, graph, graph, &params).unwrap().selected.len()
        };
        assert_eq!([at(1.001 * error), at(0.999 * error)], [2, 1]);
    }
}

#[test]
fn paths_are_the_shortest_of_fewest_edges() {
    let (nodes, mut edges) = row(6, 1.0, 1.0);
    edges.push(edge(4, 1, Sim3::identity(), 1.0));
    edges.retain(|edge| edge.to != KeyframeId(5));
    let shortest_paths =
        Neighbours::new(&MapGraph { nodes: &nodes, edges: &edges }).shortest_paths(&nodes, KeyframeId(0));
    assert_eq!(shortest_paths[&KeyframeId(4)], ShortestPath { edges: 2, length: 4.0 });
    assert_eq!(shortest_paths[&KeyframeId(3)], ShortestPath { edges: 3, length: 3.0 });
    assert!(!shortest_paths.contains_key(&KeyframeId(5)));
}

#[test]
fn closures_into_separate_parts_of_a_map_do_not_agree() {
    let (nodes, mut edges) = row(4, 1.0, 1.0);
    let closures = [edge(0, 0, Sim3::identity(), 0.01), edge(3, 3, Sim3::identity(), 0.01)];
    let selected = |edges: &[Edge]| {
        let graph = MapGraph { nodes: &nodes, edges };
        consistent_set(&closures, graph, graph, &ConsistencyParams::default()).unwrap().selected.len()
    };
    assert_eq!(selected(&edges), 2);
    edges.remove(1);
    assert_eq!(selected(&edges), 1);
}

#[test]
fn bad_input_is_refused() {
    let (nodes, edges) = row(3, 1.0, 1.0);
    let refuse = |nodes: &BTreeMap<KeyframeId, Sim3>, closure: Edge| {
        let graph = MapGraph { nodes, edges: &edges };
        consistent_set(&[closure], graph, graph, &ConsistencyParams::default()).unwrap_err()
    };
    let good = || edge(0, 2, Sim3::identity(), 0.1);
    let missing = KeyframeId(9);
    assert_eq!(
        refuse(&nodes, Edge { to: missing, ..good() }),
        PoseGraphError::UnknownKeyframe { index: 0, missing }
    );
    let nowhere = Sim3 { scale: f64::NAN, ..Sim3::identity() };
    assert!(matches!(
        refuse(&nodes, Edge { from_from_to: nowhere, ..good() }),
        PoseGraphError::InvalidMeasurement { .. }
    ));
    let nothing = SMatrix::zeros();
    assert!(matches!(
        refuse(&nodes, Edge { information: nothing, ..good() }),
        PoseGraphError::InvalidInformation { .. }
    ));
    let poisoned = BTreeMap::from([(KeyframeId(0), nowhere)]);
    assert_eq!(refuse(&poisoned, good()), PoseGraphError::InvalidNode(KeyframeId(0)));
}
