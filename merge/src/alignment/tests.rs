use super::*;
use crate::test_support::Numbers;
use geometry::sensor::Shift;
use geometry::{GrayImage, Pinhole};
use map::{Edge, EdgeKind, FramePose, Keyframe, KeyframeId, SemiDense};
use nalgebra::SMatrix;
use std::sync::Arc;

fn sim3(numbers: &mut Numbers) -> Sim3 {
    Sim3::new(numbers.rotation(1.0), numbers.vector(3.0), numbers.uniform(0.4, 2.5))
}

/// A map of four keyframes with units of their own, a frame each and edges that fit.
fn synthetic_map() -> Map {
    let numbers = &mut Numbers::new(11);
    let camera = Pinhole { width: 16, height: 12, fx: 14.0, fy: 14.5, cx: 7.6, cy: 5.4 };
    let mut map = Map::new(camera);
    for id in (0..4).map(KeyframeId) {
        let pixel: Vec<u32> = (0..60).map(|k| 3 * k + id.0).collect();
        map.keyframes.insert(
            id,
            Keyframe {
                agent: map::AgentId(0),
                id,
                timestamp: f64::from(id.0),
                frame_index: u64::from(id.0),
                world_from_keyframe: sim3(numbers),
                image: Arc::new(GrayImage::from_vec(16, 12, vec![9; 192]).unwrap()),
                color: None,
                scan: None,
                semi_dense: SemiDense {
                    inverse_depth: pixel.iter().map(|_| numbers.uniform(0.1, 1.0) as f32).collect(),
                    variance: vec![1e-4; pixel.len()].into(),
                    pixel: pixel.into(),
                }
                .into(),
                points: Vec::new(),
                features: None,
                words: None,
            },
        );
        let keyframe_from_frame = Se3::new(numbers.rotation(0.2), numbers.vector(0.3));
        map.frames.push(FramePose {
            timestamp: f64::from(id.0),
            frame_index: u64::from(id.0),
            reference: id,
            keyframe_from_frame,
        });
    }
    for (from, to) in [(0, 1), (1, 2), (2, 3), (0, 3)].map(|(a, b)| (KeyframeId(a), KeyframeId(b))) {
        map.edges.push(Edge {
            from,
            to,
            from_from_to: pose(&map, from).inverse() * pose(&map, to),
            information: SMatrix::identity(),
            kind: EdgeKind::Odometry,
        });
    }
    map
}

fn pose(map: &Map, id: KeyframeId) -> Sim3 {
    map.keyframes[&id].world_from_keyframe
}

fn cloud(map: &Map, id: KeyframeId) -> Vec<Vector3<f64>> {
    map.keyframes[&id]
        .cloud(map.camera(&map.keyframes[&id]), Shift::none(*map.camera(&map.keyframes[&id])), f32::INFINITY)
        .map(|point| point.position)
        .collect()
}

fn distance(a: &Sim3, b: &Sim3) -> f64 {
    (a.to_matrix() - b.to_matrix()).norm()
}

/// A loop closure between the maps with all that the steps before would know, exactly.
struct Closure {
    source: Map,
    target: Map,
    target_world_from_source_world: Sim3,
    i: KeyframeId,
    j: KeyframeId,
    poses: PairPoses,
    scale: f64,
    target_from_scaled_source: Se3,
}

fn closure(seed: u64) -> Closure {
    let source = synthetic_map();
    let target_world_from_source_world = sim3(&mut Numbers::new(seed));
    let mut target = source.clone();
    apply_to_all(&mut target, &target_world_from_source_world);
    let (i, j) = (KeyframeId(1), KeyframeId(2));
    let poses =
        PairPoses { source_world_from_source: pose(&source, i), target_world_from_target: pose(&target, j) };
    // p_t = σ R p_s + t of the two keyframes.
    let target_from_source = poses.target_world_from_target.inverse()
        * target_world_from_source_world
        * poses.source_world_from_source;
    Closure {
        source,
        target,
        target_world_from_source_world,
        i,
        j,
        poses,
        scale: target_from_source.scale,
        target_from_scaled_source: target_from_source.rigid(),
    }
}

