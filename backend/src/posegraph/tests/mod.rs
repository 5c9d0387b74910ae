//! Graphs whose optimum is known.

mod robust;
pub(crate) mod two_maps;

use super::*;
use geometry::Random;
use map::EdgeKind;
use nalgebra::{SMatrix, SVector, Vector3};

/// Random numbers in −1…1.
pub(crate) struct Noise(Random);

impl Noise {
    fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    fn next(&mut self) -> f64 {
        2.0 * self.0.unit() - 1.0
    }

    fn tangent(&mut self, translation: f64, rotation: f64, scale: f64) -> SVector<f64, 7> {
        let t = [translation, translation, translation, rotation, rotation, rotation, scale];
        SVector::from(t.map(|size| size * self.next()))
    }
}

/// Keyframes on a circle, looking along their way, with scales that vary.
fn ring(count: u32) -> BTreeMap<KeyframeId, Sim3> {
    (0..count)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / count as f64;
            let rotation = nalgebra::UnitQuaternion::from_euler_angles(0.0, angle, 0.0);
            let translation = Vector3::new(angle.cos(), 0.1 * (3.0 * angle).sin(), angle.sin()) * 10.0;
            (KeyframeId(i), Sim3::new(rotation, translation, 1.0 + 0.3 * angle.sin()))
        })
        .collect()
}

fn edge(nodes: &BTreeMap<KeyframeId, Sim3>, from: u32, to: u32, kind: EdgeKind, sigma: f64) -> Edge {
    let (from, to) = (KeyframeId(from), KeyframeId(to));
    Edge {
        from,
        to,
        from_from_to: nodes[&from].inverse() * nodes[&to],
        information: SMatrix::identity() / (sigma * sigma),
        kind,
    }
}

/// Odometry edges `i → i+1` of a ring.
fn chain(nodes: &BTreeMap<KeyframeId, Sim3>) -> Vec<Edge> {
    let last = nodes.len() as u32 - 1;
    (0..last).map(|i| edge(nodes, i, i + 1, EdgeKind::Odometry, 0.01)).collect()
}

/// Poses by following the odometry edges from node 0.
fn integrate(nodes: &BTreeMap<KeyframeId, Sim3>, edges: &[Edge]) -> BTreeMap<KeyframeId, Sim3> {
    let mut poses = BTreeMap::from([(KeyframeId(0), nodes[&KeyframeId(0)])]);
    for edge in edges.iter().filter(|e| e.kind == EdgeKind::Odometry) {
        let pose = poses[&edge.from] * edge.from_from_to;
        poses.insert(edge.to, pose);
    }
    poses
}

fn largest_error(a: &BTreeMap<KeyframeId, Sim3>, b: &BTreeMap<KeyframeId, Sim3>) -> f64 {
    a.iter().map(|(id, pose)| (pose.inverse() * b[id]).log().norm()).fold(0.0, f64::max)
}

fn first() -> BTreeSet<KeyframeId> {
    BTreeSet::from([KeyframeId(0)])
}

#[test]
fn exact_edges_pull_disturbed_nodes_back_to_the_truth() {
    let truth = ring(30);
    let mut edges = chain(&truth);
    edges.push(edge(&truth, 29, 0, EdgeKind::Loop, 0.01));
    edges.push(edge(&truth, 3, 17, EdgeKind::Covisibility, 0.01));
    let mut noise = Noise::new(1);
    let mut nodes = truth.clone();
    for (_, pose) in nodes.iter_mut().skip(1) {
        *pose = *pose * Sim3::exp(&noise.tangent(0.5, 0.2, 0.2));
    }
    let report = optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
    assert!(report.initial_cost > 1e4, "{report:?}");
    assert!(report.final_cost < 1e-9, "{report:?}");
    assert!(largest_error(&truth, &nodes) < 1e-6, "{report:?}");
    assert!(report.converged && report.suppressed.is_empty());
}

#[test]
fn a_loop_spreads_scale_drift_evenly() {
    let truth = ring(40);
    let mut edges = chain(&truth);
    // Every step shrinks the world by 1 %: the chain alone ends at two thirds of the scale.
    let drift = Sim3::exp(&SVector::from([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.01]));
    for edge in &mut edges {
        edge.from_from_to = drift * edge.from_from_to;
    }
    let mut nodes = integrate(&truth, &edges);
    let drifted = largest_error(&truth, &nodes);
    edges.push(edge(&truth, 39, 0, EdgeKind::Loop, 0.001));
    let report = optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
    let left = largest_error(&truth, &nodes);
    assert!(drifted > 1.0 && left < 0.25 * drifted, "drift {drifted} left {left}: {report:?}");
    assert!(report.suppressed.is_empty(), "a true loop after long drift must count: {report:?}");
    let scale = nodes[&KeyframeId(39)].scale / truth[&KeyframeId(39)].scale;
    assert!((scale - 1.0).abs() < 0.02, "scale at the loop is off by {scale}");
}

