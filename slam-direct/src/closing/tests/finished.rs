//! Loops in a finished map, as somebody else found them.

use super::super::*;
use geometry::{GrayImage, Pinhole, Sim3};
use map::{EdgeKind, Keyframe};
use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

const CAMERA: Pinhole = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
const COUNT: u32 = 40;

/// Once round a circle of 5 units; each step adds `drift`.
fn round(drift: &Sim3) -> (Map, Vec<Sim3>) {
    let on_circle = |i: u32| {
        let angle = TAU * f64::from(i) / f64::from(COUNT);
        Sim3::exp(&SVector::from([0.0, 0.0, 0.0, 0.0, angle, 0.0, 0.0]))
            * Sim3::exp(&SVector::from([0.0, 0.0, -5.0, 0.0, 0.0, 0.0, 0.0]))
    };
    let truth: Vec<Sim3> = (0..COUNT).map(on_circle).collect();
    let mut map = Map::new(CAMERA);
    let mut pose = truth[0];
    for i in 0..COUNT {
        if i > 0 {
            pose = pose * (truth[i as usize - 1].inverse() * truth[i as usize]) * *drift;
        }
        let image = GrayImage::filled(8, 6, 0).into();
        map.keyframes
            .insert(KeyframeId(i), Keyframe::of_image(KeyframeId(i), i.into(), i.into(), pose, image));
    }
    let keyframes: Vec<&Keyframe> = map.keyframes.values().collect();
    map.edges = keyframes.windows(2).map(|k| Edge::odometry(k[0], k[1], [0.02, 0.005, 0.005])).collect();
    (map, truth)
}

/// The last keyframe as seen from the first, by exact measurement.
fn seen(truth: &[Sim3]) -> Edge {
    let last = COUNT - 1;
    Edge {
        from: KeyframeId(last),
        to: KeyframeId(0),
        from_from_to: truth[last as usize].inverse() * truth[0],
        information: SMatrix::identity() * 1e6,
        kind: EdgeKind::Merge,
    }
}

fn off(map: &Map, truth: &[Sim3]) -> f64 {
    let pose = |i: u32| map.keyframes[&KeyframeId(i)].world_from_keyframe;
    let found = pose(0).inverse() * pose(COUNT - 1);
    (found.inverse() * (truth[0].inverse() * truth[truth.len() - 1])).log().norm()
}

#[test]
fn a_loop_spreads_its_drift_and_stays_an_edge_of_the_map() {
    let drift = Sim3::exp(&SVector::from([0.004, 0.002, -0.003, 0.001, 0.002, 0.001, 0.002]));
    let (mut map, truth) = round(&drift);
    let before = off(&map, &truth);
    let first = map.keyframes[&KeyframeId(0)].world_from_keyframe;
    close_loop(&mut map, vec![seen(&truth)], &ClosingParams::default()).unwrap();
    let after = off(&map, &truth);
    assert!(before > 0.1 && after < 0.02 * before, "{before} before, {after} after");
    assert_eq!(map.keyframes[&KeyframeId(0)].world_from_keyframe, first);
    // No step takes all of it.
    let step = |i: u32| {
        let pose = |i: u32| map.keyframes[&KeyframeId(i)].world_from_keyframe;
        let truth = truth[i as usize - 1].inverse() * truth[i as usize];
        ((pose(i - 1).inverse() * pose(i)).inverse() * truth).log().norm()
    };
    assert!((1..COUNT).all(|i| step(i) < 0.2 * before));
    let closed: Vec<&Edge> = map.edges.iter().filter(|edge| edge.kind == EdgeKind::Loop).collect();
    assert_eq!(closed.len(), 1);
    let pose = |id: KeyframeId| map.keyframes[&id].world_from_keyframe;
    for edge in &map.edges {
        let by_poses = pose(edge.from).inverse() * pose(edge.to);
        assert!((by_poses.inverse() * edge.from_from_to).log().norm() < 1e-9);
    }
}

#[test]
fn a_loop_that_the_path_does_not_explain_changes_nothing() {
    let (mut map, truth) = round(&Sim3::identity());
    let poses = |map: &Map| map.keyframes.values().map(|k| k.world_from_keyframe).collect::<Vec<_>>();
    let (before, edges) = (poses(&map), map.edges.clone());
    let mut elsewhere = seen(&truth);
    // A fifth of the path off, and 40° turned.
    for twist in [[6.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.7, 0.0, 0.0]] {
        elsewhere.from_from_to = Sim3::exp(&SVector::from(twist)) * seen(&truth).from_from_to;
        let refused = close_loop(&mut map, vec![elsewhere.clone()], &ClosingParams::default());
        assert!(matches!(refused, Err(NoLoop::TooFar(_))), "{refused:?}");
    }
    assert!(poses(&map) == before && map.edges == edges);
}