/// Moves the only agent of a map.
fn apply_to_all(map: &mut Map, motion: &Sim3) {
    apply(map, &BTreeMap::from([(AgentId(0), *motion)]));
}

#[test]
fn two_copies_of_a_map_come_together() {
    for seed in 0..20 {
        let mut c = closure(seed);
        let guess = initial_guess(&c.target_from_scaled_source, &c.poses);
        let end = final_transform(&Sim3::identity(), &guess, &c.poses);
        let motions = world_motions(c.scale, &end, &c.poses);
        apply_to_all(&mut c.source, &motions.scaled_source_world_from_source_world);
        apply_to_all(&mut c.target, &motions.scaled_source_world_from_target_world);
        for (s, t) in c.source.cloud(f32::INFINITY).zip(c.target.cloud(f32::INFINITY)) {
            assert!((s.position - t.position).norm() < 1e-9 * (1.0 + s.position.norm()), "seed {seed}");
        }
        for (s, t) in c.source.trajectory().iter().zip(c.target.trajectory()) {
            assert!(distance(&s.world_from_camera.into(), &t.world_from_camera.into()) < 1e-9, "seed {seed}");
        }
        let scaling = motions.scaled_source_world_from_source_world;
        let expected = scaling * c.target_world_from_source_world.inverse();
        assert!(distance(&motions.scaled_source_world_from_target_world, &expected) < 1e-9, "seed {seed}");
    }
}

#[test]
fn aligned_clouds_show_one_scene_in_one_frame() {
    let c = closure(3);
    let guess = initial_guess(&c.target_from_scaled_source, &c.poses);
    let (source, target) = (cloud(&c.source, c.i), cloud(&c.target, c.j));
    let aligned = align(&source, &target, c.scale, &guess, &c.poses);
    // Keyframe i's view of what keyframe j holds, by way of the world they share in truth.
    let source_from_twin = pose(&c.source, c.i).inverse() * pose(&c.source, c.j);
    for (found, twin) in aligned.target.iter().zip(cloud(&c.source, c.j)) {
        assert!((found - source_from_twin * twin * c.scale).norm() < 1e-9);
    }
    for (found, point) in aligned.source.iter().zip(&source) {
        assert!((found - point * c.scale).norm() < 1e-12);
    }
}

#[test]
fn the_refinement_mends_a_wrong_guess() {
    let c = closure(7);
    let right = initial_guess(&c.target_from_scaled_source, &c.poses);
    let error = Sim3::new(Numbers::new(1).rotation(0.1), Vector3::new(0.1, -0.2, 0.05), 1.04);
    let wrong = error * right;
    // T_Ftrans acts on the target cloud as the wrong guess left it.
    let mended = final_transform(&error.inverse(), &wrong, &c.poses);
    assert!(distance(&mended, &Sim3::from(c.target_from_scaled_source.inverse())) < 1e-9);
    assert!(distance(&final_transform(&Sim3::identity(), &wrong, &c.poses), &mended) > 0.05);
}

#[test]
fn moving_a_map_leaves_all_but_the_poses() {
    let before = synthetic_map();
    let mut after = before.clone();
    let motion = sim3(&mut Numbers::new(5));
    apply_to_all(&mut after, &motion);
    for (a, b) in before.cloud(f32::INFINITY).zip(after.cloud(f32::INFINITY)) {
        assert!((motion * a.position - b.position).norm() < 1e-9);
    }
    for edge in &after.edges {
        let now = pose(&after, edge.from).inverse() * pose(&after, edge.to);
        assert!(distance(&now, &edge.from_from_to) < 1e-9);
    }
    apply_to_all(&mut after, &motion.inverse());
    for (id, keyframe) in &mut after.keyframes {
        assert!(distance(&keyframe.world_from_keyframe, &pose(&before, *id)) < 1e-12);
        keyframe.world_from_keyframe = pose(&before, *id);
    }
    assert_eq!(after, before);
}