#[test]
fn the_optimum_of_two_disagreeing_edges_is_their_weighted_mean() {
    let mut nodes = BTreeMap::from([(KeyframeId(0), Sim3::identity()), (KeyframeId(1), Sim3::identity())]);
    let direction = SVector::from([0.0, 0.0, 0.0, 0.2, -0.1, 0.3, 0.5]);
    // Turned and scaled without translation, so that the tangents commute and add up.
    let turned = |size: f64, sigma: f64| Edge {
        from: KeyframeId(0),
        to: KeyframeId(1),
        from_from_to: Sim3::exp(&(direction * size)),
        information: SMatrix::identity() / (sigma * sigma),
        kind: EdgeKind::Odometry,
    };
    let edges = [turned(1.0, 1.0), turned(2.0, 0.5)];
    optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
    let mean = nodes[&KeyframeId(1)].log();
    assert!((mean - direction * 1.8).norm() < 1e-6, "{mean}");
}

#[test]
fn a_false_loop_among_true_ones_is_suppressed() {
    let truth = ring(60);
    let mut edges = chain(&truth);
    let mut noise = Noise::new(5);
    for edge in &mut edges {
        edge.from_from_to = Sim3::exp(&noise.tangent(0.02, 0.005, 0.005)) * edge.from_from_to;
    }
    let mut nodes = integrate(&truth, &edges);
    for (from, to) in [(59, 0), (58, 1), (57, 2)] {
        edges.push(edge(&truth, from, to, EdgeKind::Loop, 0.01));
    }
    // Says that opposite sides of the ring are one place.
    let mut wrong = edge(&truth, 45, 15, EdgeKind::Loop, 0.01);
    wrong.from_from_to = Sim3::identity();
    edges.push(wrong);
    let report = optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
    assert_eq!(report.suppressed, vec![edges.len() - 1], "{report:?}");
    let with_all = largest_error(&truth, &nodes);
    edges.pop();
    optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
    let without = largest_error(&truth, &nodes);
    assert!(with_all < 1.2 * without + 0.01, "with the false loop {with_all}, without {without}");
}

/// Of a drifting chain with ties to keyframes in metres: these stay in metres to the last bit, and tell the others theirs.
#[test]
fn known_scales_stay_and_set_those_of_others() {
    let metric: BTreeMap<KeyframeId, Sim3> =
        ring(40).into_iter().map(|(id, pose)| (id, Sim3 { scale: 1.0, ..pose })).collect();
    let mut truth = metric.clone();
    truth.extend(ring(40).into_iter().map(|(id, pose)| (KeyframeId(id.0 + 100), pose)));
    let mut noise = Noise::new(7);
    let mut edges = Vec::new();
    for first in [0, 100] {
        for i in first..first + 39 {
            let mut step = edge(&truth, i, i + 1, EdgeKind::Odometry, 0.01);
            // The camera's scale runs away, and the LiDAR's edges say a little about theirs that is wrong.
            let scale = if first == 100 { 0.02 } else { 0.002 };
            let drift = Sim3::new(Default::default(), Vector3::zeros(), f64::exp(scale));
            step.from_from_to = Sim3::exp(&noise.tangent(0.005, 0.002, 0.0)) * drift * step.from_from_to;
            edges.push(step);
        }
    }
    for i in (0..40).step_by(3) {
        edges.push(edge(&truth, i, i + 100, EdgeKind::Merge, 0.01));
    }
    let mut nodes = integrate(&metric, &edges[..39]);
    for pose in nodes.values_mut() {
        pose.scale = 1.0;
    }
    let camera = edges[39..78].iter().fold(vec![truth[&KeyframeId(100)]], |mut poses, edge| {
        poses.push(poses[poses.len() - 1] * edge.from_from_to);
        poses
    });
    nodes.extend((100..).map(KeyframeId).zip(camera));
    let known: BTreeSet<KeyframeId> = metric.keys().copied().collect();
    let mut free = nodes.clone();
    optimise(&mut free, &edges, &first(), &PoseGraphParams::default()).unwrap();
    optimise_with_known_scales(&mut nodes, &edges, &first(), &known, &PoseGraphParams::default()).unwrap();
    assert!(known.iter().all(|id| nodes[id].scale == 1.0));
    let off = |found: &BTreeMap<KeyframeId, Sim3>| {
        let scales = found.iter().map(|(id, pose)| (pose.scale / truth[id].scale).ln().abs());
        scales.fold(0.0, f64::max)
    };
    // Less than two steps drift, of 39.
    assert!(off(&nodes) < 0.04 && off(&free) > 2.0 * off(&nodes), "{} {}", off(&nodes), off(&free));
}

