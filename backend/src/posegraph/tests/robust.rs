//! The optimisation with wrong edges among the right ones.

use super::two_maps::{TwoMaps, Wrong};
use super::*;

/// Optimises both maps with the given closures and the second map placed by one of them; the closures that
/// were suppressed, and how far the result is from that of the right closures alone.
fn solve(scene: &TwoMaps, closures: &[usize], placed_by: usize) -> (Vec<usize>, f64) {
    let run = |closures: &[usize], placed_by| {
        let edges = scene.all_edges(closures.iter().copied());
        let mut nodes = scene.placed_by(placed_by);
        let report = optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
        let inner = edges.len() - closures.len();
        (nodes, report.suppressed.into_iter().map(|i| closures[i - inner]).collect::<Vec<_>>())
    };
    let (nodes, suppressed) = run(closures, placed_by);
    let (wanted, _) = run(&scene.right(), scene.right()[0]);
    assert!(largest_error(&scene.truth, &wanted) < 0.8, "the maps drift less than a unit");
    (suppressed, largest_error(&wanted, &nodes))
}

#[test]
fn half_of_the_closures_may_be_wrong_wherever_the_second_map_starts() {
    for seed in 0..3 {
        for how in [Wrong::Random, Wrong::Pairs] {
            let scene = TwoMaps::new(seed, 20, 10, how);
            let all: Vec<usize> = (0..20).collect();
            for start in [scene.right()[0], scene.wrong[0]] {
                let (suppressed, apart) = solve(&scene, &all, start);
                assert_eq!(suppressed, scene.wrong, "{how:?} {seed} from {start}");
                assert!(apart < 1e-3, "{how:?} {seed} from {start}: {apart}");
            }
        }
    }
}

#[test]
fn what_no_kernel_tells_apart_the_selection_does() {
    // Nine of twenty agree on another place. In this scene they drag the optimisation along.
    let scene = TwoMaps::new(13, 20, 9, Wrong::Together);
    let all: Vec<usize> = (0..20).collect();
    let (suppressed, _) = solve(&scene, &all, scene.right()[0]);
    assert_eq!(suppressed, scene.right(), "if this one comes out right, the selection is tested by none");
    let [from, to] = scene.graphs();
    let set = consistent_set(&scene.closures, from, to, &ConsistencyParams::default()).unwrap();
    let (suppressed, apart) = solve(&scene, &set.selected, set.selected[0]);
    assert_eq!(set.rejected, scene.wrong);
    assert!(suppressed.is_empty() && apart < 1e-9);
}