#[test]
fn without_fixed_nodes_the_graph_settles_where_it_is() {
    let truth = ring(12);
    let mut edges = chain(&truth);
    edges.push(edge(&truth, 11, 0, EdgeKind::Loop, 0.01));
    let mut nodes = truth.clone();
    let moved = nodes.get_mut(&KeyframeId(5)).unwrap();
    moved.translation.x += 0.3;
    nodes.insert(KeyframeId(99), Sim3::identity());
    let report = optimise(&mut nodes, &edges, &BTreeSet::new(), &PoseGraphParams::default()).unwrap();
    assert!(report.final_cost < 1e-8, "{report:?}");
    assert_eq!(nodes[&KeyframeId(99)], Sim3::identity(), "a node without edges stays");
}

#[test]
fn all_fixed_or_no_edges_is_no_work() {
    let truth = ring(4);
    let mut nodes = truth.clone();
    let all: BTreeSet<KeyframeId> = truth.keys().copied().collect();
    let params = PoseGraphParams::default();
    assert_eq!(optimise(&mut nodes, &chain(&truth), &all, &params).unwrap().iterations, 0);
    assert_eq!(optimise(&mut nodes, &[], &first(), &params).unwrap().iterations, 0);
    assert!(largest_error(&truth, &nodes) < 1e-12);
}

#[test]
fn poisoned_input_is_refused_and_leaves_the_nodes() {
    let truth = ring(5);
    let params = PoseGraphParams::default();
    let refuse = |nodes: &BTreeMap<KeyframeId, Sim3>, edges: &[Edge]| {
        let mut touched = nodes.clone();
        let error = optimise(&mut touched, edges, &first(), &params).unwrap_err();
        assert_eq!(format!("{touched:?}"), format!("{nodes:?}"));
        error
    };
    let mut nodes = truth.clone();
    nodes.get_mut(&KeyframeId(2)).unwrap().translation.y = f64::NAN;
    assert_eq!(refuse(&nodes, &chain(&truth)), PoseGraphError::InvalidNode(KeyframeId(2)));
    let mut edges = chain(&truth);
    edges[1].from_from_to.scale = -1.0;
    assert!(matches!(refuse(&truth, &edges), PoseGraphError::InvalidMeasurement { index: 1, .. }));
    let mut edges = chain(&truth);
    edges[2].information[(3, 4)] = f64::INFINITY;
    assert!(matches!(refuse(&truth, &edges), PoseGraphError::InvalidInformation { index: 2, .. }));
    let mut edges = chain(&truth);
    edges[0].to = KeyframeId(77);
    assert!(matches!(refuse(&truth, &edges), PoseGraphError::UnknownKeyframe { index: 0, .. }));
    edges[0].to = KeyframeId(0);
    assert!(matches!(refuse(&truth, &edges), PoseGraphError::SelfEdge { index: 0, .. }));
}

#[test]
fn two_thousand_keyframes_converge_within_few_iterations() {
    let truth = ring(2000);
    let mut noise = Noise::new(9);
    let mut edges = chain(&truth);
    for i in 0..2000u32 {
        for ahead in 2..5 {
            if i + ahead < 2000 {
                edges.push(edge(&truth, i, i + ahead, EdgeKind::Covisibility, 0.01));
            }
        }
    }
    for edge in &mut edges {
        edge.from_from_to = Sim3::exp(&noise.tangent(0.003, 0.0005, 0.001)) * edge.from_from_to;
    }
    let mut nodes = integrate(&truth, &edges);
    let drifted = largest_error(&truth, &nodes);
    for i in 0..10 {
        edges.push(edge(&truth, 1999 - i, i, EdgeKind::Loop, 0.01));
    }
    let report = optimise(&mut nodes, &edges, &first(), &PoseGraphParams::default()).unwrap();
    let left = largest_error(&truth, &nodes);
    // The noise costs 0.096 an edge by its variance over the claimed one, less what the 2000 nodes absorb.
    assert!((report.final_cost / (0.096 * 6000.0) - 1.0).abs() < 0.1, "{report:?}");
    assert!(report.converged && report.iterations <= 10, "{report:?}");
    assert!(left < 0.2 * drifted, "{drifted} to {left}");
    assert!(report.suppressed.is_empty());
}
